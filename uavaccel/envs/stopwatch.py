"""A stopwatch that attributes time to the phases of a training, as the paper's Figure 9 does."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from uavaccel.clock import WallClock
from uavaccel.units import NS_PER_S

PHASES = ("simulation", "rendering", "image_processing", "inference", "learning")


class Stopwatch:
    """Attributes the time on a clock to phases, to none before the first `switch`."""

    def __init__(self, clock: WallClock) -> None:
        self._clock = clock
        self._phase: str | None = None
        self._since_ns = 0
        self._spent_ns = dict.fromkeys(PHASES, 0)

    def switch(self, phase: str | None) -> None:
        """Attribute time from now on to `phase`, or to none."""
        now_ns = self._clock.now_ns()
        if self._phase is not None:
            self._spent_ns[self._phase] += now_ns - self._since_ns
        self._phase, self._since_ns = phase, now_ns

    @contextmanager
    def phase(self, phase: str) -> Iterator[None]:
        """Attribute the time inside the block to `phase`, and afterwards to none."""
        self.switch(phase)
        try:
            yield
        finally:
            self.switch(None)

    @contextmanager
    def aside(self, phase: str) -> Iterator[None]:
        """Attribute the time inside the block to `phase`, and afterwards to the phase before it."""
        before = self._phase
        self.switch(phase)
        try:
            yield
        finally:
            self.switch(before)

    def add(self, phase: str, duration_s: float) -> None:
        """Add a duration that was not measured here."""
        self._spent_ns[phase] += round(duration_s * NS_PER_S)

    def spent_s(self) -> dict[str, float]:
        """Return the seconds by phase."""
        return {phase: spent / NS_PER_S for phase, spent in self._spent_ns.items()}
