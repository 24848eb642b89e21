"""AirSim's Python client, for this project's server, for AirSim's own, and under `uavaccel fly`.

    import uavaccel.airsim as airsim

in place of `import airsim`, and nothing else in a script changes. Names, types and parameter orders are those of
AirSim v1.8.1's PythonClient; it needs msgpack and NumPy alone. What differs: calls are thread-safe, NumPy's numbers may
be arguments, no tornado, and the error of a command that was only joined is told on standard error.
"""

# ruff: noqa: F403  all of it is for scripts

from uavaccel.airsim.client import CarClient as CarClient
from uavaccel.airsim.client import MultirotorClient as MultirotorClient
from uavaccel.airsim.client import VehicleClient as VehicleClient
from uavaccel.airsim.connection import Future as Future
from uavaccel.airsim.types import *
from uavaccel.airsim.utils import *
from uavaccel.wire.rpc import RpcError as RpcError

__version__ = "1.8.1"  # of the API
