"""What the autopilot is to reach, by AirSim's kinds of goal.

Source: AirSim v1.8.1, SimpleFlightApi.hpp: the command* methods, each a value and a mode per axis.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from uavaccel.kinematics import Vector, VelocityGoal
from uavaccel.sim.vehicle import autopilot


class Yaw(NamedTuple):
    """A heading in rad, or where `is_rate` a turn in rad/s (AirSim's YawMode)."""

    value: float = 0.0
    is_rate: bool = True

    @property
    def mode(self) -> int:
        return autopilot.RATE if self.is_rate else autopilot.ANGLE


STRAIGHT_ON = Yaw()


@dataclass(frozen=True, slots=True)
class Goal:
    """`values`: x, y, z, yaw; the modes say what each of them is (autopilot.py). Positions are NED in m."""

    values: tuple[float, float, float, float]
    xy_mode: int
    z_mode: int
    yaw_mode: int


def of_velocity(goal: VelocityGoal) -> Goal:
    """commandVelocity, or where a height is held commandVelocityZ."""
    yaw = Yaw(goal.yaw, goal.yaw_is_rate)
    if goal.height_m is None:
        return velocity(goal.velocity_m_s, yaw)
    return velocity_z(*goal.velocity_m_s[:2], goal.height_m, yaw)


def velocity(velocity_m_s: Vector, yaw: Yaw = STRAIGHT_ON) -> Goal:
    """commandVelocity: NED, m/s."""
    return Goal((*velocity_m_s, yaw.value), autopilot.VELOCITY, autopilot.VELOCITY, yaw.mode)


def velocity_z(vx_m_s: float, vy_m_s: float, z_m: float, yaw: Yaw = STRAIGHT_ON) -> Goal:
    """commandVelocityZ: horizontal m/s and NED height."""
    return Goal((vx_m_s, vy_m_s, z_m, yaw.value), autopilot.VELOCITY, autopilot.POSITION, yaw.mode)


def position(position_m: Vector, yaw: Yaw = STRAIGHT_ON) -> Goal:
    """commandPosition."""
    return Goal((*position_m, yaw.value), autopilot.POSITION, autopilot.POSITION, yaw.mode)


def attitude(roll_rad: float, pitch_rad: float, yaw: Yaw, z: float, z_mode: int) -> Goal:
    """commandRollPitchYaw*: `z` is a NED height or, with autopilot.THROTTLE, a throttle from 0 to 1."""
    return Goal((roll_rad, pitch_rad, z, yaw.value), autopilot.TILT, z_mode, yaw.mode)


def body_rates(roll_rad_s: float, pitch_rad_s: float, yaw_rad_s: float, z: float, z_mode: int) -> Goal:
    """commandAngleRates*; `z` as in `attitude`."""
    return Goal((roll_rad_s, pitch_rad_s, z, yaw_rad_s), autopilot.TILT_RATE, z_mode, autopilot.RATE)


def motors(front_right: float, rear_left: float, front_left: float, rear_right: float) -> Goal:
    """commandMotorPWMs: each from 0 to 1, past cascade and mixer."""
    values = (front_right, rear_left, front_left, rear_right)
    return Goal(values, autopilot.MOTORS, autopilot.THROTTLE, autopilot.RATE)
