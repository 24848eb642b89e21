"""What the drone sees, as pure functions on arrays: the DVS, its observation, the image guard."""
