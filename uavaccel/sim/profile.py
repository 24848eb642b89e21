"""The two timing behaviours: `native`, where TCSC costs no accuracy, and `airsim`, the subject of the paper.

Times are in ticks of the profile's physics step. Source of the right-hand column: AirSim v1.8.1,
SimModeWorldBase.h (3 ms), SimpleFlightApi.hpp (50 Hz commands), Params.hpp (api_goal_timeout).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cache, lru_cache
from math import ceil

import mujoco

from uavaccel.errors import UserError
from uavaccel.units import NS_PER_S, ceil_div, exact, seconds_to_ns, ticks_exactly


@dataclass(frozen=True, eq=False)  # compared by identity: hashing seven fields would be slow
class Profile:
    """How a simulation steps, ends commands, continues and catches up."""

    name: str
    tick_ns: int
    goal_period_ticks: int  # a command ends on this grid, counted from its acceptance
    hover_after_ticks: int  # from the end of a command to position hold
    recorder_ticks: int
    exact_times: bool  # whether durations must be whole ticks
    exact_pauses: bool  # whether a continue-for ends at a tick, not by a wall timer
    catch_up_wall_ns: int  # backlog that is caught up; beyond it simulated time is lost

    @property
    def tick_s(self) -> float:
        """Physics step in seconds."""
        return self.tick_ns / NS_PER_S

    def t_th_ns(self, t_th_wall_s: float, clock_speed: float, t_sample_s: float) -> int:
        """Return TCSC's T_th in simulated nanoseconds: 0 if continue-for is exact, else latency × ClockSpeed.

        It is at most a tenth of T_sample and at least a tick, since a shorter continue-for may run none.
        """
        if self.exact_times:
            return 0
        latency_s = min(t_th_wall_s * clock_speed, 0.1 * t_sample_s)
        return max(seconds_to_ns(latency_s), self.tick_ns)

    def check_duration(self, duration_s: float, name: str) -> None:
        """Raise UserError if TCSC cannot fly a command or slice of that duration.

        An exact profile needs whole ticks. With wall timers a rest of a tick or less (T_th) is not flown, so that a
        command of that length would never begin.
        """
        if self.exact_times:
            ticks_exactly(duration_s, self.tick_ns, name)
        elif exact(duration_s) * NS_PER_S <= self.tick_ns:
            tick_ms = self.tick_ns / 1e6
            raise UserError(
                f"{name}: {duration_s:g} s is too short for the {self.name} profile; it has to be longer than its "
                f"physics step of {tick_ms:g} ms"
            )

    @property
    def loop_ticks(self) -> int:
        """Ticks between two turns of a flight task's loop: 20 ms, rounded up (getCommandPeriod)."""
        return ceil_div(_COMMAND_LOOP_NS, self.tick_ns)

    def nearest_ticks(self, duration_s: float) -> int:
        """Return `command_ticks`, or in an exact profile the nearest number of ticks, at least 1."""
        if self.exact_times:
            return max(round(exact(duration_s) * NS_PER_S / self.tick_ns), 1)
        return self.command_ticks(duration_s)

    @lru_cache(maxsize=256)  # noqa: B019  profiles live as long as the program; fractions are slow
    def command_ticks(self, duration_s: float) -> int:
        """Return the ticks of a command of `duration_s`. Raises UserError if an exact profile has none that fit."""
        if self.exact_times:
            return ticks_exactly(duration_s, self.tick_ns, "duration")
        period_ns = self.goal_period_ticks * self.tick_ns
        return self.goal_period_ticks * ceil(exact(duration_s) * NS_PER_S / period_ns)


NATIVE = Profile(
    name="native",
    tick_ns=2_000_000,
    goal_period_ticks=1,
    hover_after_ticks=30,
    recorder_ticks=25,
    exact_times=True,
    exact_pauses=True,
    catch_up_wall_ns=100_000_000,
)

# The 20 ms goal loop falls on the 3 ms grid every 21 ms; `> 60 ms` after the last goal is 63 ms. AirSim's executor
# makes no backlog good (ScheduledExecutor.hpp); 5 ms is the grain of the server's own loop.
AIRSIM = Profile(
    name="airsim",
    tick_ns=3_000_000,
    goal_period_ticks=7,
    hover_after_ticks=21,
    recorder_ticks=17,
    exact_times=False,
    exact_pauses=False,
    catch_up_wall_ns=5_000_000,
)

PROFILES = {profile.name: profile for profile in (NATIVE, AIRSIM)}

