"""A flight command that chooses its goal anew at 50 Hz, as AirSim's API thread does.

Source: AirSim v1.8.1, MultirotorApiBase.cpp (waitForFunction and what is waited for), Waiter.hpp. There is no thread
here: `Simulation` asks the task for its next goal at the ticks at which AirSim's loop would run.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple, Protocol

from uavaccel.kinematics import Kinematics, Vector
from uavaccel.sim.vehicle import goal as goals
from uavaccel.sim.vehicle.goal import STRAIGHT_ON, Goal, Yaw
from uavaccel.units import euler_from_quaternion

LANDING_M_S = 0.2
AT_REST_M_S = 0.05  # approx_zero_vel_
NOT_TURNING_RAD_S = 0.01  # approx_zero_angular_vel_
LANDED_LOOPS = 10


class Turn(NamedTuple):
    """What one turn of a command's loop comes to: a goal to set, and the command's result once it is over."""

    goal: Goal | None
    result: bool | None = None


class Task(Protocol):
    """A command's loop. Its fields are numbers, vectors and arrays of them: all that a saved game keeps of it."""

    def turn(self, now: Kinematics, elapsed_s: float) -> Turn:
        """The loop's next turn, `elapsed_s` of simulated time after its first."""
        ...


@dataclass
class Land:
    """Sink until the vehicle has not sunk any more for more than ten turns in a row."""

    timeout_s: float
    still: int = 0

    def turn(self, now: Kinematics, elapsed_s: float) -> Turn:
        if self.timeout_s <= 0:  # waitForFunction does not begin
            return Turn(None, False)
        self.still = self.still + 1 if now.linear_velocity_m_s[2] <= AT_REST_M_S else 0
        goal = goals.velocity((0.0, 0.0, LANDING_M_S))
        if self.still > LANDED_LOOPS:
            return Turn(goal, True)
        return Turn(goal, False if elapsed_s >= self.timeout_s else None)


@dataclass
class RotateToYaw:
    """Hold a place and turn to a heading; over once it is within the margin and the vehicle turns no more.

    The margin is measured along the shorter way; AirSim's own loop never ends where that leads past 180 degrees.
    """

    place_m: Vector
    yaw_rad: float
    margin_rad: float
    timeout_s: float

    def turn(self, now: Kinematics, elapsed_s: float) -> Turn:
        yaw = euler_from_quaternion(now.orientation_wxyz)[2]
        there = abs(math.remainder(yaw - self.yaw_rad, 2 * math.pi)) <= self.margin_rad
        goal = goals.position(self.place_m, STRAIGHT_ON if there else Yaw(self.yaw_rad, False))
        if there and abs(now.angular_velocity_rad_s[2]) <= NOT_TURNING_RAD_S:
            return Turn(goal, True)
        return Turn(goal, False if elapsed_s >= self.timeout_s else None)
