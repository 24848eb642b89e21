"""Where the time of a training goes: the phases of the paper's Figure 9."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from uavaccel.clock import WallClock
from uavaccel.units import NS_PER_S

PHASES = ("simulation", "rendering", "image_processing", "inference", "learning")


class Stopwatch:
    """Charges the time of a clock to one phase after another; to none before the first `switch`."""

    def __init__(self, clock: WallClock) -> None:
        self._clock = clock
        self._phase: str | None = None
        self._since_ns = 0
        self._spent_ns = dict.fromkeys(PHASES, 0)

    def switch(self, phase: str | None) -> None:
        """What passes from now on belongs to `phase`, or to nothing."""
        now_ns = self._clock.now_ns()
        if self._phase is not None:
            self._spent_ns[self._phase] += now_ns - self._since_ns
        self._phase, self._since_ns = phase, now_ns

    @contextmanager
    def phase(self, phase: str) -> Iterator[None]:
        """What passes inside belongs to `phase`, and to nothing afterwards."""
        self.switch(phase)
        try:
            yield
        finally:
            self.switch(None)

    @contextmanager
    def aside(self, phase: str) -> Iterator[None]:
        """What passes inside belongs to `phase`, and afterwards to whatever it was before."""
        before = self._phase
        self.switch(phase)
        try:
            yield
        finally:
            self.switch(before)

    def add(self, phase: str, duration_s: float) -> None:
        """Time known from elsewhere."""
        self._spent_ns[phase] += round(duration_s * NS_PER_S)

    def get_state(self) -> dict[str, int]:
        """Nanoseconds so far, by phase; between two phases."""
        return dict(self._spent_ns)

    def set_state(self, state: dict[str, int]) -> None:
        self._spent_ns = dict(state)

    def spent_s(self) -> dict[str, float]:
        """Seconds so far, by phase."""
        return {phase: spent / NS_PER_S for phase, spent in self._spent_ns.items()}
