"""What a finished run says: its rows and arrays become a summary, figures and a page. No game is flown."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any, NotRequired, TypedDict

from numpy.typing import NDArray

from uavaccel.draw.document import Block, Heading, Listing, Picture, Table, or_dash, to_html, to_markdown
from uavaccel.errors import UserError
from uavaccel.files import Plain
from uavaccel.records import RunDirectory

Row = Mapping[str, Plain]
"""A finished game, or a whole part, as rows.jsonl has it; a suite may have a `GameRow` of its own."""


class Disturbances(TypedDict, total=False):
    """What kept a game on the machine's own clock from running as it should: keys that its row has only then."""

    lost_wall_s: float
    """Wall time that the simulation could not make good."""
    stalled_wall_s: float
    """Wall time for which the server did not answer."""
    restarts: int
    """Servers that were started again."""
    disturbed: bool


class GameRow(Disturbances):
    """The keys that the row of a game has in every suite."""

    suite: str
    case: str
    arrays: NotRequired[str]
    arrays_sha256: NotRequired[str]


class LaneRow(GameRow):
    """What is kept of a game in the obstacle lane, in a training as in an evaluation."""

    is_success: bool
    distance_m: float
    collision: str | None
    lane: int
    commands: int
    phase_s: dict[str, float]
    sim_time_s: float
    conditions: NotRequired[Mapping[str, float]]


Summary = Mapping[str, Plain]
Values = dict[str, Plain]
"""A row or a summary that is being made."""
SummaryCell = Mapping[str, Plain]
"""An entry of a summary: the games of one setting, in numbers."""
Arrays = Mapping[str, NDArray[Any]]
LoadArrays = Callable[[Row], Arrays]
"""Gives the arrays of a row, as `RunDirectory.load_arrays`."""

Column = tuple[str, Callable[[SummaryCell], str]]
"""Of a table of cells: its header, and its text."""


def number(header: str, key: str, form: str) -> Column:
    """The column of a cell's number, "-" where it is not known; `form` as for `str.format`."""
    return header, lambda cell: or_dash(cell[key], form.format)


class Report(ABC):
    """The report of one run: rows -> summary -> figures -> blocks of a page, a method each."""

    def __init__(self, run: RunDirectory, suite: str) -> None:
        """Raises UserError if the run has no finished game of that suite."""
        self.run = run
        self.config = run.config()
        self.rows: list[Plain] = [row for row in run.rows() if row.get("suite") == suite]
        if not self.rows:
            raise UserError(f"{run.path / 'rows.jsonl'}: holds no finished game of {suite}")

    @abstractmethod
    def summarise(self) -> Summary:
        """What summary.json holds: plain data and numpy's, of this run's rows and arrays."""

    @abstractmethod
    def title(self) -> str:
        """The page's."""

    def figures(self) -> Sequence[Picture]:
        """Draw them into the run's folder `figures`."""
        return ()

    @abstractmethod
    def blocks(self, figures: Sequence[Picture]) -> Sequence[Block]:
        """The page, from its first sentence on; configuration and manifest follow of themselves."""

    def headline(self) -> str:
        """The result in a sentence, printed when the run ends."""
        return ""

    def pace(self) -> str:
        """What the games took on this machine; it is in no summary, since it is never the same twice."""
        return ""

    def overview(self) -> Table | None:
        """The result in a small table, printed when the run ends."""
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
        blocks = [*self.blocks(self.figures()), Heading("Provenance"), *_provenance(self.run)]
        self.run.write_text("report.md", to_markdown(self.title(), blocks, self.run.path))
        self.run.write_text("report.html", to_html(self.title(), blocks))
        return self.summary


def _provenance(run: RunDirectory) -> list[Block]:
    files = [run.path / "config.yaml", run.path / "manifest.json"]
    return [Listing(path.read_text(encoding="utf-8"), folded=path.name) for path in files if path.is_file()]


def summary_table(summary: Summary) -> Table:
    """summary.json to unfold, without its lists."""
    plain = [(key, str(value)) for key, value in summary.items() if not isinstance(value, list)]
    return Table(("", ""), plain, folded="summary.json")


def listed(values: Sequence[object]) -> str:
    """1, 2, 3."""
    return ", ".join(str(value) for value in values)
