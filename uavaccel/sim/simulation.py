"""A free-running simulation and the commands that fly it, told the wall time by whoever owns it.

Pull, not push: `advance_to(wall_ns)` runs every tick that is due by then; between two calls nothing moves. No
thread, no socket, no sleep. A message handled at wall time w sees every tick due at w, and its goal acts from the
next tick; whatever ends at tick n is seen by messages before tick n + 1.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

import numpy as np

from uavaccel.clock import Pacer, positive_clock_speed
from uavaccel.kinematics import Kinematics, Quaternion, Vector, VelocityGoal
from uavaccel.sim.executor import Executor
from uavaccel.sim.frames import Frames
from uavaccel.sim.profile import Profile
from uavaccel.sim.recording import Recording
from uavaccel.sim.world import LEVEL, START_M, FlightError, World
from uavaccel.units import NS_PER_S, exact

COMMAND_LOG_LENGTH = 1 << 16
TRACE_LENGTH = 1 << 16


class DeferredReply:
    """A reply that is not yet due: `join` of a command, or a continue-for."""

    def __init__(self) -> None:
        self.value: Any = None
        self.encode: Callable[[Any], Any] = lambda value: value  # as the wire wants it
        self.due_wall_ns: int | None = None
        self.on_due: Callable[[DeferredReply], None] | None = None

    def resolve(self, value: Any, wall_ns: int) -> None:
        """Fix the reply and the wall time before which it may not leave."""
        self.value, self.due_wall_ns = value, wall_ns
        if self.on_due is not None:
            self.on_due(self)


@dataclass
class _Command:
    end_tick: int
    reply: DeferredReply


@dataclass
class _Continue:
    """A running continue-for: up to a tick, or in `airsim` up to a wall time."""

    reply: DeferredReply
    end_tick: int | None = None
    end_wall_ns: int | None = None


@dataclass
class Speed:
    """Simulated and wall time passed while the clock ran, and the wall time given up as lost."""

    simulated_ns: int = 0
    wall_ns: int = 0
    lost_wall_ns: int = 0

    @property
    def real_time_factor(self) -> float:
        """Achieved simulated seconds a wall second; 0 before the clock ran."""
        return self.simulated_ns / self.wall_ns if self.wall_ns else 0.0


@dataclass
class Trace:
    """What the simulation did and when: (event, wall ns, simulated ns), the latest; kept only while switched on."""

    events: deque[tuple[str, int, int]] = field(default_factory=lambda: deque(maxlen=TRACE_LENGTH))
    enabled: bool = False


_UNBOUND = Executor()


class Simulation:
    """Clock, commands and recorder over one `World`.

    `catch_up_wall_ns`: backlog of wall time that is made good; what exceeds it is lost and counted. None: no
    bound, for a simulated wall clock, which is never late. `timer_lateness_ns` draws how late a wall timer ends
    (`airsim`); on a real clock it is as late as it is.
    """

    def __init__(
        self,
        world: World,
        clock_speed: float = 1.0,
        wall_ns: int = 0,
        catch_up_wall_ns: int | None = None,
        timer_lateness_ns: Callable[[], int] = lambda: 0,
        executor: Executor = _UNBOUND,
        frames: Frames | None = None,
    ) -> None:
        self.world = world
        self.profile: Profile = world.profile
        self.executor, self.frames = executor, frames or Frames()
        self.clock_speed = positive_clock_speed(clock_speed)  # as asked for; the pacer's is what comes of it
        self.pacer = Pacer(self._executed_speed(), self.profile.tick_ns)
        self.catch_up_wall_ns = catch_up_wall_ns
        self._timer_lateness_ns = timer_lateness_ns
        self.paused = False
        self.api_control = False
        self.trace = Trace()
        self.failure: str | None = None
        self._time0_ns = 0
        self._wall_ns = wall_ns
        self._command: _Command | None = None
        self._continue: _Continue | None = None
        self._start_over(wall_ns)

    # --- time -------------------------------------------------------------------------------------

    def _executed_speed(self) -> Fraction:
        return self.executor.speed(self.clock_speed, self.profile.tick_ns)

    @property
    def time_ns(self) -> int:
        """Simulated time since the simulation was made; a reset does not set it back, as in AirSim."""
        return self.time_of(self.world.tick)

    def time_of(self, tick: int) -> int:
        """Simulated time at a tick since the last reset."""
        return self._time0_ns + tick * self.profile.tick_ns

    def advance_to(self, wall_ns: int) -> None:
        """Fly every tick that is due by `wall_ns`, end what ends on the way, and show what frames show."""
        if not self.paused:
            for tick_ns in self.frames.ticks(self._wall_ns, wall_ns):
                self._advance_to(tick_ns)
                if not self.paused:
                    self.frames.show(self.world.data)
        self._advance_to(wall_ns)

    def _advance_to(self, wall_ns: int) -> None:
        if self.catch_up_wall_ns is not None and wall_ns - self._wall_ns > self.catch_up_wall_ns:
            self._drop_backlog(wall_ns)
        while not self.paused:
            end_tick = self._next_event_tick()
            target = self.pacer.ticks_due(wall_ns)
            self._fly_to(target if end_tick is None else min(target, end_tick))
            if end_tick is None or end_tick > target:
                break
            self._end_at_tick(self.pacer.wall_due(end_tick))
        if (timer := self.wall_timer_ns()) is not None and wall_ns >= timer:
            self.note("timer", timer)  # when it was due; the pause that follows is when it ended
            self.pause(wall_ns)
        self._account(wall_ns)

    def next_event_wall_ns(self) -> int | None:
        """When something will end unless a message comes first; None while nothing will."""
        if self.paused:
            return None
        if (timer := self.wall_timer_ns()) is None:
            return None if (tick := self._next_event_tick()) is None else self.pacer.wall_due(tick)
        return timer if self._command is None else min(timer, self.pacer.wall_due(self._command.end_tick))

    def wall_timer_ns(self) -> int | None:
        """When a running continue-for of the `airsim` profile is over, on the wall clock."""
        return self._continue.end_wall_ns if self._continue and not self.paused else None

    def _drop_backlog(self, wall_ns: int) -> None:
        """Give up wall time that nobody asked for in time: the machine, or this process, was held up."""
        behind_ns = wall_ns - self.pacer.wall_due(self.world.tick + 1)
        lost = behind_ns - (self.catch_up_wall_ns or 0)
        if not self.paused and lost > 0:
            self.speed.lost_wall_ns += lost
            self.pacer.anchor(wall_ns - (self.catch_up_wall_ns or 0), self.world.tick + 1)

    def _fly_to(self, tick: int) -> None:
        """Fly up to a tick. What cannot be integrated is a `failure`, and the vehicle stands still from there on.

        Time goes on, so that nobody waits for ever; commands end with False.
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
            self.speed.wall_ns += wall_ns - self._wall_ns
        self._wall_ns = wall_ns

    def _next_event_tick(self) -> int | None:
        command, period = self._command, self._continue
        if period is None or period.end_tick is None:
            return command.end_tick if command else None
        return min(command.end_tick, period.end_tick) if command else period.end_tick

    def _end_at_tick(self, wall_ns: int) -> None:
        tick = self.world.tick
        if self._command and self._command.end_tick <= tick:
            self._end_command(self.failure is None, wall_ns)
        if self._continue and self._continue.end_tick is not None and self._continue.end_tick <= tick:
            self.pause(wall_ns)

    def note(self, event: str, wall_ns: int) -> None:
        """Add to the trace, if it is switched on."""
        if self.trace.enabled:
            self.trace.events.append((event, wall_ns, self.time_ns))

    # --- clock commands ---------------------------------------------------------------------------

    def set_clock_speed(self, clock_speed: float, wall_ns: int) -> None:
        """Go on at another speed. Raises UserError unless it is above 0."""
        self.clock_speed = positive_clock_speed(clock_speed)
        self.pacer.set_clock_speed(self._executed_speed(), wall_ns)

    def pause(self, wall_ns: int) -> None:
        """Stop simulated time; a running continue-for replies at once."""
        if not self.paused:
            self._account(wall_ns)
            self.paused = True
            self.note("pause", wall_ns)
        self._release_continue(wall_ns)

    def run(self, wall_ns: int) -> None:
        """Let simulated time go on; ends a continue-for's period, as simPause(False) does."""
        if self.paused:
            self.paused = False
            self._wall_ns = wall_ns
            self.pacer.anchor(wall_ns, self.world.tick)
            self.note("run", wall_ns)
        self._release_continue(wall_ns)

    def _release_continue(self, wall_ns: int) -> None:
        if self._continue:
            reply, self._continue = self._continue.reply, None
            reply.resolve(self.kinematics(), self.frames.continued(wall_ns))

    def continue_for(self, duration_ns: int, wall_ns: int) -> DeferredReply:
        """Run for `duration_ns` of simulated time, then pause and reply the `Kinematics`.

        A second one replaces the first.
        Rounded to a tick in an exact profile; a wall timer in `airsim`, which the scheduler ends.
        """
        self.run(wall_ns)
        period = self._continue = _Continue(DeferredReply())
        if self.profile.exact_times:
            ticks = round(Fraction(duration_ns, self.profile.tick_ns))
            period.end_tick = self.world.tick + ticks
        else:
            timer = wall_ns + round(duration_ns / self.clock_speed) + self._timer_lateness_ns()
            one_tick = self.pacer.wall_due(
                self.world.tick + 1
            )  # the executor flies before it looks at its timer
            period.end_wall_ns = max(timer, one_tick) if duration_ns > 0 else timer
        self.advance_to(wall_ns)  # it may be over already
        return period.reply

    def continue_for_wall(self, seconds: float, wall_ns: int) -> DeferredReply:
        """AirSim's simContinueForTime: `seconds` of wall time, so times clock_speed of simulated time."""
        return self.continue_for(round(exact(seconds) * self.clock_speed * NS_PER_S), wall_ns)

    # --- flight commands --------------------------------------------------------------------------

    def fly_velocity(self, goal: VelocityGoal, duration_s: float, wall_ns: int) -> DeferredReply:
        """Fly a velocity for a simulated time; a running command ends with False (latest wins).

        Raises UserError where an exact profile's tick does not divide the time. Without API control the command
        takes its time and has no effect (OffboardApi.hpp).
        """
        ticks = self.profile.command_ticks(duration_s)
        self._end_command(False, wall_ns)
        if self.api_control:
            vx, vy, vz = goal.velocity_m_s
            held = goal.height_m is not None
            third = vz if goal.height_m is None else goal.height_m
            self.world.fly_velocity((vx, vy, third), held, goal.yaw, goal.yaw_is_rate)
            self.world.hold_from(None)
        if not self.commands and self.world.recording:
            self.world.start_recording()  # t = 0 is the tick at which the first command is accepted
        self._command = _Command(self.world.tick + ticks, DeferredReply())
        self.commands.append((self.world.tick, self.world.tick + ticks))
        self.note("accept", wall_ns)
        return self._command.reply

    def cancel(self, wall_ns: int) -> None:
        """End the running command, if any, with False; position hold follows after the goal timeout."""
        self._end_command(False, wall_ns)

    def _end_command(self, completed: bool, wall_ns: int) -> None:
        if self._command is None:
            return
        command, self._command = self._command, None
        if not completed:
            self.commands[-1] = (self.commands[-1][0], self.world.tick)
        if self.api_control:
            self.world.hold_from(self.world.tick + self.profile.hover_after_ticks)
        self.note("end", wall_ns)
        command.reply.resolve(completed, wall_ns)

    def arm(self, armed: bool) -> bool:
        """Switch the rotors on or off; needs API control (OffboardApi::arm)."""
        if self.api_control:
            self.world.state["armed"] = int(armed)
        return self.api_control

    # --- start and record -------------------------------------------------------------------------

    def reset(self, wall_ns: int, position_m: Vector = START_M, orientation_wxyz: Quaternion = LEVEL) -> None:
        """Back to a settled hover, API control off; what runs is released, a command with False."""
        self._end_command(False, wall_ns)
        if self._continue:
            self.pause(wall_ns)
        self._time0_ns = self.time_ns
        self.world.reset(position_m, orientation_wxyz)
        self.api_control = False
        self._start_over(wall_ns)

    def _start_over(self, wall_ns: int) -> None:
        self._command = self._continue = None
        self.commands: deque[tuple[int, int]] = deque(maxlen=COMMAND_LOG_LENGTH)
        self.failure = None
        self.frames.forget()
        self.speed = Speed()
        self._wall_ns = wall_ns
        self.pacer.anchor(wall_ns, self.world.tick)

    def kinematics(self) -> Kinematics:
        """The state at the present tick, stamped with `time_ns`."""
        return self.world.kinematics(self._time0_ns)

    def recording(self) -> Recording:
        """What the recorder and the command log hold since the first command after the last reset."""
        origin = self.commands[0][0] if self.commands else 0
        rows = self.world.samples()
        rows[:, 0] -= origin
        log = np.array(self.commands, dtype=np.int64).reshape(-1, 2) - origin
        return Recording(rows, log, self.profile.tick_ns, self.world.samples_dropped)
