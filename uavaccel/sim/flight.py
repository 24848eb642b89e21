"""AirSim's flight commands: goals for the autopilot, tasks that choose them in a loop, and the pilots that fly both.

Sources: AirSim v1.8.1, SimpleFlightApi.hpp (command* methods, each a value and a mode per axis; setRCData; a distance
accuracy of 0.5 m without a braking distance), RemoteControl.hpp (updateGoal; sticks hold until moved: their age is
ignored), MultirotorApiBase.cpp (waitForFunction, moveByManual, moveOnPath, moveToPathPosition, setNextPathPosition,
adjustYaw), Waiter.hpp, OffboardApi.hpp. There is no thread here as in AirSim, whose loop runs at 50 Hz: `Pilot` asks a
task for its next goal at the ticks of that loop.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from uavaccel.kinematics import Kinematics, Quaternion, Vector, VelocityGoal
from uavaccel.sim.recording import CommandLog
from uavaccel.sim.vehicle import autopilot
from uavaccel.sim.vehicle.autopilot import IDLE, STRAIGHT_ON, Goal, Yaw
from uavaccel.sim.vehicle.quadrotor import world_to_body
from uavaccel.sim.vehicle.vehicle import Vehicle
from uavaccel.units import NS_PER_S, euler_from_quaternion

if TYPE_CHECKING:
    from uavaccel.sim.simulation import Simulation


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
        yaw = facing(heading, self.forward_only, Yaw(turned, self.yaw_is_rate))
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
    yaw_value: float
    yaw_is_rate: bool
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
        yaw = facing(tuple(way.tolist()), self.forward_only, Yaw(self.yaw_value, self.yaw_is_rate))
        vx, vy, vz = 0.0, 0.0, 0.0
        if distance >= ACCURACY_M:
            beyond = self.segment == len(self._lengths) and self.velocity_m_s > BRAKE_ABOVE_M_S
            speed = BRAKING_M_S if beyond else self.velocity_m_s  # beyond the end a fast vehicle turns back slowly
            vx, vy, vz = (way / distance * min(speed, distance / COMMAND_PERIOD_S)).tolist()
        return velocity((vx, vy, 0.0 if abs(way[2]) <= ACCURACY_M else vz), yaw)


class DeferredReply:
    """The pending reply of a command's `join`, or of a continue-for: due later than its call, and resolved in time."""

    def __init__(self) -> None:
        self.value: object = None
        self.encode: Callable[[Any], object] = lambda value: value  # to the form of the wire
        self.due_wall_ns: int | None = None
        self.on_due: Callable[[DeferredReply], None] | None = None

    def resolve(self, value: object, wall_ns: int) -> None:
        """Set the value, and the wall time before which the reply may not be sent."""
        self.value, self.due_wall_ns = value, wall_ns
        if self.on_due is not None:
            self.on_due(self)


OTHERS_LOG_LENGTH = 64  # of vehicles whose log is not recorded
LONGEST_TICKS = 1 << 40  # of a command whose end is not known


@dataclass
class RunningCommand:
    """A running command. It ends at `end_tick`; with a task, that is the tick of the task's next turn."""

    end_tick: int
    reply: DeferredReply
    task: FlightTask | None = None
    begin_tick: int = 0
    goal_tick: int | None = None  # at which the task last set a goal


