"""Flying with the sticks of a remote control: AirSim's moveByRC and moveByManual.

Source: AirSim v1.8.1, RemoteControl.hpp (updateGoal), SimpleFlightApi.hpp (setRCData), MultirotorApiBase.cpp
(moveByManual). The sticks hold until they are moved: their age is not looked at.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uavaccel.kinematics import Kinematics, Quaternion
from uavaccel.sim import autopilot
from uavaccel.sim.flight import goal as goals
from uavaccel.sim.flight.goal import Goal, Yaw
from uavaccel.sim.flight.path import facing
from uavaccel.sim.flight.task import Turn
from uavaccel.sim.quadrotor import world_to_body

ROLL, PITCH, THROTTLE, YAW, RATE_MODE, VALID = range(6)
STICKS = 6
LARGEST_STICK = 10_000.0  # moveByManual's scale, kMaxRCValue
YAW_STICK_DEG = 100.0
RATE_SWITCH = 0.3
TILT_LIMIT_RAD = math.pi / 5.5

Sticks = NDArray[np.float64]  # roll, pitch, throttle, yaw, the switch for rates, whether they are valid


def stick_goal(sticks: Sticks) -> Goal:
    """What the sticks ask for while no program has control: angles, or rates where the switch says so."""
    throttle = max(sticks[THROTTLE], autopilot.IDLE_THROTTLE)
    roll, pitch = sticks[ROLL] * TILT_LIMIT_RAD, -sticks[PITCH] * TILT_LIMIT_RAD
    yaw_rate = sticks[YAW] * math.pi
    if sticks[RATE_MODE] >= RATE_SWITCH:
        return goals.body_rates(roll, pitch, yaw_rate, throttle, autopilot.THROTTLE)
    return goals.attitude(roll, pitch, Yaw(yaw_rate), throttle, autopilot.THROTTLE)


IDLE = stick_goal(np.zeros(STICKS))


@dataclass
class MoveByManual:
    """Sticks ask for horizontal velocities in the frame in which the vehicle was at the beginning, and for a climb."""

    sticks: Sticks
    vx_max_m_s: float
    vy_max_m_s: float
    z_min_m: float
    duration_s: float
    forward_only: bool
    yaw_value: float
    yaw_is_rate: bool
    begun_at: Quaternion

    def turn(self, now: Kinematics, elapsed_s: float) -> Turn:
        goal = self._goal(now) if self.sticks[VALID] else None
        return Turn(goal, True if elapsed_s >= self.duration_s else None)

    def _goal(self, now: Kinematics) -> Goal:
        north, east = self.sticks[PITCH] * self.vy_max_m_s, self.sticks[ROLL] * self.vx_max_m_s
        asked = (float(north) / LARGEST_STICK, float(east) / LARGEST_STICK, 0.0)
        heading = world_to_body(np.array(self.begun_at), asked)
        turned = self.yaw_value + math.radians(self.sticks[YAW] * YAW_STICK_DEG / LARGEST_STICK)
        yaw = facing(heading, bool(self.forward_only), Yaw(turned, bool(self.yaw_is_rate)))
        climb = self.sticks[THROTTLE] / LARGEST_STICK * self.z_min_m
        return goals.velocity_z(heading[0], heading[1], float(climb) + now.position_m[2], yaw)
