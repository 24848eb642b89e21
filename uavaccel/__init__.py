"""Accelerated, time-controlled quadrotor simulation, and what the acceleration costs.

Importing the package loads nothing heavy: each command line call pays only for the modules it uses.
"""

__version__ = "0.1.0"