class Pilot:
    """Flies one vehicle: its running command, the log of its commands, API control and the remote control's sticks.

    A new command replaces the running one, which ends with False. Without API control a command takes its time but has
    no effect. Only the pilot that `leads` keeps its whole command log.
    """

    def __init__(self, simulation: Simulation, vehicle: Vehicle, leads: bool) -> None:
        self._simulation, self.vehicle, self._leads = simulation, vehicle, leads
        self._profile = simulation.profile
        self.api_control = False
        vehicle.restore_gains()  # another simulation may have changed them
        self.restart()

    def restart(self) -> None:
        """Forget command, log and sticks."""
        self.command: RunningCommand | None = None
        self.log = CommandLog(None if self._leads else OTHERS_LOG_LENGTH)
        self.sticks: Sticks = np.zeros(STICKS)

    def fly(self, goal: Goal, ticks: int, wall_ns: int) -> DeferredReply:
        """Fly towards one goal for `ticks` ticks; the reply is whether the command was completed."""
        tick = self._accept(ticks, wall_ns)
        if self.api_control:
            self._set(goal)
        self.command = RunningCommand(tick + ticks, DeferredReply())
        return self.command.reply

    def start(self, task: FlightTask, wall_ns: int) -> DeferredReply:
        """Let a task choose the goals; its first turn is now and may be its last."""
        tick = self._accept(LONGEST_TICKS, wall_ns)
        command = self.command = RunningCommand(tick, DeferredReply(), task, tick)
        self.turn(wall_ns)
        return command.reply

    def _accept(self, ticks: int, wall_ns: int) -> int:
        self.end(False, wall_ns)
        tick = self.vehicle.tick
        self._simulation.begin_recording(self)
        self.log.accept(tick, tick + ticks)
        self._simulation.note("accept", wall_ns)
        return tick

    def turn(self, wall_ns: int) -> None:
        """Do what is due at this tick: the command's end, or its task's next turn."""
        command, tick = self.command, self.vehicle.tick
        assert command is not None, "called only at a command's tick"
        if command.task is None or self._simulation.failure is not None:
            self.end(self._simulation.failure is None, wall_ns)
            return
        elapsed_s = (tick - command.begin_tick) * self._profile.tick_ns / NS_PER_S
        goal, result = command.task.turn(self.kinematics(), elapsed_s)
        if goal is not None:
            command.goal_tick = tick
            if self.api_control:
                self._set(goal)
        elif result is None:  # no goal in this turn: the goal timeout continues
            self._hold_after(command)
        if result is not None:
            self.end(result, wall_ns)
        else:
            command.end_tick = tick + self._profile.loop_ticks

    def kinematics(self) -> Kinematics:
        """Return the vehicle's state at the present tick, with the simulated time."""
        return self.vehicle.kinematics(self._simulation.time0_ns)

    def _set(self, goal: Goal) -> None:
        self.vehicle.set_goal(goal)
        self.vehicle.hold_from(None)

    def end(self, completed: bool, wall_ns: int) -> None:
        """End the running command, if any, with this result; position hold follows after the goal timeout."""
        if self.command is None:
            return
        command, self.command = self.command, None
        if not completed or command.task is not None:
            self.log.cut_short(self.vehicle.tick)
        self._hold_after(command)
        self._simulation.note("end", wall_ns)
        command.reply.resolve(completed, wall_ns)

    def _hold_after(self, command: RunningCommand) -> None:
        """Schedule position hold a goal timeout after the command's last goal, if it has set any."""
        last = command.goal_tick
        if command.task is None:
            last = self.log.last_goal(self.vehicle.tick, self._profile.goal_period_ticks)
        if self.api_control and last is not None:
            self.vehicle.hold_from(last + self._profile.hover_after_ticks)

    def arm(self, armed: bool) -> bool:
        """Arm or disarm the rotors; returns whether that was granted (OffboardApi::arm, disarm).

        It needs API control. A vehicle that is newly armed idles; arming an armed one changes nothing.
        """
        state = self.vehicle.state
        was_armed = bool(state["armed"])
        if not self.api_control or not (armed or was_armed):
            return False
        if armed and not was_armed:
            self.vehicle.set_goal(IDLE)
        state["armed"] = int(armed)
        return True

    def move_sticks(self, sticks: Sticks) -> None:
        """Set the remote control's sticks, which fly the vehicle while no program has API control."""
        self.sticks = sticks
        if self.command is not None and isinstance(self.command.task, MoveByManual):
            self.command.task.sticks = sticks
        if sticks[VALID] and not self.api_control:
            self._set(stick_goal(sticks))
