"""The progress of a run: finished games, the suite's status, speed, time left; and of what follows it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from types import TracebackType
from typing import Self

from rich.console import Console
from rich.progress import BarColumn, TextColumn
from rich.progress import Progress as Bar

from uavaccel.clock import MonotonicClock
from uavaccel.draw.labels import in_words
from uavaccel.suites.rows import Row
from uavaccel.suites.suite import Case
from uavaccel.units import NS_PER_S

LINES = 10  # printed lines of progress without a terminal


class Progress:
    """A bar on a terminal, a few plain lines elsewhere.

    The time left is that of the cases to come at the pace of the finished ones, by their simulated time, once there
    are `jobs` of them, which fly at once. `rows` are those of games finished before the run was resumed; `status`
    summarises rows in a few words.
    """

    def __init__(
        self,
        cases: Sequence[Case],
        jobs: int,
        rows: Sequence[Row],
        status: Callable[[Sequence[Row]], str],
        console: Console,
    ) -> None:
        self._rows, self._status, self._console, self._jobs = list(rows), status, console, jobs
        done = {row["case"] for row in rows}
        self._games, self._left_s = len(cases), sum(case.simulated_s() for case in cases if case.id not in done)
        self._skipped = len(rows)
        self._passed_s = self._flown_s = 0.0
        self._clock = MonotonicClock()
        self._start_ns = self._clock.now_ns()
        self._printed = len(done) * LINES // max(self._games, 1)
        columns = (BarColumn(), TextColumn("{task.description}", markup=False))
        self._bar = Bar(*columns, console=console, disable=not console.is_terminal)
        self._task = self._bar.add_task("", total=self._games, completed=self._skipped)

    def flown(self, case: Case, row: Row) -> None:
        """Count a finished game; the runner's callback."""
        self._rows.append(row)
        self._passed_s += case.simulated_s()
        self._left_s -= case.simulated_s()
        self._flown_s += row.get("sim_time_s", case.simulated_s())
        share = len(self._rows) * LINES // self._games
        if self._console.is_terminal:
            self._bar.update(self._task, completed=len(self._rows), description=self._text())
        elif share > self._printed:
            self._printed = share
            self._console.print(self._text(), markup=False)

    def _text(self) -> str:
        wall_s = max((self._clock.now_ns() - self._start_ns) / NS_PER_S, 1e-9)
        measured = len(self._rows) - self._skipped >= self._jobs and self._passed_s > 0.0
        left = f"{in_words(self._left_s * wall_s / self._passed_s)} left" if measured else "time left unknown"
        status = self._status(self._rows)
        return (
            f"{len(self._rows)}/{self._games} games, {status + ', ' if status else ''}"
            f"{self._flown_s / wall_s:.0f} simulated s per wall s, {left}"
        )

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.stop()


@contextmanager
def working(name: str, console: Console, steps: int | None = None) -> Iterator[Callable[[], object]]:
    """Show on a terminal what is worked on, and yield the function that counts a step of it.

    Without `steps` the bar only moves. Elsewhere than on a terminal nothing is shown.
    """
    columns = BarColumn(), TextColumn("{task.description}", markup=False)
    with Bar(*columns, console=console, disable=not console.is_terminal, transient=True) as bar:
        task = bar.add_task(name, total=steps)
        yield lambda: bar.advance(task)
