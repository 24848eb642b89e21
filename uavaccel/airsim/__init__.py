"""AirSim's Python client, for this project's server, for AirSim's own, and under `uavaccel fly`.

    import uavaccel.airsim as airsim

replaces `import airsim`; nothing else in a script changes. Names, types and parameter orders are those of AirSim
v1.8.1's PythonClient. It needs only msgpack and NumPy. Unlike AirSim's, its calls are thread-safe, accept NumPy's
numbers, do not use tornado, and print on standard error the error of a command that was only joined.
"""

# ruff: noqa: F403  all of it is for scripts

from uavaccel.airsim import utils as pfm  # noqa: F401  AirSim's module of this name, whose functions are there
from uavaccel.airsim.client import CarClient as CarClient
from uavaccel.airsim.client import MultirotorClient as MultirotorClient
from uavaccel.airsim.client import VehicleClient as VehicleClient
from uavaccel.airsim.types import *
from uavaccel.airsim.utils import *
from uavaccel.wire.rpc import Future as Future
from uavaccel.wire.rpc import RpcError as RpcError

__version__ = "1.8.1"  # of the API
