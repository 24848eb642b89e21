"""The base class of reports: rows and arrays of a run become a summary, figures and a page; no game is flown."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any, get_args

from numpy.typing import NDArray

from uavaccel.draw.document import Block, Heading, Listing, Paragraph, Picture, Table, or_dash, to_html, to_markdown
from uavaccel.errors import UserError
from uavaccel.files import Plain
from uavaccel.records import RunDirectory
from uavaccel.suites.rows import Row

Summary = Mapping[str, Plain]
Values = dict[str, Plain]
"""A summary, or an entry of one, under construction."""
SummaryCell = Mapping[str, Plain]
"""An entry of a summary: numbers of the games under one condition."""
Arrays = Mapping[str, NDArray[Any]]
LoadArrays = Callable[[Row], Arrays]
"""Loads the arrays of a row, as `RunDirectory.load_arrays` does."""

Column = tuple[str, Callable[[SummaryCell], str]]
"""A column of a table: its header, and a function from an entry to its text."""


def number(header: str, key: str, form: str) -> Column:
    """Return the column of a number, "-" where it is not known; `form` is that of `str.format`."""
    return header, lambda cell: or_dash(cell[key], form.format)


class Report(ABC):
    """The report of one run, with a method for each step: rows -> summary -> figures -> blocks of a page."""

    def __init__(self, run: RunDirectory, suite: str) -> None:
        """Read the rows. Raises UserError if the run has no finished game of that suite."""
        self.run = run
        self.config = run.config()
        self.rows: list[Plain] = [row for row in run.rows() if row.get("suite") == suite]
        if not self.rows:
            raise UserError(f"{run.path / 'rows.jsonl'}: holds no finished game of {suite}")

    @abstractmethod
    def summarise(self) -> Summary:
        """Return the contents of summary.json, from this run's rows and arrays: plain data and numpy's."""

    @abstractmethod
    def title(self) -> str:
        """Return the page's title."""

    def figures(self) -> Sequence[Picture]:
        """Plot the figures into the run's folder `figures`."""
        return ()

    @abstractmethod
    def blocks(self, figures: Sequence[Picture]) -> Sequence[Block]:
        """Return the blocks of the page; configuration and manifest are added below them."""

    def headline(self) -> str:
        """Return the result in a sentence, which stands on top of the page and is printed when the run ends."""
        return ""

    def pace(self) -> str:
        """Return how long the games took on this machine; no summary has it, since it is never reproduced."""
        return ""

    def overview(self) -> Table | None:
        """Return the result in a small table, which is printed when the run ends."""
        return None

    @cached_property
    def summary(self) -> Summary:
        return self.summarise()

    def write_summary(self) -> Summary:
        """Write summary.json. Raises UserError for damaged files."""
        self.run.write_json("summary.json", self.summary)
        return self.summary

    def write(self) -> Summary:
        """Write summary.json, figures/, report.md and report.html. Raises UserError for damaged files."""
        self.write_summary()
        verdict = [Paragraph(f"{said}.")] if (said := self.headline()) else []
        blocks = [*verdict, *self._own_blocks(), Heading("Provenance"), *_provenance(self.run)]
        self.run.write_text("report.md", to_markdown(self.title(), blocks, self.run.path))
        self.run.write_text("report.html", to_html(self.title(), blocks))
        return self.summary

    def _own_blocks(self) -> list[Block]:
        blocks: list[Any] = list(self.blocks(self.figures()))
        for block in blocks:
            if not isinstance(block, Block):
                kinds = ", ".join(kind.__name__ for kind in get_args(Block))
                raise TypeError(f"{type(self).__name__}.blocks: {block!r} is no block of a page: {kinds}")
        return blocks


def _provenance(run: RunDirectory) -> list[Block]:
    files = [run.path / "config.yaml", run.path / "manifest.json"]
    return [
        Listing(path.read_text(encoding="utf-8", errors="replace"), folded=path.name)
        for path in files
        if path.is_file()
    ]


def summary_table(summary: Summary) -> Table:
    """Return the summary without its lists as a collapsed table."""
    plain = [(key, str(value)) for key, value in summary.items() if not isinstance(value, list)]
    return Table(("", ""), plain, folded="summary.json")


def listed(values: Sequence[object]) -> str:
    """Return values in words, as in "1, 2, 3"."""
    return ", ".join(str(value) for value in values)
