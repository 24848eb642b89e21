"""A quadrotor: airframe, autopilot, the loop that steps both, and its contacts with the surroundings."""
