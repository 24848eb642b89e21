"""Lanes over arrays: flight, images and events of many drones at once, on CPU cores or on one GPU.

Every function is written once and compiled twice by numba, for the CPU and as part of CUDA kernels.
"""
