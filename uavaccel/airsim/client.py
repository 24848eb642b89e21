"""AirSim's client of a multirotor.

Source of names, defaults and parameter orders: AirSim v1.8.1, PythonClient/airsim/client.py.
"""

# ruff: noqa: N802  the names are AirSim's

from __future__ import annotations

import logging
from collections.abc import Sequence

from uavaccel.airsim.connection import Mirrored, remote
from uavaccel.airsim.types import (
    AngleLevelControllerGains,
    AngleRateControllerGains,
    DrivetrainType,
    MultirotorState,
    PositionControllerGains,
    RCData,
    RotorStates,
    Vector3r,
    VelocityControllerGains,
    YawMode,
)
from uavaccel.airsim.vehicle_client import VehicleClient
from uavaccel.wire.rpc import Future

__all__ = ["CarClient", "MultirotorClient", "VehicleClient"]

FOR_EVER = 3e38  # seconds
TURN_FREELY = DrivetrainType.MaxDegreeOfFreedom
NO_TURN = YawMode()


class MultirotorClient(VehicleClient):
    """The calls of a multirotor.

    Every command returns a `Future` at once; its `join` waits until the command has ended. Speeds are in metres per
    second, durations and time-outs in simulated seconds, and angles in radians, except those of YawMode and
    rotateToYaw. In the commands that set an attitude, a positive pitch raises the nose and a positive yaw turns it to
    the left; on the wire both signs are the opposite ones.
    """

    # --- take-off and landing ---------------------------------------------------------------------

    @remote
    def takeoffAsync(self, timeout_sec: float = 20, vehicle_name: str = "") -> Future: ...
    @remote
    def landAsync(self, timeout_sec: float = 60, vehicle_name: str = "") -> Future: ...
    @remote
    def goHomeAsync(self, timeout_sec: float = FOR_EVER, vehicle_name: str = "") -> Future: ...
    @remote
    def hoverAsync(self, vehicle_name: str = "") -> Future: ...

    # --- velocities -----------------------------------------------------------------------------

    @remote
    def moveByVelocityAsync(
        self, vx: float, vy: float, vz: float, duration: float, drivetrain: int = TURN_FREELY,
        yaw_mode: YawMode = NO_TURN, vehicle_name: str = "",
    ) -> Future: ...  # fmt: skip
    @remote
    def moveByVelocityZAsync(
        self, vx: float, vy: float, z: float, duration: float, drivetrain: int = TURN_FREELY,
        yaw_mode: YawMode = NO_TURN, vehicle_name: str = "",
    ) -> Future: ...  # fmt: skip
    @remote
    def moveByVelocityBodyFrameAsync(
        self, vx: float, vy: float, vz: float, duration: float, drivetrain: int = TURN_FREELY,
        yaw_mode: YawMode = NO_TURN, vehicle_name: str = "",
    ) -> Future: ...  # fmt: skip
    @remote
    def moveByVelocityZBodyFrameAsync(
        self, vx: float, vy: float, z: float, duration: float, drivetrain: int = TURN_FREELY,
        yaw_mode: YawMode = NO_TURN, vehicle_name: str = "",
    ) -> Future: ...  # fmt: skip
    @remote
    def moveByManualAsync(
        self, vx_max: float, vy_max: float, z_min: float, duration: float,
        drivetrain: int = TURN_FREELY, yaw_mode: YawMode = NO_TURN, vehicle_name: str = "",
    ) -> Future: ...  # fmt: skip

    # --- places ---------------------------------------------------------------------------------

    @remote
    def moveToPositionAsync(
        self, x: float, y: float, z: float, velocity: float, timeout_sec: float = FOR_EVER,
        drivetrain: int = TURN_FREELY, yaw_mode: YawMode = NO_TURN, lookahead: float = -1,
        adaptive_lookahead: float = 1, vehicle_name: str = "",
    ) -> Future: ...  # fmt: skip
    @remote
    def moveOnPathAsync(
        self, path: Sequence[Vector3r], velocity: float, timeout_sec: float = FOR_EVER,
        drivetrain: int = TURN_FREELY, yaw_mode: YawMode = NO_TURN, lookahead: float = -1,
        adaptive_lookahead: float = 1, vehicle_name: str = "",
    ) -> Future: ...  # fmt: skip
    @remote
    def moveToZAsync(
        self, z: float, velocity: float, timeout_sec: float = FOR_EVER, yaw_mode: YawMode = NO_TURN,
        lookahead: float = -1, adaptive_lookahead: float = 1, vehicle_name: str = "",
    ) -> Future: ...  # fmt: skip
    @remote
    def moveToGPSAsync(
        self, latitude: float, longitude: float, altitude: float, velocity: float,
        timeout_sec: float = FOR_EVER, drivetrain: int = TURN_FREELY, yaw_mode: YawMode = NO_TURN,
        lookahead: float = -1, adaptive_lookahead: float = 1, vehicle_name: str = "",
    ) -> Future: ...  # fmt: skip
    @remote
    def rotateToYawAsync(
        self, yaw: float, timeout_sec: float = FOR_EVER, margin: float = 5, vehicle_name: str = ""
    ) -> Future:
        """Turn to a yaw in degrees."""

    @remote
    def rotateByYawRateAsync(self, yaw_rate: float, duration: float, vehicle_name: str = "") -> Future:
        """Turn at a rate in degrees per second."""

    # --- attitude, rates, motors ----------------------------------------------------------------

    @remote
    def moveByRollPitchYawZAsync(
        self, roll: float, pitch: Mirrored, yaw: Mirrored, z: float, duration: float, vehicle_name: str = ""
    ) -> Future: ...
    @remote
    def moveByRollPitchYawThrottleAsync(
        self, roll: float, pitch: Mirrored, yaw: Mirrored, throttle: float, duration: float,
        vehicle_name: str = "",
    ) -> Future: ...  # fmt: skip
    @remote
    def moveByRollPitchYawrateThrottleAsync(
        self, roll: float, pitch: Mirrored, yaw_rate: Mirrored, throttle: float, duration: float,
        vehicle_name: str = "",
    ) -> Future: ...  # fmt: skip
    @remote
    def moveByRollPitchYawrateZAsync(
        self, roll: float, pitch: Mirrored, yaw_rate: Mirrored, z: float, duration: float,
        vehicle_name: str = "",
    ) -> Future: ...  # fmt: skip
    @remote
    def moveByAngleRatesZAsync(
        self, roll_rate: float, pitch_rate: Mirrored, yaw_rate: Mirrored, z: float, duration: float,
        vehicle_name: str = "",
    ) -> Future: ...  # fmt: skip
    @remote
    def moveByAngleRatesThrottleAsync(
        self, roll_rate: float, pitch_rate: Mirrored, yaw_rate: Mirrored, throttle: float,
        duration: float, vehicle_name: str = "",
    ) -> Future: ...  # fmt: skip
    @remote
    def moveByMotorPWMsAsync(
        self, front_right_pwm: float, rear_left_pwm: float, front_left_pwm: float,
        rear_right_pwm: float, duration: float, vehicle_name: str = "",
    ) -> Future:  # fmt: skip
        """Set the motors' PWM values, from 0 to 1."""

    def moveByAngleZAsync(
        self, pitch: float, roll: float, z: float, yaw: float, duration: float, vehicle_name: str = ""
    ) -> Future:
        logging.warning("moveByAngleZAsync API is deprecated, use moveByRollPitchYawZAsync() API instead")
        return self.moveByRollPitchYawZAsync(roll, pitch, yaw, z, duration, vehicle_name)

    def moveByAngleThrottleAsync(
        self, pitch: float, roll: float, throttle: float, yaw_rate: float, duration: float,
        vehicle_name: str = "",
    ) -> Future:  # fmt: skip
        logging.warning(
            "moveByAngleThrottleAsync API is deprecated, use moveByRollPitchYawrateThrottleAsync() API instead"
        )
        return self.moveByRollPitchYawrateThrottleAsync(roll, pitch, yaw_rate, throttle, duration, vehicle_name)

    def moveByRC(self, rcdata: RCData | None = None, vehicle_name: str = "") -> None:
        """Set the sticks of the remote control by which moveByManual flies."""
        self.client.call("moveByRC", RCData() if rcdata is None else rcdata, vehicle_name)

    # --- gains ----------------------------------------------------------------------------------

    def setAngleRateControllerGains(
        self, angle_rate_gains: AngleRateControllerGains | None = None, vehicle_name: str = ""
    ) -> None:
        gains = angle_rate_gains or AngleRateControllerGains()
        self.client.call("setAngleRateControllerGains", *gains.to_lists(), vehicle_name)

    def setAngleLevelControllerGains(
        self, angle_level_gains: AngleLevelControllerGains | None = None, vehicle_name: str = ""
    ) -> None:
        gains = angle_level_gains or AngleLevelControllerGains()
        self.client.call("setAngleLevelControllerGains", *gains.to_lists(), vehicle_name)

    def setVelocityControllerGains(
        self, velocity_gains: VelocityControllerGains | None = None, vehicle_name: str = ""
    ) -> None:
        gains = velocity_gains or VelocityControllerGains()
        self.client.call("setVelocityControllerGains", *gains.to_lists(), vehicle_name)

    def setPositionControllerGains(
        self, position_gains: PositionControllerGains | None = None, vehicle_name: str = ""
    ) -> None:
        gains = position_gains or PositionControllerGains()
        self.client.call("setPositionControllerGains", *gains.to_lists(), vehicle_name)

    # --- state ----------------------------------------------------------------------------------

    @remote
    def getMultirotorState(self, vehicle_name: str = "") -> MultirotorState: ...
    @remote
    def getRotorStates(self, vehicle_name: str = "") -> RotorStates: ...


class CarClient(VehicleClient):
    """A name for scripts that import it. Raises NotImplementedError: there is no car here."""

    def __init__(self, *arguments: object, **options: object) -> None:
        raise NotImplementedError("uavaccel simulates multirotors; there is no car")
