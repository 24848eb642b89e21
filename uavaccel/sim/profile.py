"""The two timing behaviours: `native`, where TCSC costs no accuracy, and `airsim`, the subject of the paper.

Times are in ticks of the profile's physics step. Source of the right-hand column: AirSim v1.8.1,
SimModeWorldBase.h (3 ms), SimpleFlightApi.hpp (50 Hz commands), Params.hpp (api_goal_timeout).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cache, lru_cache
from math import ceil

from uavaccel.errors import UserError
from uavaccel.units import NS_PER_S, ceil_div, exact, seconds_to_ns, ticks_exactly


@dataclass(frozen=True, eq=False)  # each is one of a kind, and hashing seven fields would be slow
class Profile:
    """How a simulation steps, ends commands, continues and keeps up."""

    name: str
    tick_ns: int
    goal_period_ticks: int  # a command ends on this grid, counted from its acceptance
    hover_after_ticks: int  # position hold sets in so long after a command has returned
    recorder_ticks: int
    exact_times: bool  # times that the tick does not divide are refused
    exact_pauses: bool  # a continue-for ends on the tick; otherwise a wall timer ends it
    catch_up_wall_ns: int  # backlog that is made good; beyond it simulated time is lost

    @property
    def tick_s(self) -> float:
        return self.tick_ns / NS_PER_S

    def t_th_ns(self, t_th_wall_s: float, clock_speed: float, t_sample_s: float) -> int:
        """TCSC's T_th in simulated nanoseconds: 0 where continue-for is exact; else latency × ClockSpeed.

        At most a tenth of T_sample, at least a tick: a shorter continue-for may not bring any.
        """
        if self.exact_times:
            return 0
        latency_s = min(t_th_wall_s * clock_speed, 0.1 * t_sample_s)
        return max(seconds_to_ns(latency_s), self.tick_ns)

    def check_duration(self, duration_s: float, name: str) -> None:
        """Raise UserError where TCSC cannot fly a command, or a sample, of that time.

        An exact profile needs whole ticks. A wall timer is not asked for a rest of a tick or less (T_th), so that a
        command no longer than that would never begin.
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
        """Ticks between two turns of a flight command's loop, 20 ms or the next tick (getCommandPeriod)."""
        return ceil_div(_COMMAND_LOOP_NS, self.tick_ns)

    def nearest_ticks(self, duration_s: float) -> int:
        """As `command_ticks`; an exact profile takes the nearest time that fits, a tick at least."""
        if self.exact_times:
            return max(round(exact(duration_s) * NS_PER_S / self.tick_ns), 1)
        return self.command_ticks(duration_s)

    @lru_cache(maxsize=256)  # noqa: B019  profiles live as long as the program; fractions are slow
    def command_ticks(self, duration_s: float) -> int:
        """Ticks that a command of `duration_s` lasts; raises UserError in an exact profile if it does not fit."""
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
    """AirSim with another step, another api_goal_timeout or exact pauses, for ablations; AIRSIM itself by default.

    Its loops end on the step: the command's at 20 ms or after, the timeout and the recorder beyond 60 and 50 ms.
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
    """What a tick of physics takes of wall time, and whether a ClockSpeed above 1 loses its fraction."""

    tick_cost_ns: int = 0
    integer_clock_speed: bool = False

    def speed(self, clock_speed: Fraction, tick_ns: int) -> Fraction:
        """Simulated seconds per wall second while the clock runs; ticks of `tick_ns` of simulated time.

        A tick never takes less than its cost, so that the speed saturates at tick_ns / tick_cost_ns.
        """
        if self.integer_clock_speed and clock_speed > 1:
            clock_speed = Fraction(int(clock_speed))
        if self.tick_cost_ns:
            clock_speed = min(clock_speed, Fraction(tick_ns, self.tick_cost_ns))
        return clock_speed


UNBOUND = Executor()
