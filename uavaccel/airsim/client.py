"""AirSim's clients: connection, control of vehicle and clock, recording. Cameras, sensors and world lie beside.

Source of names, defaults and parameter orders: AirSim v1.8.1, PythonClient/airsim/client.py.
"""

# ruff: noqa: N802  the names are AirSim's

from __future__ import annotations

import sys

from uavaccel.airsim.calls import remote
from uavaccel.airsim.camera_calls import CameraCalls
from uavaccel.airsim.connection import Connection, connect
from uavaccel.airsim.multirotor_calls import MultirotorCalls
from uavaccel.airsim.sensor_calls import SensorCalls
from uavaccel.airsim.types import CollisionInfo, EnvironmentState, GeoPoint, KinematicsState, Pose, Vector3r
from uavaccel.airsim.world_calls import WorldCalls

__all__ = ["CarClient", "MultirotorClient", "VehicleClient"]

LOOPBACK, PORT = "127.0.0.1", 41451
CLIENT_VERSION = MIN_SERVER_VERSION = 1


class VehicleClient(WorldCalls, CameraCalls, SensorCalls):
    """The calls that every vehicle has. Any number of threads may use a client.

    `timeout_value` is how many seconds an answer may take. Raises ConnectionError if nobody listens there; calls raise
    RpcError with the server's text.
    """

    def __init__(self, ip: str = "", port: int = PORT, timeout_value: float = 3600) -> None:
        self.client: Connection = connect(ip or LOOPBACK, port, timeout_value)

    # --- connection -------------------------------------------------------------------------------

    @remote
    def ping(self) -> bool: ...

    def getClientVersion(self) -> int:
        return CLIENT_VERSION

    @remote
    def getServerVersion(self) -> int: ...

    def getMinRequiredServerVersion(self) -> int:
        return MIN_SERVER_VERSION

    @remote
    def getMinRequiredClientVersion(self) -> int: ...

    def confirmConnection(self) -> None:
        """Ping the server, and print whether the versions fit."""
        print("Connected!" if self.ping() else "Ping returned false!")
        server, client = self.getServerVersion(), self.getClientVersion()
        min_server, min_client = self.getMinRequiredServerVersion(), self.getMinRequiredClientVersion()
        versions = f"Client Ver:{client} (Min Req: {min_client}), Server Ver:{server} (Min Req: {min_server})"
        fits = server >= min_server and client >= min_client
        print(versions, file=sys.stdout if fits else sys.stderr)
        if not fits:
            print(f"{'AirSim server' if server < min_server else 'This client'} is too old. Please upgrade!")
        print()

    @remote
    def getSettingsString(self) -> str:
        """settings.json, as it holds."""

    # --- control ----------------------------------------------------------------------------------

    @remote
    def reset(self) -> None:
        """Every vehicle to its start; API control and arming have to be asked for again."""

    @remote
    def enableApiControl(self, is_enabled: bool, vehicle_name: str = "") -> None:
        """Without API control commands have no effect."""

    @remote
    def isApiControlEnabled(self, vehicle_name: str = "") -> bool: ...

    @remote
    def armDisarm(self, arm: bool, vehicle_name: str = "") -> bool: ...

    @remote
    def cancelLastTask(self, vehicle_name: str = "") -> None:
        """End the running command."""

    @remote
    def simAddVehicle(
        self, vehicle_name: str, vehicle_type: str, pose: Pose, pawn_path: str = ""
    ) -> bool: ...

    @remote
    def listVehicles(self) -> list[str]: ...

    # --- clock ------------------------------------------------------------------------------------

    @remote
    def simPause(self, is_paused: bool) -> None: ...

    def simIsPause(self) -> bool:
        return bool(self.client.call("simIsPaused"))

    @remote
    def simContinueForTime(self, seconds: float) -> None:
        """Run for `seconds` of wall time, so times ClockSpeed of simulated time, then pause."""

    @remote
    def simContinueForFrames(self, frames: int) -> None:
        """Run for so many rendered frames, then pause."""

    # --- state ------------------------------------------------------------------------------------

    @remote
    def getHomeGeoPoint(self, vehicle_name: str = "") -> GeoPoint: ...

    @remote
    def simGetCollisionInfo(self, vehicle_name: str = "") -> CollisionInfo:
        """What was touched; reading it sets has_collided back."""

    @remote
    def simGetVehiclePose(self, vehicle_name: str = "") -> Pose: ...

    @remote
    def simSetVehiclePose(self, pose: Pose, ignore_collision: bool, vehicle_name: str = "") -> None:
        """NaN leaves a part of the pose as it is."""

    @remote
    def simGetGroundTruthKinematics(self, vehicle_name: str = "") -> KinematicsState: ...

    @remote
    def simSetKinematics(
        self, state: KinematicsState, ignore_collision: bool, vehicle_name: str = ""
    ) -> None: ...

    @remote
    def simGetGroundTruthEnvironment(self, vehicle_name: str = "") -> EnvironmentState: ...

    @remote
    def simSetWind(self, wind: Vector3r) -> None:
        """Metres per second, NED."""

    # --- recording --------------------------------------------------------------------------------

    @remote
    def startRecording(self) -> None: ...

    @remote
    def stopRecording(self) -> None: ...

    @remote
    def isRecording(self) -> bool: ...


class MultirotorClient(VehicleClient, MultirotorCalls):
    """The calls of a multirotor."""


class CarClient(VehicleClient):
    """For scripts that import it. Raises NotImplementedError: no car drives here."""

    def __init__(self, *arguments: object, **options: object) -> None:
        raise NotImplementedError("uavaccel simulates multirotors; there is no car")
