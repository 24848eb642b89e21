"""AirSim's sensors: their settings under AirSim's names, and their readings of a vehicle's true state.

A reading is of the present tick. Its noise depends only on that tick and on a seed, not on earlier readings.
"""
