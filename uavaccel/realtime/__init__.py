"""Real time for any Gymnasium environment: while an agent thinks, the environment goes on.

Gymnasium and NumPy are all that it needs.
"""

from uavaccel.realtime.process import RealTimeProcess
from uavaccel.realtime.thinking import Measured, ThinkingTime, lognormal, samples
from uavaccel.realtime.vector import RealTimeVector
from uavaccel.realtime.wrapper import RealTime

__all__ = ["Measured", "RealTime", "RealTimeProcess", "RealTimeVector", "ThinkingTime", "lognormal", "samples"]