_COMMAND_LOOP_NS, _GOAL_TIMEOUT_NS, _RECORD_NS = 20_000_000, 60_000_000, 50_000_000


@cache
def airsim_variant(
    tick_ns: int = AIRSIM.tick_ns, goal_timeout_ns: int = _GOAL_TIMEOUT_NS, exact_pauses: bool = False
) -> Profile:
    """Return AIRSIM with another step, api_goal_timeout or exact pauses, for ablations; AIRSIM itself by default.

    Its loops are rounded to the step: that of commands to 20 ms or more, timeout and recorder to above 60 and 50 ms.
    """
    if (tick_ns, goal_timeout_ns, exact_pauses) == (AIRSIM.tick_ns, _GOAL_TIMEOUT_NS, False):
        return AIRSIM
    return replace(
        AIRSIM,
        tick_ns=tick_ns,
        goal_period_ticks=ceil_div(_COMMAND_LOOP_NS, tick_ns),
        hover_after_ticks=goal_timeout_ns // tick_ns + 1,
        recorder_ticks=_RECORD_NS // tick_ns + 1,
        exact_pauses=exact_pauses,
    )


@dataclass(frozen=True)
class Executor:
    """The speed that a ClockSpeed really gives in AirSim's physics thread.

    A tick takes `tick_cost_ns` of wall time. With `integer_clock_speed` a ClockSpeed above 1 loses its fraction.
    Source: SimModeWorldMultiRotor.cpp:48-72 (the loop's period is 3 ms over the ClockSpeed, cast to an integer) and
    ScheduledExecutor.hpp (a tick that takes longer than the period delays all that follow).
    """

    tick_cost_ns: int = 0
    integer_clock_speed: bool = False

    def speed(self, clock_speed: Fraction, tick_ns: int) -> Fraction:
        """Return simulated seconds per wall second while the clock runs, at most tick_ns / tick_cost_ns."""
        if self.integer_clock_speed and clock_speed > 1:
            clock_speed = Fraction(int(clock_speed))
        if self.tick_cost_ns:
            clock_speed = min(clock_speed, Fraction(tick_ns, self.tick_cost_ns))
        return clock_speed


UNBOUND = Executor()


@dataclass
class Frames:
    """A MODEL of Unreal's frames, every `period_ns` of wall time; with 0 an image shows the moment of its request.

    An image is asked for in the game's next tick and read back by the render thread, which is up to a frame behind
    (RenderRequest.cpp); frames keep no exact grid, so that the wait is taken as even between none and two periods.
    simContinueForTime, too, returns with a frame (ASimModeWorldBase::continueForTime). The rendered pawn is moved in
    the game's tick alone (ASimModeWorldBase::Tick), which does not come while the game is paused.

    `wait_ns` samples the wait for a frame. With `stale_pose` images show the pose of the game's last tick, at multiples
    of `period_ns` of wall time unless it is paused. With `after_continue` the reply of a continue-for waits for a frame
    too.
    """

    period_ns: int = 0
    stale_pose: bool = False
    after_continue: bool = False
    wait_ns: Callable[[], int] = lambda: 0
    _shown: mujoco.MjData | None = field(default=None, repr=False)

    def ready_ns(self, asked_ns: int) -> int:
        """Return the wall time at which an image requested at `asked_ns` is ready."""
        return asked_ns + self.wait_ns() if self.period_ns else asked_ns

    def continued(self, paused_ns: int) -> int:
        """Return the wall time at which a continue-for replies that has paused at `paused_ns`."""
        return self.ready_ns(paused_ns) if self.after_continue else paused_ns

    def ticks(self, from_ns: int, to_ns: int) -> range:
        """Return the game's ticks after `from_ns` up to `to_ns`; none unless poses are stale."""
        if not (self.period_ns and self.stale_pose):
            return range(0)
        first = ceil_div(from_ns + 1, self.period_ns) * self.period_ns
        return range(first, to_ns + 1, self.period_ns)

    def show(self, data: mujoco.MjData) -> None:
        """Let images show the pose in `data` from now on: the game has ticked."""
        self._shown = self._shown or mujoco.MjData(data.model)
        self._shown.qpos[:] = data.qpos

    def scene(self, data: mujoco.MjData) -> mujoco.MjData:
        """Return what a camera renders: the pose shown last or, without any, the present `data`."""
        return self._shown or data

    def forget(self) -> None:
        """Forget the pose shown, for a new game."""
        self._shown = None
