"""Real time for any Gymnasium environment: while an agent thinks, the environment goes on.

Neither PyTorch nor OpenGL is imported here.
"""

from uavaccel.realtime.process import RealTimeProcess
from uavaccel.realtime.thinking import Measured, ThinkingTime, lognormal, samples
from uavaccel.realtime.wrapper import RealTime

__all__ = ["Measured", "RealTime", "RealTimeProcess", "ThinkingTime", "lognormal", "samples"]
