"""AirSim's flight commands: goals for the autopilot, tasks that choose them in a loop, and the pilots that fly both.

Sources: AirSim v1.8.1, SimpleFlightApi.hpp (command* methods, each a value and a mode per axis; setRCData; a distance
accuracy of 0.5 m without a braking distance), RemoteControl.hpp (updateGoal; sticks hold until moved: their age is
ignored), MultirotorApiBase.cpp (waitForFunction, moveByManual, moveOnPath, moveToPathPosition, setNextPathPosition,
adjustYaw), Waiter.hpp, OffboardApi.hpp. There is no thread here as in AirSim, whose loop runs at 50 Hz: `Pilot` asks a
task for its next goal at the ticks of that loop.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from uavaccel.kinematics import Kinematics, Quaternion, Vector, VelocityGoal
from uavaccel.sim.vehicle import autopilot
from uavaccel.sim.vehicle.autopilot import STRAIGHT_ON, Goal, Yaw
from uavaccel.sim.vehicle.quadrotor import world_to_body
from uavaccel.units import euler_from_quaternion


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


LANDING_M_S = 0.2
AT_REST_M_S = 0.05  # approx_zero_vel_
NOT_TURNING_RAD_S = 0.01  # approx_zero_angular_vel_
LANDED_LOOPS = 10
LARGEST_STICK = 10_000.0  # moveByManual's scale, kMaxRCValue
YAW_STICK_DEG = 100.0
COMMAND_PERIOD_S = 0.02
ACCURACY_M = 0.5
MAX_LOOKAHEAD_PERIODS, ADAPTIVE_LOOKAHEAD_PERIODS = 40, 30
BRAKING_M_S, BRAKE_ABOVE_M_S = 1.0, 3.0

Array = NDArray[np.float64]


class Turn(NamedTuple):
    """Result of one turn of a task's loop: a goal to set, and the command's result once it is over."""

    goal: Goal | None
    result: bool | None = None


class FlightTask(Protocol):
    """A command's loop."""

    def turn(self, now: Kinematics, elapsed_s: float) -> Turn:
        """Do the loop's next turn, `elapsed_s` of simulated time after the first."""
        ...


@dataclass
class Land:
    """Descend until the vehicle has not descended for more than ten turns in a row."""

    timeout_s: float
    still: int = 0

    def turn(self, now: Kinematics, elapsed_s: float) -> Turn:
        if self.timeout_s <= 0:  # waitForFunction does not begin
            return Turn(None, False)
        self.still = self.still + 1 if now.linear_velocity_m_s[2] <= AT_REST_M_S else 0
        goal = velocity((0.0, 0.0, LANDING_M_S))
        if self.still > LANDED_LOOPS:
            return Turn(goal, True)
        return Turn(goal, False if elapsed_s >= self.timeout_s else None)


@dataclass
class RotateToYaw:
    """Hold a position and turn to a heading; ends once it is within the margin and the vehicle has stopped turning.

    The margin is measured along the shorter way; AirSim's own loop never ends if that leads past 180 degrees.
    """

    place_m: Vector
    yaw_rad: float
    margin_rad: float
    timeout_s: float

    def turn(self, now: Kinematics, elapsed_s: float) -> Turn:
        yaw = euler_from_quaternion(now.orientation_wxyz)[2]
        there = abs(math.remainder(yaw - self.yaw_rad, 2 * math.pi)) <= self.margin_rad
        goal = position(self.place_m, STRAIGHT_ON if there else Yaw(self.yaw_rad, False))
        if there and abs(now.angular_velocity_rad_s[2]) <= NOT_TURNING_RAD_S:
            return Turn(goal, True)
        return Turn(goal, False if elapsed_s >= self.timeout_s else None)


@dataclass
class MoveByManual:
    """Sticks set horizontal velocities in the vehicle's initial frame, and a climb rate: AirSim's moveByManual."""

    sticks: Sticks
    vx_max_m_s: float
    vy_max_m_s: float
    z_min_m: float
    duration_s: float
    forward_only: bool
    yaw: Yaw
    begun_at: Quaternion

    def turn(self, now: Kinematics, elapsed_s: float) -> Turn:
        goal = self._goal(now) if self.sticks[VALID] else None
        return Turn(goal, True if elapsed_s >= self.duration_s else None)

    def _goal(self, now: Kinematics) -> Goal:
        north, east = self.sticks[PITCH] * self.vy_max_m_s, self.sticks[ROLL] * self.vx_max_m_s
        asked = (float(north) / LARGEST_STICK, float(east) / LARGEST_STICK, 0.0)
        heading = world_to_body(np.array(self.begun_at), asked)
        turned = self.yaw.value + math.radians(self.sticks[YAW] * YAW_STICK_DEG / LARGEST_STICK)
        yaw = facing(heading, self.forward_only, self.yaw._replace(value=turned))
        climb = self.sticks[THROTTLE] / LARGEST_STICK * self.z_min_m
        return velocity_z(heading[0], heading[1], float(climb) + now.position_m[2], yaw)


