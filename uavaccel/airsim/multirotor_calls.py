"""The calls of AirSim's multirotor client: commands, gains, state.

Every command returns at once a `Future`, whose `join` waits until the command has ended. Speeds are metres per second,
durations and time-outs simulated seconds, angles radians but for those of YawMode and rotateToYaw. Pitch and yaw of
the commands that turn the body are positive with the nose up and to the left; on the wire it is the other way round.
"""

# ruff: noqa: N802  the names are AirSim's

from __future__ import annotations

import logging
from collections.abc import Sequence

from uavaccel.airsim.calls import Calls
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

    def takeoffAsync(self, timeout_sec: float = 20, vehicle_name: str = "") -> Future:
        return self.client.call_async("takeoff", timeout_sec, vehicle_name)

    def landAsync(self, timeout_sec: float = 60, vehicle_name: str = "") -> Future:
        return self.client.call_async("land", timeout_sec, vehicle_name)

    def goHomeAsync(self, timeout_sec: float = FOR_EVER, vehicle_name: str = "") -> Future:
        return self.client.call_async("goHome", timeout_sec, vehicle_name)

    def hoverAsync(self, vehicle_name: str = "") -> Future:
        return self.client.call_async("hover", vehicle_name)

    # --- velocities -----------------------------------------------------------------------------

    def moveByVelocityAsync(
        self,
        vx: float,
        vy: float,
        vz: float,
        duration: float,
        drivetrain: int = TURN_FREELY,
        yaw_mode: YawMode = NO_TURN,
        vehicle_name: str = "",
    ) -> Future:
        return self.client.call_async(
            "moveByVelocity", vx, vy, vz, duration, drivetrain, yaw_mode, vehicle_name
        )

    def moveByVelocityZAsync(
        self,
        vx: float,
        vy: float,
        z: float,
        duration: float,
        drivetrain: int = TURN_FREELY,
        yaw_mode: YawMode = NO_TURN,
        vehicle_name: str = "",
    ) -> Future:
        return self.client.call_async(
            "moveByVelocityZ", vx, vy, z, duration, drivetrain, yaw_mode, vehicle_name
        )

    def moveByVelocityBodyFrameAsync(
        self,
        vx: float,
        vy: float,
        vz: float,
        duration: float,
        drivetrain: int = TURN_FREELY,
        yaw_mode: YawMode = NO_TURN,
        vehicle_name: str = "",
    ) -> Future:
        return self.client.call_async(
            "moveByVelocityBodyFrame", vx, vy, vz, duration, drivetrain, yaw_mode, vehicle_name
        )

    def moveByVelocityZBodyFrameAsync(
        self,
        vx: float,
        vy: float,
        z: float,
        duration: float,
        drivetrain: int = TURN_FREELY,
        yaw_mode: YawMode = NO_TURN,
        vehicle_name: str = "",
    ) -> Future:
        return self.client.call_async(
            "moveByVelocityZBodyFrame", vx, vy, z, duration, drivetrain, yaw_mode, vehicle_name
        )

    def moveByManualAsync(
        self,
        vx_max: float,
        vy_max: float,
        z_min: float,
        duration: float,
        drivetrain: int = TURN_FREELY,
        yaw_mode: YawMode = NO_TURN,
        vehicle_name: str = "",
    ) -> Future:
        return self.client.call_async(
            "moveByManual", vx_max, vy_max, z_min, duration, drivetrain, yaw_mode, vehicle_name
        )

    # --- places ---------------------------------------------------------------------------------

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
    ) -> Future:
        return self.client.call_async(
            "moveToPosition",
            x,
            y,
            z,
            velocity,
            timeout_sec,
            drivetrain,
            yaw_mode,
            lookahead,
            adaptive_lookahead,
            vehicle_name,
        )

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
    ) -> Future:
        return self.client.call_async(
            "moveOnPath",
            path,
            velocity,
            timeout_sec,
            drivetrain,
            yaw_mode,
            lookahead,
            adaptive_lookahead,
            vehicle_name,
        )

    def moveToZAsync(
        self,
        z: float,
        velocity: float,
        timeout_sec: float = FOR_EVER,
        yaw_mode: YawMode = NO_TURN,
        lookahead: float = -1,
        adaptive_lookahead: float = 1,
        vehicle_name: str = "",
    ) -> Future:
        return self.client.call_async(
            "moveToZ", z, velocity, timeout_sec, yaw_mode, lookahead, adaptive_lookahead, vehicle_name
        )

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
    ) -> Future:
        return self.client.call_async(
            "moveToGPS",
            latitude,
            longitude,
            altitude,
            velocity,
            timeout_sec,
            drivetrain,
            yaw_mode,
            lookahead,
            adaptive_lookahead,
            vehicle_name,
        )

    def rotateToYawAsync(
        self, yaw: float, timeout_sec: float = FOR_EVER, margin: float = 5, vehicle_name: str = ""
    ) -> Future:
        """Degrees."""
        return self.client.call_async("rotateToYaw", yaw, timeout_sec, margin, vehicle_name)

    def rotateByYawRateAsync(self, yaw_rate: float, duration: float, vehicle_name: str = "") -> Future:
        """Degrees per second."""
        return self.client.call_async("rotateByYawRate", yaw_rate, duration, vehicle_name)

    # --- attitude, rates, motors ----------------------------------------------------------------

    def moveByRollPitchYawZAsync(
        self, roll: float, pitch: float, yaw: float, z: float, duration: float, vehicle_name: str = ""
    ) -> Future:
        return self.client.call_async("moveByRollPitchYawZ", roll, -pitch, -yaw, z, duration, vehicle_name)

    def moveByRollPitchYawThrottleAsync(
        self, roll: float, pitch: float, yaw: float, throttle: float, duration: float, vehicle_name: str = ""
    ) -> Future:
        return self.client.call_async(
            "moveByRollPitchYawThrottle", roll, -pitch, -yaw, throttle, duration, vehicle_name
        )

    def moveByRollPitchYawrateThrottleAsync(
        self,
        roll: float,
        pitch: float,
        yaw_rate: float,
        throttle: float,
        duration: float,
        vehicle_name: str = "",
    ) -> Future:
        return self.client.call_async(
            "moveByRollPitchYawrateThrottle", roll, -pitch, -yaw_rate, throttle, duration, vehicle_name
        )

    def moveByRollPitchYawrateZAsync(
        self, roll: float, pitch: float, yaw_rate: float, z: float, duration: float, vehicle_name: str = ""
    ) -> Future:
        return self.client.call_async(
            "moveByRollPitchYawrateZ", roll, -pitch, -yaw_rate, z, duration, vehicle_name
        )

    def moveByAngleRatesZAsync(
        self,
        roll_rate: float,
        pitch_rate: float,
        yaw_rate: float,
        z: float,
        duration: float,
        vehicle_name: str = "",
    ) -> Future:
        return self.client.call_async(
            "moveByAngleRatesZ", roll_rate, -pitch_rate, -yaw_rate, z, duration, vehicle_name
        )

    def moveByAngleRatesThrottleAsync(
        self,
        roll_rate: float,
        pitch_rate: float,
        yaw_rate: float,
        throttle: float,
        duration: float,
        vehicle_name: str = "",
    ) -> Future:
        return self.client.call_async(
            "moveByAngleRatesThrottle", roll_rate, -pitch_rate, -yaw_rate, throttle, duration, vehicle_name
        )

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
        return self.client.call_async(
            "moveByMotorPWMs",
            front_right_pwm,
            rear_left_pwm,
            front_left_pwm,
            rear_right_pwm,
            duration,
            vehicle_name,
        )

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

    def getMultirotorState(self, vehicle_name: str = "") -> MultirotorState:
        return MultirotorState.from_msgpack(self.client.call("getMultirotorState", vehicle_name))

    def getRotorStates(self, vehicle_name: str = "") -> RotorStates:
        return RotorStates.from_msgpack(self.client.call("getRotorStates", vehicle_name))
