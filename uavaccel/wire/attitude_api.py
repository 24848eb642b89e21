"""AirSim's commands below velocities: attitudes, body rates, throttle, motors, the remote control, and the gains.

Sources: AirSim v1.8.1, MultirotorRpcLibServer.cpp, SimpleFlightApi.hpp. Angles are in radians, FRD, throttle and motors
from 0 to 1.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Annotated

import numpy as np

from uavaccel.kinematics import Vector
from uavaccel.sim.vehicle import goal as goals
from uavaccel.sim.vehicle.autopilot import POSITION, THROTTLE
from uavaccel.sim.vehicle.goal import RATE_MODE, STICKS, VALID, Goal, Sticks, Yaw
from uavaccel.wire.arguments import VehicleName, flag, number
from uavaccel.wire.calls import Calls, call, command
from uavaccel.wire.flight_api import Answer, Seconds, fly_for

LARGEST_GAIN = 1e3  # thousands of times SimpleFlight's own
STICK_NAMES = ("roll", "pitch", "throttle", "yaw")  # in the order of manual.Sticks


def gains(value: object, name: str) -> Vector:
    """Of three axes."""
    if not isinstance(value, list) or len(value) != 3:
        raise ValueError(f"{name} must be a list of three gains")
    a, b, c = (number(each, name) for each in value)
    if max(abs(a), abs(b), abs(c)) > LARGEST_GAIN:
        raise ValueError(f"{name} must be within {LARGEST_GAIN:g}, not {value}")
    return a, b, c


def sticks(value: object, name: str) -> Sticks:
    """RCData."""
    if not isinstance(value, Mapping):
        raise ValueError(f"{name} must be a map, not {type(value).__name__}")
    positions = np.zeros(STICKS)
    for index, stick in enumerate(STICK_NAMES):
        positions[index] = number(value.get(stick, 0.0), stick)
    positions[RATE_MODE] = int(number(value.get("switches", 0), "switches")) & 1
    positions[VALID] = flag(value.get("is_valid", False), "is_valid")
    return positions


Gains = Annotated[Vector, gains]


def _fly(calls: Calls, goal: Goal, duration_s: float, vehicle: str) -> Answer:
    return fly_for(calls.scenery.flying_pilot(vehicle), goal, duration_s, calls.wall_ns)


def _by_angles(name: str, yaw_is_rate: bool, z_mode: int) -> Callable[..., Answer]:
    """A command for an attitude, whose yaw may be a rate and whose z a throttle."""

    @command(name)
    def move(
        self: Calls,
        roll: float,
        pitch: float,
        yaw: float,
        z: float,
        duration: Seconds,
        vehicle: VehicleName = "",
    ) -> Answer:
        return _fly(self, goals.attitude(roll, pitch, Yaw(yaw, yaw_is_rate), z, z_mode), duration, vehicle)

    return move


def _by_rates(name: str, z_mode: int) -> Callable[..., Answer]:
    """A command for body rates, whose z may be a throttle."""

    @command(name)
    def move(
        self: Calls,
        roll_rate: float,
        pitch_rate: float,
        yaw_rate: float,
        z: float,
        duration: Seconds,
        vehicle: VehicleName = "",
    ) -> Answer:
        return _fly(self, goals.body_rates(roll_rate, pitch_rate, yaw_rate, z, z_mode), duration, vehicle)

    return move


def _set_gains(name: str, level: str) -> Callable[..., None]:
    """A call that sets the gains of one level of the cascade."""

    @call(name)
    def set_gains(self: Calls, kp: Gains, ki: Gains, kd: Gains, vehicle: VehicleName = "") -> None:
        self.scenery.flying_pilot(vehicle).vehicle.set_gains(level, kp, ki, kd)

    return set_gains


class AttitudeApi(Calls, title="Flight"):
    move_by_angles_z = _by_angles("moveByRollPitchYawZ", False, POSITION)
    move_by_angles_throttle = _by_angles("moveByRollPitchYawThrottle", False, THROTTLE)
    move_by_yaw_rate_z = _by_angles("moveByRollPitchYawrateZ", True, POSITION)
    move_by_yaw_rate_throttle = _by_angles("moveByRollPitchYawrateThrottle", True, THROTTLE)
    move_by_rates_z = _by_rates("moveByAngleRatesZ", POSITION)
    move_by_rates_throttle = _by_rates("moveByAngleRatesThrottle", THROTTLE)
    set_rate_gains = _set_gains("setAngleRateControllerGains", "rate")
    set_angle_gains = _set_gains("setAngleLevelControllerGains", "angle")
    set_velocity_gains = _set_gains("setVelocityControllerGains", "velocity")
    set_position_gains = _set_gains("setPositionControllerGains", "position")

    @command("moveByMotorPWMs")
    def move_by_motor_pwms(
        self,
        front_right_pwm: float,
        rear_left_pwm: float,
        front_left_pwm: float,
        rear_right_pwm: float,
        duration: Seconds,
        vehicle: VehicleName = "",
    ) -> Answer:
        goal = goals.motors(front_right_pwm, rear_left_pwm, front_left_pwm, rear_right_pwm)
        return _fly(self, goal, duration, vehicle)

    @call("moveByRC")
    def move_by_rc(self, rcdata: Annotated[Sticks, sticks], vehicle: VehicleName = "") -> None:
        """The sticks of a remote control: they fly the vehicle while no program has control, and moveByManual."""
        self.scenery.flying_pilot(vehicle).move_sticks(rcdata)


def stick_map(sticks: Sticks) -> dict[str, object]:
    """What of RCData the sticks are."""
    valid = bool(sticks[VALID])
    names = zip(STICK_NAMES, sticks[: len(STICK_NAMES)].tolist(), strict=True)
    return {**dict(names), "switches": int(sticks[RATE_MODE]), "is_initialized": valid, "is_valid": valid}