def check_lookahead(lookahead_m: float, velocity_m_s: float, adaptive: float) -> float:
    """Return the lookahead in m, AirSim's own if it is negative. Raises ValueError with AirSim's message."""
    per_period_m = velocity_m_s * COMMAND_PERIOD_S
    if lookahead_m == 0:
        raise ValueError("lookahead distance cannot be 0")
    if lookahead_m < 0:
        periods = ADAPTIVE_LOOKAHEAD_PERIODS if adaptive > 0 else MAX_LOOKAHEAD_PERIODS
        return max(per_period_m * periods, 1.5 * ACCURACY_M)
    if per_period_m > lookahead_m:
        raise ValueError(
            f"lookahead value {lookahead_m:f} is too small for velocity {velocity_m_s:f}. "
            f"It must be at least {per_period_m:f}"
        )
    if lookahead_m < ACCURACY_M:
        raise ValueError(f"lookahead value {lookahead_m:f} is smaller than drone's distance accuracy {ACCURACY_M:f}.")
    return lookahead_m


def facing(heading: Vector, forward_only: bool, yaw: Yaw) -> Yaw:
    """Return the yaw goal for a direction of travel (adjustYaw), which must be longer than half a metre."""
    if not forward_only or yaw.is_rate:
        return yaw
    if math.hypot(*heading) <= ACCURACY_M:
        return STRAIGHT_ON
    return Yaw(math.remainder(yaw.value + math.atan2(heading[1], heading[0]), 2 * math.pi), False)


@dataclass
class FollowPath:
    """Follow a path towards a carrot: moveOnPath, and moveToPosition, moveToZ, takeoff and goHome in its terms.

    `points` (n, 3) are NED, in m; the first is where the vehicle is. The carrot is `lookahead_m` ahead, plus `adaptive`
    times the distance from the path. As in AirSim the result is True only if the vehicle has passed the end.
    """

    points: Array
    velocity_m_s: float
    timeout_s: float
    forward_only: bool
    yaw: Yaw
    lookahead_m: float
    adaptive: float
    segment: int = 0  # progress of the vehicle: its segment, and the metres along it
    offset_m: float = 0.0
    goal_distance_m: float = 0.0
    error_m: float = 0.0
    begun: bool = False

    def __post_init__(self) -> None:
        self.points = np.asarray(self.points, np.float64).reshape(-1, 3)
        self._lengths = np.linalg.norm(np.diff(self.points, axis=0), axis=1)
        self._at = self._place(self.segment, self.offset_m)

    def turn(self, now: Kinematics, elapsed_s: float) -> Turn:
        complete = self._advance(np.array(now.position_m)) if self.begun else False
        self.begun = True
        segment, _, carrot = self._ahead(self.lookahead_m + self.error_m)
        if not complete and elapsed_s >= self.timeout_s:
            return Turn(None, False)
        if segment == len(self._lengths) and self.goal_distance_m <= 0:
            return Turn(None, complete)
        return Turn(self._towards(carrot, now))

    def _advance(self, place: Array) -> bool:
        """Update the progress by what was flown towards the last carrot; returns whether the end was reached before."""
        _, _, carrot = self._ahead(self.lookahead_m + self.error_m)
        goal, flown = carrot - self._at, place - self._at
        distance = float(np.linalg.norm(goal))
        if distance == 0.0:
            self.goal_distance_m = self.error_m = 0.0
        else:
            direction = goal / distance
            self.goal_distance_m = float(flown @ direction)
            if self.adaptive:
                aside = flown - direction * self.goal_distance_m
                self.error_m = float(np.linalg.norm(aside)) * self.adaptive
        if self.goal_distance_m >= 0:
            self.segment, self.offset_m, self._at = self._ahead(self.goal_distance_m)
        return distance == 0.0

    def _ahead(self, distance_m: float) -> tuple[int, float, Array]:
        """Return the point of the path that far ahead of the vehicle, at most its end: segment, offset and NED."""
        segment, offset = self.segment, self.offset_m
        while segment < len(self._lengths):
            length = float(self._lengths[segment])
            if length > 0 and length >= distance_m + offset:
                return segment, distance_m + offset, self._place(segment, distance_m + offset)
            distance_m -= length - offset
            offset = 0.0
            segment += 1
        return segment, 0.0, self.points[-1]

    def _place(self, segment: int, offset_m: float) -> Array:
        if segment == len(self._lengths) or self._lengths[segment] == 0:
            corner: Array = self.points[segment]
            return corner
        along = (self.points[segment + 1] - self.points[segment]) / self._lengths[segment]
        return np.asarray(self.points[segment] + along * offset_m)

    def _towards(self, carrot: Array, now: Kinematics) -> Goal:
        """Return the velocity towards the carrot: 0 within the accuracy, no climb or descent within half a metre."""
        way = carrot - np.array(now.position_m)
        distance = float(np.linalg.norm(way))
        yaw = facing(tuple(way.tolist()), self.forward_only, self.yaw)
        vx, vy, vz = 0.0, 0.0, 0.0
        if distance >= ACCURACY_M:
            beyond = self.segment == len(self._lengths) and self.velocity_m_s > BRAKE_ABOVE_M_S
            speed = BRAKING_M_S if beyond else self.velocity_m_s  # beyond the end a fast vehicle turns back slowly
            vx, vy, vz = (way / distance * min(speed, distance / COMMAND_PERIOD_S)).tolist()
        return velocity((vx, vy, 0.0 if abs(way[2]) <= ACCURACY_M else vz), yaw)
