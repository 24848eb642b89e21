"""The state of the drone at one instant, and velocity goals, as commands, wire and simulation exchange them."""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass
from typing import ClassVar

import numpy as np

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True)
class Kinematics:
    """Ground truth at `time_ns` of simulated time: NED world frame, angular quantities in the FRD body frame."""

    time_ns: int
    position_m: Vector
    orientation_wxyz: Quaternion
    linear_velocity_m_s: Vector
    angular_velocity_rad_s: Vector
    linear_acceleration_m_s2: Vector = (0.0, 0.0, 0.0)
    angular_acceleration_rad_s2: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class VelocityGoal:
    """The goal of AirSim's `moveByVelocity` and, where a height is held, `moveByVelocityZ`: NED, m/s.

    `height_m` is NED z (negative above the origin); `yaw` is rad/s, or rad where `yaw_is_rate` is false.
    """

    velocity_m_s: Vector
    height_m: float | None = None
    yaw: float = 0.0
    yaw_is_rate: bool = True


@dataclass(frozen=True, slots=True)
class AttitudeGoal:
    """What AirSim's `moveByRollPitchYawrateThrottle` asks for: rad and rad/s in the FRD body frame, throttle 0 to 1."""

    airsim_name: ClassVar[str] = "moveByRollPitchYawrateThrottle"
    roll_rad: float
    pitch_rad: float
    yaw_rate_rad_s: float
    throttle: float


@dataclass(frozen=True, slots=True)
class BodyRatesGoal:
    """What AirSim's `moveByAngleRatesThrottle` asks for: rad/s in the FRD body frame, throttle 0 to 1."""

    airsim_name: ClassVar[str] = "moveByAngleRatesThrottle"
    roll_rad_s: float
    pitch_rad_s: float
    yaw_rad_s: float
    throttle: float


@dataclass(frozen=True, slots=True)
class MotorsGoal:
    """What AirSim's `moveByMotorPWMs` asks for: each motor's control signal, 0 to 1, past controllers and mixer."""

    airsim_name: ClassVar[str] = "moveByMotorPWMs"
    front_right: float
    rear_left: float
    front_left: float
    rear_right: float


FlightGoal = VelocityGoal | AttitudeGoal | BodyRatesGoal | MotorsGoal
"""What a synchronous command flies for T_move."""

_MAX_DEGREE_OF_FREEDOM = 0


def airsim_command(goal: FlightGoal, t_move_s: float) -> tuple[str, tuple[object, ...]]:
    """Return AirSim's command for a goal, and its arguments before the vehicle's name."""
    if not isinstance(goal, VelocityGoal):
        return goal.airsim_name, (*map(_plain, astuple(goal)), t_move_s)
    vx, vy, vz = map(_plain, goal.velocity_m_s)
    yaw_mode = {"is_rate": goal.yaw_is_rate, "yaw_or_rate": math.degrees(goal.yaw)}
    name, third = ("moveByVelocity", vz) if goal.height_m is None else ("moveByVelocityZ", _plain(goal.height_m))
    return name, (vx, vy, third, t_move_s, _MAX_DEGREE_OF_FREEDOM, yaw_mode)


def _plain(number: float) -> float:
    """Return NumPy's numbers and truth values as the numbers that they are in arithmetic, others as they are."""
    return float(number) if isinstance(number, np.number | np.bool_ | bool) else number
