"""AirSim's flight commands: goals for the autopilot, and the loops at 50 Hz that choose them."""
