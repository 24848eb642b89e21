"""AirSim's physics thread: the speed that a ClockSpeed really gives.

Source: AirSim v1.8.1, SimModeWorldMultiRotor.cpp:48-72 (the loop's period is 3 ms over the ClockSpeed, cast to an
integer) and ScheduledExecutor.hpp (a tick that takes longer than the period delays all that follow).
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction


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
