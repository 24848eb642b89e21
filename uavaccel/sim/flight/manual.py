"""Flying by hand while a program has control: AirSim's moveByManual.

Source: AirSim v1.8.1, MultirotorApiBase.cpp (moveByManual).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from uavaccel.kinematics import Kinematics, Quaternion
from uavaccel.sim.flight.path import facing
from uavaccel.sim.flight.task import Turn
from uavaccel.sim.vehicle import goal as goals
from uavaccel.sim.vehicle.goal import Goal, Yaw
from uavaccel.sim.vehicle.quadrotor import world_to_body
from uavaccel.sim.vehicle.sticks import PITCH, ROLL, THROTTLE, VALID, YAW, Sticks

LARGEST_STICK = 10_000.0  # moveByManual's scale, kMaxRCValue
YAW_STICK_DEG = 100.0


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
