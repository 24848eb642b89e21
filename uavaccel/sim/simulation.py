"""A free-running simulation and its commands, advanced to a wall time that its owner passes in.

`advance_to(wall_ns)` runs every tick that is due by then; between two calls nothing moves, and there is no thread,
socket or sleep. A message handled at wall time w sees every tick due at w, and its goal acts from the next tick; what
ends at tick n is seen by messages before tick n + 1.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

import numpy as np

from uavaccel.clock import Pacer, positive_clock_speed
from uavaccel.kinematics import Kinematics, Quaternion, Vector
from uavaccel.sim.flight import STICKS, VALID, FlightTask, MoveByManual, Sticks, stick_goal
from uavaccel.sim.poses import LEVEL
from uavaccel.sim.profile import UNBOUND, Executor, Frames, Profile
from uavaccel.sim.recording import CommandLog, Recording
from uavaccel.sim.vehicle.autopilot import IDLE, Goal
from uavaccel.sim.vehicle.vehicle import AddedVehicle, Vehicle
from uavaccel.sim.world import FlightError, World
from uavaccel.units import NS_PER_S, exact

MOST_CATCH_UP_TICKS = 5_000  # of one vehicle, flown at once to catch up: about 30 ms
TRACE_LENGTH = 1 << 16


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
        simulation = self._simulation
        if self is simulation.lead and not self.log and simulation.records_game and simulation.world.recorder.active:
            simulation.world.start_recording()  # whose t = 0 is this tick, that of the game's first command
        self.log.accept(tick, tick + ticks)
        simulation.note("accept", wall_ns)
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


@dataclass
class ContinueFor:
    """A running continue-for, which ends at a tick or, in profile `airsim`, at a wall time."""

    reply: DeferredReply
    end_tick: int | None = None
    end_wall_ns: int | None = None


@dataclass
class Speed:
    """Simulated and wall time that passed while the clock ran, and the wall time that was lost."""

    simulated_ns: int = 0
    wall_ns: int = 0
    lost_wall_ns: int = 0

    @property
    def real_time_factor(self) -> float:
        """Simulated seconds per wall second that were reached; 0 before the clock ran."""
        return self.simulated_ns / self.wall_ns if self.wall_ns else 0.0


@dataclass
class Trace:
    """The latest events of a simulation, as (event, wall ns, simulated ns); recorded only while `enabled`."""

    events: deque[tuple[str, int, int]] = field(default_factory=lambda: deque(maxlen=TRACE_LENGTH))
    enabled: bool = False


class Simulation:
    """Clock, commands and recording of one `World`.

    `catch_up_wall_ns` is the largest backlog of wall time that is caught up, of at most MOST_CATCH_UP_TICKS; more is
    lost and counted. None sets no limit, for a simulated wall clock. `timer_lateness_ns` samples how late a wall timer
    fires (profile `airsim`).
    """

    def __init__(
        self,
        world: World,
        clock_speed: float = 1.0,
        wall_ns: int = 0,
        catch_up_wall_ns: int | None = None,
        timer_lateness_ns: Callable[[], int] = lambda: 0,
        executor: Executor = UNBOUND,
        frames: Frames | None = None,
    ) -> None:
        self.world = world
        self.profile: Profile = world.profile
        self.executor, self.frames = executor, frames or Frames()
        self.clock_speed = positive_clock_speed(clock_speed)  # as requested; the executor may limit it
        self.pacer = Pacer(executor.speed(self.clock_speed, self.profile.tick_ns), self.profile.tick_ns)
        self.catch_up_wall_ns = catch_up_wall_ns
        self._timer_lateness_ns = timer_lateness_ns
        self.paused = False
        self.pilots = [Pilot(self, vehicle, vehicle is world.lead) for vehicle in world.vehicles]
        self.period: ContinueFor | None = None
        self.records_game = True  # whether the first command restarts an active recording
        self.trace = Trace()
        self.failure: str | None = None
        self.time0_ns = 0
        self.wall_ns = wall_ns
        self._bound_backlog()
        self._restart(wall_ns)

    # --- time -------------------------------------------------------------------------------------

    @property
    def time_ns(self) -> int:
        """Simulated time since the simulation was made; as in AirSim a reset does not set it back."""
        return self.time_of(self.world.tick)

    def time_of(self, tick: int) -> int:
        """Return the simulated time at a tick, counted from the last reset."""
        return self.time0_ns + tick * self.profile.tick_ns

    def advance_to(self, wall_ns: int) -> None:
        """Advance every tick that is due by `wall_ns`, with all that ends on the way and the frames shown."""
        if not self.paused:
            for tick_ns in self.frames.ticks(self.wall_ns, wall_ns):
                self._advance_to(tick_ns)
                if not self.paused:
                    self.frames.show(self.world.data)
        self._advance_to(wall_ns)

    def _advance_to(self, wall_ns: int) -> None:
        if self._catch_up_ns is not None and wall_ns - self.wall_ns > self._catch_up_ns:
            self._drop_backlog(wall_ns, self._catch_up_ns)
        while not self.paused:
            end_tick = self._next_end_tick()
            target = self.pacer.ticks_due(wall_ns)
            self._fly_to(target if end_tick is None else min(target, end_tick))
            if end_tick is None or end_tick > target:
                break
            self._end_at_tick(self.pacer.wall_due(end_tick))
        if (timer := self.wall_timer_ns()) is not None and wall_ns >= timer:
            self.note("timer", timer)  # when it was due; the pause that follows is when it ended
            self.pause(wall_ns)
        self._account(wall_ns)

    def next_event_wall_ns(self, turns: bool = True) -> int | None:
        """Return the wall time of the next end of a command or continue-for; None without one.

        With `turns` a task's next turn, which may be its last, counts too. Turns happen at their ticks in any case.
        """
        if self.paused:
            return None
        timer, tick = self.wall_timer_ns(), self._next_end_tick(turns)
        if tick is None:
            return timer
        due = self.pacer.wall_due(tick)
        return due if timer is None else min(timer, due)

    def _next_end_tick(self, turns: bool = True) -> int | None:
        commands = [pilot.command for pilot in self.pilots if pilot.command is not None]
        ticks = [command.end_tick for command in commands if turns or command.task is None]
        if self.period is not None and self.period.end_tick is not None:
            ticks.append(self.period.end_tick)
        return min(ticks, default=None)

    def wall_timer_ns(self) -> int | None:
        """Return the wall time at which a continue-for of profile `airsim` ends; None without one."""
        return self.period.end_wall_ns if self.period and not self.paused else None

    def _drop_backlog(self, wall_ns: int, kept_ns: int) -> None:
        """Lose the wall time beyond the backlog that is kept: the machine or this process was held up."""
        behind_ns = wall_ns - self.pacer.wall_due(self.world.tick + 1)
        lost = behind_ns - kept_ns
        if not self.paused and lost > 0:
            self.speed.lost_wall_ns += lost
            self.pacer.anchor(wall_ns - kept_ns, self.world.tick + 1)

    def _bound_backlog(self) -> None:
        """Limit the backlog so that catching up at this ClockSpeed, with these vehicles, does not block for long."""
        self._catch_up_ns = self.catch_up_wall_ns
        if self.catch_up_wall_ns is not None:
            tick_wall_ns = self.profile.tick_ns / float(self.clock_speed)
            most_ns = round(MOST_CATCH_UP_TICKS / len(self.pilots) * tick_wall_ns)
            self._catch_up_ns = min(self.catch_up_wall_ns, most_ns)

    def _fly_to(self, tick: int) -> None:
        """Advance to a tick. A state that cannot be integrated sets `failure`; the vehicle then stands still.

        Time goes on, so that nobody waits forever, and commands end with False.
        """
        start_tick = self.world.tick
        while (ticks := tick - self.world.tick) > 0:
            try:
                self.world.advance(ticks)
            except FlightError as error:
                self.failure = str(error)
        self.speed.simulated_ns += (self.world.tick - start_tick) * self.profile.tick_ns

    def _account(self, wall_ns: int) -> None:
        if not self.paused:
            self.speed.wall_ns += wall_ns - self.wall_ns
        self.wall_ns = wall_ns

    def _end_at_tick(self, wall_ns: int) -> None:
        tick, period = self.world.tick, self.period
        for pilot in self.pilots:
            if pilot.command is not None and pilot.command.end_tick <= tick:
                pilot.turn(wall_ns)
        if period and period.end_tick is not None and period.end_tick <= tick:
            self.pause(wall_ns)

    def note(self, event: str, wall_ns: int) -> None:
        """Add an event to the trace if it is enabled."""
        if self.trace.enabled:
            self.trace.events.append((event, wall_ns, self.time_ns))

    # --- clock commands ---------------------------------------------------------------------------

    def set_clock_speed(self, clock_speed: float, wall_ns: int) -> None:
        """Change the ClockSpeed. Raises UserError unless it is positive."""
        self.clock_speed = positive_clock_speed(clock_speed)
        self.pacer.set_clock_speed(self.executor.speed(self.clock_speed, self.profile.tick_ns), wall_ns)
        self._bound_backlog()

    def pause(self, wall_ns: int) -> None:
        """Stop simulated time; a running continue-for replies at once."""
        if not self.paused:
            self._account(wall_ns)
            self.paused = True
            self.note("pause", wall_ns)
        self._release_continue(wall_ns)

    def run(self, wall_ns: int) -> None:
        """Resume simulated time; a running continue-for replies at once, as with simPause(False)."""
        if self.paused:
            self.paused = False
            self.wall_ns = wall_ns
            self.pacer.anchor(wall_ns, self.world.tick)
            self.note("run", wall_ns)
        self._release_continue(wall_ns)

    def _release_continue(self, wall_ns: int) -> None:
        if self.period:
            reply, self.period = self.period.reply, None
            reply.resolve(self.kinematics(), self.frames.continued(wall_ns))

    def continue_for(self, duration_ns: int, wall_ns: int) -> DeferredReply:
        """Run for `duration_ns` of simulated time, then pause and reply with the `Kinematics`.

        A second call replaces the first. The duration is rounded to a tick in an exact profile; in `airsim` a wall
        timer ends it.
        """
        self.run(wall_ns)
        period = self.period = ContinueFor(DeferredReply())
        if self.profile.exact_pauses:
            ticks = round(Fraction(duration_ns, self.profile.tick_ns))
            period.end_tick = self.world.tick + ticks
        else:
            timer = wall_ns + round(duration_ns / self.clock_speed) + self._timer_lateness_ns()
            one_tick = self.pacer.wall_due(self.world.tick + 1)  # AirSim checks the timer after a tick
            period.end_wall_ns = max(timer, one_tick) if duration_ns > 0 else timer
        self.advance_to(wall_ns)  # it may be over already
        return period.reply

    def continue_for_wall(self, seconds: float, wall_ns: int) -> DeferredReply:
        """Run for `seconds` of wall time, that times ClockSpeed of simulated time: AirSim's simContinueForTime."""
        return self.continue_for(round(exact(seconds) * self.clock_speed * NS_PER_S), wall_ns)

    # --- vehicles ---------------------------------------------------------------------------------

    @property
    def lead(self) -> Pilot:
        """The pilot of the first vehicle, to which calls without a vehicle refer."""
        return self.pilots[0]

    def add_vehicles(self, newcomers: Sequence[AddedVehicle]) -> None:
        """Add vehicles with their pilots. Raises UserError as World.add_vehicles does."""
        self.world.add_vehicles(newcomers)
        self.frames.forget()  # the pose shown belongs to the previous model
        added = self.world.vehicles[len(self.pilots) :]
        self.pilots += [Pilot(self, vehicle, leads=False) for vehicle in added]
        self._bound_backlog()

    # --- start and record -------------------------------------------------------------------------

    def reset(
        self,
        wall_ns: int,
        position_m: Vector | None = None,
        orientation_wxyz: Quaternion = LEVEL,
        recording: bool = False,
    ) -> None:
        """Go back to the start without API control; the first vehicle hovers at `position_m`, NED, if that is given.

        A running command ends with False, a continue-for replies. The recorder stops or, with `recording`, restarts.
        Raises UserError where no vehicle can hover.
        """
        if position_m is not None:
            self.world.check_place(position_m, orientation_wxyz)
        for pilot in self.pilots:
            pilot.end(False, wall_ns)
        if self.period:
            self.pause(wall_ns)
        self.time0_ns = self.time_ns
        self.world.reset(position_m, orientation_wxyz)
        for pilot in self.pilots:
            pilot.api_control = False
        self._restart(wall_ns)
        if recording:
            self.world.start_recording()

    def settle(self, wall_ns: int) -> None:
        """Begin once the vehicles that start in the air have fallen to rest, as AirSim's have when a client comes."""
        try:
            self.world.settle()
        except FlightError:
            self.world.reset()
        self._restart(wall_ns)

    def _restart(self, wall_ns: int) -> None:
        self.period = None
        for pilot in self.pilots:
            pilot.restart()
        self.failure = None
        self.frames.forget()
        self.speed = Speed()
        self.wall_ns = wall_ns
        self.pacer.anchor(wall_ns, self.world.tick)

    def kinematics(self) -> Kinematics:
        """Return the first vehicle's state at the present tick, with the simulated time."""
        return self.world.lead.kinematics(self.time0_ns)

    def recording(self) -> Recording:
        """Return samples and commands since the first command after the last reset."""
        rows, log, origin = self.world.recorder.rows(), self.lead.log.ticks(), self.lead.log.origin_tick or 0
        rows[:, 0] -= origin
        dropped = (self.world.recorder.dropped, self.lead.log.dropped)
        return Recording(rows, log - origin, self.profile.tick_ns, *dropped)
