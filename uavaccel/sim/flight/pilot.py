"""A pilot flies one vehicle: its running command, the log of its commands, API control and remote-control sticks.

A new command replaces the running one, which ends with False. Without API control a command takes its time but has no
effect (OffboardApi.hpp).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from uavaccel.kinematics import Kinematics
from uavaccel.sim.flight.tasks import FlightTask, MoveByManual
from uavaccel.sim.profile import Profile
from uavaccel.sim.recording import CommandLog
from uavaccel.sim.vehicle.goal import IDLE, STICKS, VALID, Goal, Sticks, stick_goal
from uavaccel.sim.vehicle.vehicle import Vehicle
from uavaccel.units import NS_PER_S


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


class PilotedSimulation(Protocol):
    """The part of a Simulation that its pilots use."""

    profile: Profile
    time0_ns: int
    failure: str | None

    def begin_recording(self, pilot: Pilot) -> None:
        """Restart the recording if this is the first command of the game."""

    def note(self, event: str, wall_ns: int) -> None:
        """Add an event to the trace if it is enabled."""


class Pilot:
    """Flies one vehicle of a simulation; only the one that `leads` keeps its whole command log."""

    def __init__(self, simulation: PilotedSimulation, vehicle: Vehicle, leads: bool) -> None:
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
