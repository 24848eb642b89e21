"""The calls of AirSim's multirotor client: commands, gains, state.

Every command returns at once a `Future`, whose `join` waits until the command has ended. Speeds are metres per second,
durations and time-outs simulated seconds, angles radians but for those of YawMode and rotateToYaw. Pitch and yaw of
the commands that turn the body are positive with the nose up and to the left; on the wire it is the other way round.
"""

# ruff: noqa: N802  the names are AirSim's

from __future__ import annotations

import logging
from collections.abc import Sequence

from uavaccel.airsim.calls import Calls, Mirrored, remote
from uavaccel.airsim.connection import Future
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

FOR_EVER = 3e38  # seconds
TURN_FREELY = DrivetrainType.MaxDegreeOfFreedom
NO_TURN = YawMode()


class MultirotorCalls(Calls):
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
        self,
        vx: float,
        vy: float,
        vz: float,
        duration: float,
        drivetrain: int = TURN_FREELY,
        yaw_mode: YawMode = NO_TURN,
        vehicle_name: str = "",
    ) -> Future: ...

    @remote
    def moveByVelocityZAsync(
        self,
        vx: float,
        vy: float,
        z: float,
        duration: float,
        drivetrain: int = TURN_FREELY,
        yaw_mode: YawMode = NO_TURN,
        vehicle_name: str = "",
    ) -> Future: ...

    @remote
    def moveByVelocityBodyFrameAsync(
        self,
        vx: float,
        vy: float,
        vz: float,
        duration: float,
        drivetrain: int = TURN_FREELY,
        yaw_mode: YawMode = NO_TURN,
        vehicle_name: str = "",
    ) -> Future: ...

    @remote
    def moveByVelocityZBodyFrameAsync(
        self,
        vx: float,
        vy: float,
        z: float,
        duration: float,
        drivetrain: int = TURN_FREELY,
        yaw_mode: YawMode = NO_TURN,
        vehicle_name: str = "",
    ) -> Future: ...

    @remote
    def moveByManualAsync(
        self,
        vx_max: float,
        vy_max: float,
        z_min: float,
        duration: float,
        drivetrain: int = TURN_FREELY,
        yaw_mode: YawMode = NO_TURN,
        vehicle_name: str = "",
    ) -> Future: ...

    # --- places ---------------------------------------------------------------------------------

    @remote
    def moveToPositionAsync(
        self,
        x: float,
        y: float,
        z: float,
        velocity: float,
        timeout_sec: float = FOR_EVER,
        drivetrain: int = TURN_FREELY,
        yaw_mode: YawMode = NO_TURN,
        lookahead: float = -1,
        adaptive_lookahead: float = 1,
        vehicle_name: str = "",
    ) -> Future: ...

    @remote
    def moveOnPathAsync(
        self,
        path: Sequence[Vector3r],
        velocity: float,
        timeout_sec: float = FOR_EVER,
        drivetrain: int = TURN_FREELY,
        yaw_mode: YawMode = NO_TURN,
        lookahead: float = -1,
        adaptive_lookahead: float = 1,
        vehicle_name: str = "",
    ) -> Future: ...

    @remote
    def moveToZAsync(
        self,
        z: float,
        velocity: float,
        timeout_sec: float = FOR_EVER,
        yaw_mode: YawMode = NO_TURN,
        lookahead: float = -1,
        adaptive_lookahead: float = 1,
        vehicle_name: str = "",
    ) -> Future: ...

    @remote
    def moveToGPSAsync(
        self,
        latitude: float,
        longitude: float,
        altitude: float,
        velocity: float,
        timeout_sec: float = FOR_EVER,
        drivetrain: int = TURN_FREELY,
        yaw_mode: YawMode = NO_TURN,
        lookahead: float = -1,
        adaptive_lookahead: float = 1,
        vehicle_name: str = "",
    ) -> Future: ...

    @remote
    def rotateToYawAsync(
        self, yaw: float, timeout_sec: float = FOR_EVER, margin: float = 5, vehicle_name: str = ""
    ) -> Future:
        """Degrees."""

    @remote
    def rotateByYawRateAsync(self, yaw_rate: float, duration: float, vehicle_name: str = "") -> Future:
        """Degrees per second."""

    # --- attitude, rates, motors ----------------------------------------------------------------

    @remote
    def moveByRollPitchYawZAsync(
        self, roll: float, pitch: Mirrored, yaw: Mirrored, z: float, duration: float, vehicle_name: str = ""
    ) -> Future: ...

    @remote
    def moveByRollPitchYawThrottleAsync(
        self,
        roll: float,
        pitch: Mirrored,
        yaw: Mirrored,
        throttle: float,
        duration: float,
        vehicle_name: str = "",
    ) -> Future: ...

    @remote
    def moveByRollPitchYawrateThrottleAsync(
        self,
        roll: float,
        pitch: Mirrored,
        yaw_rate: Mirrored,
        throttle: float,
        duration: float,
        vehicle_name: str = "",
    ) -> Future: ...

    @remote
    def moveByRollPitchYawrateZAsync(
        self,
        roll: float,
        pitch: Mirrored,
        yaw_rate: Mirrored,
        z: float,
        duration: float,
        vehicle_name: str = "",
    ) -> Future: ...

    @remote
    def moveByAngleRatesZAsync(
        self,
        roll_rate: float,
        pitch_rate: Mirrored,
        yaw_rate: Mirrored,
        z: float,
        duration: float,
        vehicle_name: str = "",
    ) -> Future: ...

    @remote
    def moveByAngleRatesThrottleAsync(
        self,
        roll_rate: float,
        pitch_rate: Mirrored,
        yaw_rate: Mirrored,
        throttle: float,
        duration: float,
        vehicle_name: str = "",
    ) -> Future: ...

    @remote
    def moveByMotorPWMsAsync(
        self,
        front_right_pwm: float,
        rear_left_pwm: float,
        front_left_pwm: float,
        rear_right_pwm: float,
        duration: float,
        vehicle_name: str = "",
    ) -> Future:
        """0 to 1."""

    def moveByAngleZAsync(
        self, pitch: float, roll: float, z: float, yaw: float, duration: float, vehicle_name: str = ""
    ) -> Future:
        logging.warning("moveByAngleZAsync API is deprecated, use moveByRollPitchYawZAsync() API instead")
        return self.moveByRollPitchYawZAsync(roll, pitch, yaw, z, duration, vehicle_name)

    def moveByAngleThrottleAsync(
        self,
        pitch: float,
        roll: float,
        throttle: float,
        yaw_rate: float,
        duration: float,
        vehicle_name: str = "",
    ) -> Future:
        logging.warning(
            "moveByAngleThrottleAsync API is deprecated, use moveByRollPitchYawrateThrottleAsync() API instead"
        )
        return self.moveByRollPitchYawrateThrottleAsync(
            roll, pitch, yaw_rate, throttle, duration, vehicle_name
        )

    def moveByRC(self, rcdata: RCData | None = None, vehicle_name: str = "") -> None:
        """Sticks for a vehicle that moveByManual flies."""
        self.client.call("moveByRC", RCData() if rcdata is None else rcdata, vehicle_name)

    # --- gains ----------------------------------------------------------------------------------

    def setAngleRateControllerGains(
        self, angle_rate_gains: AngleRateControllerGains | None = None, vehicle_name: str = ""
    ) -> None:
        gains = AngleRateControllerGains() if angle_rate_gains is None else angle_rate_gains
        self.client.call("setAngleRateControllerGains", *gains.to_lists(), vehicle_name)

    def setAngleLevelControllerGains(
        self, angle_level_gains: AngleLevelControllerGains | None = None, vehicle_name: str = ""
    ) -> None:
        gains = AngleLevelControllerGains() if angle_level_gains is None else angle_level_gains
        self.client.call("setAngleLevelControllerGains", *gains.to_lists(), vehicle_name)

    def setVelocityControllerGains(
        self, velocity_gains: VelocityControllerGains | None = None, vehicle_name: str = ""
    ) -> None:
        gains = VelocityControllerGains() if velocity_gains is None else velocity_gains
        self.client.call("setVelocityControllerGains", *gains.to_lists(), vehicle_name)

    def setPositionControllerGains(
        self, position_gains: PositionControllerGains | None = None, vehicle_name: str = ""
    ) -> None:
        gains = PositionControllerGains() if position_gains is None else position_gains
        self.client.call("setPositionControllerGains", *gains.to_lists(), vehicle_name)

    # --- state ----------------------------------------------------------------------------------

    @remote
    def getMultirotorState(self, vehicle_name: str = "") -> MultirotorState: ...

    @remote
    def getRotorStates(self, vehicle_name: str = "") -> RotorStates: ...
