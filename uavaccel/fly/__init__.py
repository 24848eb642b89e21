"""AirSim scripts, unmodified, flown in one process with their simulation; see `uavaccel fly`."""
