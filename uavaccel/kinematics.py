"""The state of the drone at one instant, and velocity goals, as commands, wire and simulation exchange them."""

from __future__ import annotations

from dataclasses import dataclass

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
