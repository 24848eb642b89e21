"""Goals of the autopilot, by AirSim's kinds, and what the sticks of a remote control ask for.

Source: AirSim v1.8.1, SimpleFlightApi.hpp (command* methods, each a value and a mode per axis; setRCData) and
RemoteControl.hpp (updateGoal). Sticks hold until they are moved: their age is ignored.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavaccel.kinematics import Vector, VelocityGoal
from uavaccel.sim.vehicle import autopilot


class Yaw(NamedTuple):
    """A heading in rad or, if `is_rate`, a yaw rate in rad/s (AirSim's YawMode)."""

    value: float = 0.0
    is_rate: bool = True

    @property
    def mode(self) -> int:
        """The autopilot's mode of yaw."""
        return autopilot.RATE if self.is_rate else autopilot.ANGLE


STRAIGHT_ON = Yaw()


@dataclass(frozen=True, slots=True)
class Goal:
    """A goal: `values` are x, y, z and yaw, with meanings by the modes (autopilot.py); positions are NED in m."""

    values: tuple[float, float, float, float]
    xy_mode: int
    z_mode: int
    yaw_mode: int


def of_velocity(goal: VelocityGoal) -> Goal:
    """Make the goal of commandVelocity or, if it holds a height, commandVelocityZ."""
    yaw = Yaw(goal.yaw, goal.yaw_is_rate)
    if goal.height_m is None:
        return velocity(goal.velocity_m_s, yaw)
    return velocity_z(*goal.velocity_m_s[:2], goal.height_m, yaw)


def velocity(velocity_m_s: Vector, yaw: Yaw = STRAIGHT_ON) -> Goal:
    """Make the goal of commandVelocity: NED, m/s."""
    return Goal((*velocity_m_s, yaw.value), autopilot.VELOCITY, autopilot.VELOCITY, yaw.mode)


def velocity_z(vx_m_s: float, vy_m_s: float, z_m: float, yaw: Yaw = STRAIGHT_ON) -> Goal:
    """Make the goal of commandVelocityZ: horizontal m/s and NED z in m."""
    return Goal((vx_m_s, vy_m_s, z_m, yaw.value), autopilot.VELOCITY, autopilot.POSITION, yaw.mode)


def position(position_m: Vector, yaw: Yaw = STRAIGHT_ON) -> Goal:
    """Make the goal of commandPosition: NED, m."""
    return Goal((*position_m, yaw.value), autopilot.POSITION, autopilot.POSITION, yaw.mode)


def attitude(roll_rad: float, pitch_rad: float, yaw: Yaw, z: float, z_mode: int) -> Goal:
    """Make the goal of commandRollPitchYaw*: `z` is NED z in m or, with autopilot.THROTTLE, a throttle from 0 to 1."""
    return Goal((roll_rad, pitch_rad, z, yaw.value), autopilot.TILT, z_mode, yaw.mode)


def body_rates(roll_rad_s: float, pitch_rad_s: float, yaw_rad_s: float, z: float, z_mode: int) -> Goal:
    """Make the goal of commandAngleRates*; `z` as in `attitude`."""
    return Goal((roll_rad_s, pitch_rad_s, z, yaw_rad_s), autopilot.TILT_RATE, z_mode, autopilot.RATE)


def motors(front_right: float, rear_left: float, front_left: float, rear_right: float) -> Goal:
    """Make the goal of commandMotorPWMs: each motor from 0 to 1, without cascade and mixer."""
    values = (front_right, rear_left, front_left, rear_right)
    return Goal(values, autopilot.MOTORS, autopilot.THROTTLE, autopilot.RATE)


ROLL, PITCH, THROTTLE, YAW, RATE_MODE, VALID = range(6)
STICKS = 6
RATE_SWITCH = 0.3
TILT_LIMIT_RAD = math.pi / 5.5

Sticks = NDArray[np.float64]  # roll, pitch, throttle, yaw, rate switch, validity


def stick_goal(sticks: Sticks) -> Goal:
    """Return the sticks' goal while no program has API control: angles or, with the switch, rates."""
    throttle = max(sticks[THROTTLE], autopilot.IDLE_THROTTLE)
    roll, pitch = sticks[ROLL] * TILT_LIMIT_RAD, -sticks[PITCH] * TILT_LIMIT_RAD
    yaw_rate = sticks[YAW] * math.pi
    if sticks[RATE_MODE] >= RATE_SWITCH:
        return body_rates(roll, pitch, yaw_rate, throttle, autopilot.THROTTLE)
    return attitude(roll, pitch, Yaw(yaw_rate), throttle, autopilot.THROTTLE)


IDLE = stick_goal(np.zeros(STICKS))
