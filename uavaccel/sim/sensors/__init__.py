"""AirSim's sensors: their parameters by AirSim's names, and what they read of a vehicle's true state.

Each reads the state of the tick at which it is asked. Its noise depends on that tick and on a seed, and not on who
asked how often before.
"""
