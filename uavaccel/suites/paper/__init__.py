"""The paper: its experiments under AirSim's and native timing, and each of its claims decided."""
