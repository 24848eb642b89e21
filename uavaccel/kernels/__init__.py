"""Lanes over arrays: flight, pictures and events of many drones at once, on the CPU's cores or on one GPU.

Every function here is written once, for numba: as machine code of the CPU and, of the same source, as CUDA kernels.
"""
