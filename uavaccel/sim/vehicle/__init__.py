"""One quadrotor: its airframe, its autopilot, the loop that steps both, and what it stands on and runs into."""
