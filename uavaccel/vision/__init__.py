"""What the drone sees, as pure functions on arrays: event camera, observations, image guard, perturbations."""
