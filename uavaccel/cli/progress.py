"""Progress of a run: games done, simulated and wall time, time left."""

from __future__ import annotations

from types import TracebackType
from typing import Any, Self

from rich.console import Console
from rich.progress import BarColumn, TextColumn
from rich.progress import Progress as RichProgress

from uavaccel.clock import MonotonicClock
from uavaccel.units import NS_PER_S

LINES = 10  # of progress where there is no terminal to redraw


class Progress:
    """A bar on a terminal, a few plain lines elsewhere; time left is estimated from simulated seconds."""

    def __init__(self, total_s: float, games: int, console: Console) -> None:
        self._total_s, self._games, self._console = total_s, games, console
        self._done_s, self._done, self._skipped_s = 0.0, 0, 0.0
        self._clock = MonotonicClock()
        self._start_ns = self._clock.now_ns()
        self._printed = 0
        self._bar = RichProgress(
            BarColumn(), TextColumn("{task.description}"), console=console, disable=not console.is_terminal
        )
        self._task = self._bar.add_task("", total=total_s)

    def skip(self, simulated_s: float) -> None:
        """Count a game that an earlier run has flown."""
        self._skipped_s += simulated_s
        self._count(simulated_s)

    def flown(self, case: Any, row: dict[str, Any]) -> None:
        """Count a game; the runner's callback."""
        self._count(case.simulated_s())
        text = self._text()
        self._bar.update(self._task, completed=self._done_s, description=text)
        share = self._done * LINES // self._games
        if not self._console.is_terminal and share > self._printed:
            self._printed = share
            self._console.print(text)

    def _count(self, simulated_s: float) -> None:
        self._done += 1
        self._done_s += simulated_s

    def _text(self) -> str:
        wall_s = (self._clock.now_ns() - self._start_ns) / NS_PER_S
        flown_s = self._done_s - self._skipped_s
        left_s = wall_s * (self._total_s - self._done_s) / flown_s if flown_s else 0.0
        return (
            f"{self._done}/{self._games} games, {self._done_s:,.0f} simulated s, "
            f"{wall_s:.0f} s passed, {left_s:.0f} s left"
        )

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.stop()
