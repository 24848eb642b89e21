"""The console on which all commands print: plain text on lines that are not wrapped, tables, and progress."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import accumulate
from typing import TYPE_CHECKING, Self

from rich.console import Console
from rich.progress import BarColumn, TextColumn
from rich.progress import Progress as Bar
from rich.table import Table as RichTable

from uavaccel.errors import UserError

if TYPE_CHECKING:
    from uavaccel.draw.page import Table
    from uavaccel.suites.experiment import Row
    from uavaccel.suites.suite import AnySuite, Case

console = Console(highlight=False, markup=False, soft_wrap=True)
COLUMN_GAP = 2  # characters between the columns of a table, as wide as rich pads them
TABLE_WIDTH = 170  # where the output is no terminal
LINES = 10  # printed lines of progress without a terminal


def print_columns(header: Sequence[str], rows: Sequence[Sequence[str]], width: int | None = None) -> None:
    """Print a table, on the console or on `width` characters."""
    lines = RichTable(*header, box=None, pad_edge=False)
    for row in rows:
        lines.add_row(*row)
    (console if width is None else Console(highlight=False, width=width)).print(lines)


def show_table(table: Table) -> None:
    """Print the columns of a table that fit into the terminal uncut, and say how many more the report has.

    In a file there is room for all.
    """
    width = console.width if console.is_terminal else TABLE_WIDTH
    fit = columns_within(table, width)
    print_columns(table.header[:fit], [row[:fit] for row in table.rows], width)
    if left := len(table.header) - fit:
        console.print(f"{left} more column{'s' if left > 1 else ''} in the report")


def columns_within(table: Table, width: int) -> int:
    """Return how many columns, from the left and at least one, fit into `width` characters.

    A column is as wide as its widest cell, or the longest word of its header, which may be broken into lines.
    """
    widths = [
        max(map(len, [*name.split(), *cells, ""])) + COLUMN_GAP
        for name, *cells in zip(table.header, *table.rows, strict=True)
    ]
    return max(sum(end - COLUMN_GAP <= width for end in accumulate(widths)), 1)


class Progress:
    """A bar on a terminal, a few plain lines elsewhere.

    The time left is that of the cases to come at the pace of the finished ones, by their simulated time, once there
    are `jobs` of them, which fly at once. `rows` are those of cases finished before the run was resumed.
    """

    def __init__(
        self, suite: AnySuite, cases: Sequence[Case], jobs: int, rows: Sequence[Row], console: Console
    ) -> None:
        from uavaccel.clock import MonotonicClock  # loads NumPy

        self._rows, self._suite, self._console, self._jobs = list(rows), suite, console, jobs
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
        if not self._bar.disable:
            self._bar.update(self._task, completed=len(self._rows), description=self._text())
        elif share > self._printed:
            self._printed = share
            self._console.print(self._text(), markup=False)

    def _text(self) -> str:
        from uavaccel.draw.page import counted, in_words
        from uavaccel.units import NS_PER_S

        wall_s = max((self._clock.now_ns() - self._start_ns) / NS_PER_S, 1e-9)
        measured = len(self._rows) - self._skipped >= self._jobs and self._passed_s > 0.0
        left = f"{in_words(max(self._left_s, 0.0) * wall_s / self._passed_s)} left" if measured else "time left unknown"
        status = self._suite.status(self._rows) or ""
        if not isinstance(status, str):
            raise UserError(f"{self._suite.name}: status returned a {type(status).__name__}, not a text")
        return (
            f"{len(self._rows)}/{counted(self._games, self._suite.unit)}, {status}{', ' * bool(status)}"
            f"{self._flown_s / wall_s:.0f} simulated s per wall s, {left}"
        )

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._bar.stop()


@contextmanager
def working(name: str, steps: int = 0) -> Iterator[Callable[[], object]]:
    """Show on a terminal what is worked on, and yield the function that counts a step of it.

    Without `steps` the bar only moves. Elsewhere than on a terminal nothing is shown.
    """
    columns = BarColumn(), TextColumn("{task.description}", markup=False)
    with Bar(*columns, console=console, disable=not console.is_terminal, transient=True) as bar:
        task = bar.add_task(name, total=steps or None)
        yield lambda: bar.advance(task)
