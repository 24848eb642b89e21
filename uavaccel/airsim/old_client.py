"""AirSim's client before 1.2, the module `AirSimClient`: one vehicle, cameras by number, commands without futures.

A command with a `duration` returns at once; one with `max_wait_seconds` waits for its end, at most for that long.
Source of names, defaults and parameter orders: AirSim v1.1, PythonClient/AirSimClient.py and docs/apis.md.
"""

# ruff: noqa: F403, N802, N815  the names are AirSim's, and all of it is for scripts

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from typing import ParamSpec

from uavaccel.airsim import client, utils
from uavaccel.airsim.client import FOR_EVER
from uavaccel.airsim.types import *
from uavaccel.airsim.types import CameraInfo, CollisionInfo, GeoPoint, ImageType, Pose, Quaternionr, RCData, Vector3r
from uavaccel.airsim.utils import *
from uavaccel.wire.rpc import Future

AirSimImageType = ImageType

Arguments = ParamSpec("Arguments")


def _waited(command: Callable[..., Future], limit_s: float) -> Callable[..., bool]:
    """Return a command whose `timeout_sec` is its `max_wait_seconds`, by default `limit_s`, and is waited for.

    It returns the command's result; True at once for 0. Raises RpcError.
    """
    declared = inspect.signature(command)
    given = declared.parameters.copy()
    parameters = [each.replace(default=limit_s) if name == "timeout_sec" else each for name, each in given.items()]
    renamed = [each.replace(name=each.name.replace("timeout_sec", "max_wait_seconds")) for each in parameters]
    signature = declared.replace(parameters=[each for each in renamed if each.name != "vehicle_name"])

    def wait(*arguments: object, **named: object) -> bool:
        bound = signature.bind(*arguments, **named)
        bound.apply_defaults()
        limit_s: float = bound.arguments["max_wait_seconds"]
        bound.arguments["max_wait_seconds"] = limit_s if limit_s > 0 else FOR_EVER
        begun = command(*bound.args)
        return bool(begun.get()) if limit_s > 0 else True

    wait.__signature__ = signature  # type: ignore[attr-defined]
    return wait


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

    takeoff = _waited(client.MultirotorClient.takeoffAsync, 15)
    land = _waited(client.MultirotorClient.landAsync, 60)
    moveOnPath = _waited(client.MultirotorClient.moveOnPathAsync, 60)
    moveToZ = _waited(client.MultirotorClient.moveToZAsync, 60)
    moveToPosition = _waited(client.MultirotorClient.moveToPositionAsync, 60)
    rotateToYaw = _waited(client.MultirotorClient.rotateToYawAsync, 60)

    def goHome(self) -> bool:
        return bool(self.goHomeAsync().get())

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


CarClient = client.CarClient
