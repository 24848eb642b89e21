"""AirSim's client before 1.2, the module `AirSimClient`: one vehicle, cameras by number, commands without futures.

A command with a `duration` returns at once; one with `max_wait_seconds` waits for its end, at most for that long.
Source of names, defaults and parameter orders: AirSim v1.1, PythonClient/AirSimClient.py and docs/apis.md.
"""

# ruff: noqa: F403, N802, N815  the names are AirSim's, and all of it is for scripts

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import ParamSpec

from uavaccel.airsim import client, utils
from uavaccel.airsim.client import FOR_EVER, NO_TURN, TURN_FREELY
from uavaccel.airsim.connection import Future
from uavaccel.airsim.types import *
from uavaccel.airsim.types import (
    CameraInfo,
    CollisionInfo,
    GeoPoint,
    ImageType,
    Pose,
    Quaternionr,
    RCData,
    Vector3r,
    YawMode,
)
from uavaccel.airsim.utils import *

AirSimImageType = ImageType

Arguments = ParamSpec("Arguments")


def _waited(command: Callable[[float], Future], max_wait_s: float) -> bool:
    """Return the result of a command with a time-out; True at once for a time-out of 0. Raises RpcError."""
    begun = command(max_wait_s if max_wait_s > 0 else FOR_EVER)
    return bool(begun.get()) if max_wait_s > 0 else True


def _begun(command: Callable[Arguments, Future]) -> Callable[Arguments, bool]:
    """Return a command with a duration, which is sent without waiting for its end."""

    @functools.wraps(command)
    def begin(*arguments: Arguments.args, **named: Arguments.kwargs) -> bool:
        command(*arguments, **named)
        return True

    return begin


class AirSimClientBase(client.VehicleClient):
    """The calls of every vehicle, and AirSim's helpers, which were static methods then."""

    stringToUint8Array = staticmethod(utils.string_to_uint8_array)
    stringToFloatArray = staticmethod(utils.string_to_float_array)
    listTo2DFloatArray = staticmethod(utils.list_to_2d_float_array)
    getPfmArray = staticmethod(utils.get_pfm_array)
    get_public_fields = staticmethod(utils.get_public_fields)
    to_dict = staticmethod(utils.to_dict)
    to_str = staticmethod(utils.to_str)
    write_file = staticmethod(utils.write_file)
    write_png = staticmethod(utils.write_png)
    write_pfm = staticmethod(utils.write_pfm)
    read_pfm = staticmethod(utils.read_pfm)
    toEulerianAngle = staticmethod(utils.to_eularian_angles)
    toQuaternion = staticmethod(utils.to_quaternion)

    @staticmethod
    def wait_key(message: str = "") -> str | None:
        return utils.wait_key(message)

    def getCollisionInfo(self) -> CollisionInfo:
        return self.simGetCollisionInfo()

    def getCameraInfo(self, camera_id: int) -> CameraInfo:
        return self.simGetCameraInfo(str(camera_id))

    def setCameraOrientation(self, camera_id: int, orientation: Quaternionr) -> None:
        self.simSetCameraOrientation(str(camera_id), orientation)

    def simSetPose(self, pose: Pose, ignore_collison: bool) -> None:
        self.simSetVehiclePose(pose, ignore_collison)

    def simGetPose(self) -> Pose:
        return self.simGetVehiclePose()


class MultirotorClient(AirSimClientBase, client.MultirotorClient):
    """The calls of a multirotor, whose commands return whether they succeeded."""

    def takeoff(self, max_wait_seconds: float = 15) -> bool:
        return _waited(self.takeoffAsync, max_wait_seconds)

    def land(self, max_wait_seconds: float = 60) -> bool:
        return _waited(self.landAsync, max_wait_seconds)

    def goHome(self) -> bool:
        return _waited(self.goHomeAsync, FOR_EVER)

    def hover(self) -> bool:
        return bool(self.hoverAsync().get())

    # --- state ------------------------------------------------------------------------------------

    def getPosition(self) -> Vector3r:
        return self.getMultirotorState().kinematics_estimated.position

    def getVelocity(self) -> Vector3r:
        return self.getMultirotorState().kinematics_estimated.linear_velocity

    def getOrientation(self) -> Quaternionr:
        return self.getMultirotorState().kinematics_estimated.orientation

    def getLandedState(self) -> int:
        return self.getMultirotorState().landed_state

    def getGpsLocation(self) -> GeoPoint:
        return self.getMultirotorState().gps_location

    def getPitchRollYaw(self) -> tuple[float, float, float]:
        return self.toEulerianAngle(self.getOrientation())

    getRollPitchYaw = getPitchRollYaw

    def getRCData(self) -> RCData:
        return self.getMultirotorState().rc_data

    def setRCData(self, rcdata: RCData | None = None) -> None:
        self.moveByRC(rcdata)

    def timestampNow(self) -> int:
        return self.getMultirotorState().timestamp

    def isSimulationMode(self) -> bool:
        return True

    def getServerDebugInfo(self) -> str:
        return ""

    # --- commands ---------------------------------------------------------------------------------

    def moveByAngle(self, pitch: float, roll: float, z: float, yaw: float, duration: float) -> bool:
        """Fly at these angles with the wire's signs, which later clients reverse: positive is nose up, and right."""
        self.moveByRollPitchYawZAsync(roll, -pitch, -yaw, z, duration)
        return True

    moveByAngleZ = moveByAngle

    moveByVelocity = _begun(client.MultirotorClient.moveByVelocityAsync)
    moveByVelocityZ = _begun(client.MultirotorClient.moveByVelocityZAsync)
    moveByManual = _begun(client.MultirotorClient.moveByManualAsync)
    rotateByYawRate = _begun(client.MultirotorClient.rotateByYawRateAsync)

    def moveOnPath(
        self, path: Sequence[Vector3r], velocity: float, max_wait_seconds: float = 60,
        drivetrain: int = TURN_FREELY, yaw_mode: YawMode = NO_TURN, lookahead: float = -1,
        adaptive_lookahead: float = 1,
    ) -> bool:  # fmt: skip
        how = (drivetrain, yaw_mode, lookahead, adaptive_lookahead)
        return _waited(lambda limit_s: self.moveOnPathAsync(path, velocity, limit_s, *how), max_wait_seconds)

    def moveToZ(
        self, z: float, velocity: float, max_wait_seconds: float = 60, yaw_mode: YawMode = NO_TURN,
        lookahead: float = -1, adaptive_lookahead: float = 1,
    ) -> bool:  # fmt: skip
        how = (yaw_mode, lookahead, adaptive_lookahead)
        return _waited(lambda limit_s: self.moveToZAsync(z, velocity, limit_s, *how), max_wait_seconds)

    def moveToPosition(
        self, x: float, y: float, z: float, velocity: float, max_wait_seconds: float = 60,
        drivetrain: int = TURN_FREELY, yaw_mode: YawMode = NO_TURN, lookahead: float = -1,
        adaptive_lookahead: float = 1,
    ) -> bool:  # fmt: skip
        how = (drivetrain, yaw_mode, lookahead, adaptive_lookahead)
        return _waited(lambda limit_s: self.moveToPositionAsync(x, y, z, velocity, limit_s, *how), max_wait_seconds)

    def rotateToYaw(self, yaw: float, max_wait_seconds: float = 60, margin: float = 5) -> bool:
        return _waited(lambda limit_s: self.rotateToYawAsync(yaw, limit_s, margin), max_wait_seconds)


CarClient = client.CarClient
