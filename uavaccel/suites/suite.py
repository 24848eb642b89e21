"""The base class of experiments, which the runner flies and the command line shows.

A suite is a file of its own and a line in suites/registry.py; a custom suite may be in any module, and its YAML
names it: `suite: my_module:MySuite`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Protocol, TypeAlias, TypeVar

import numpy as np

from uavaccel.draw.page import Block, Table, counted
from uavaccel.errors import UserError, suggestion
from uavaccel.files import Plain
from uavaccel.forms import ArrayForm, RowForm
from uavaccel.machine import gpu
from uavaccel.records import RunDirectory
from uavaccel.suites.experiment import Experiment, GameRow, Row
from uavaccel.units import real

if TYPE_CHECKING:
    import pandas as pd

    from uavaccel.suites.flight import Flight
    from uavaccel.suites.report import Report


class Case(Protocol):
    """One game of a run, or a whole run of another suite."""

    @property
    def id(self) -> str:
        """The name of its row and of its arrays' file, the same in any subset of a run."""
        ...

    @property
    def timing(self) -> str:
        """The clock on which it is flown: wall, virtual or lockstep."""
        ...

    def simulated_s(self) -> float:
        """Estimate the simulated seconds that it takes."""
        ...


@dataclass(frozen=True)
class SimpleCase:
    """A case with a name, a timing, and an estimate of its simulated seconds."""

    id: str
    timing: str
    typical_s: float

    def simulated_s(self) -> float:
        return self.typical_s


@dataclass(frozen=True)
class GameResult:
    """A finished game: its row, its raw samples, and the host's times, which go to timing.jsonl."""

    row: Row
    arrays: Mapping[str, np.ndarray] = field(default_factory=dict)
    host: Mapping[str, object] = field(default_factory=dict)
    next_is_ready: bool = False
    """Whether the next game has been flown already, so that this row need not be on disk before it."""


Opened: TypeAlias = Any  # a session, an environment, a training: whatever `Suite.open` opens

ConfigType = TypeVar("ConfigType", bound=Experiment)
CaseType = TypeVar("CaseType", bound=Case)


class Suite(ABC, Generic[ConfigType, CaseType]):
    """An experiment. `fly` flies a game in what `open` opened: a session, an environment, a training."""

    name: ClassVar[str]
    """The key `suite` of its YAML."""
    config: type[ConfigType]
    row: ClassVar[Any] = GameRow
    """The TypedDict of its rows, or a union of such: rows are checked against it whenever they are read."""
    arrays: ClassVar[Mapping[str, ArrayForm]] = {}
    """The forms of its arrays."""
    serial: ClassVar[str] = ""
    """The reason why its games must be flown one after another in one process; empty if there is none."""
    batch: ClassVar[int] = 4
    """Number of games that a worker process takes at once; 1 where each takes minutes."""
    unit: ClassVar[str] = "game"
    """What its cases are called: another word where one is several games."""
    grows: ClassVar[tuple[str, ...]] = ()
    """Keys whose numbers may grow when a run is resumed, without a change to its cases."""
    quick: ClassVar[Mapping[str, object] | None] = None
    """Keys of a quick measurement on the wall clock, a shipped experiment with a single --clock, if it has one."""

    @abstractmethod
    def cases(self, config: ConfigType) -> Iterator[CaseType]:
        """Yield every game of a run, in canonical order."""

    @abstractmethod
    def open(self, config: ConfigType, timing: str, run: RunDirectory) -> AbstractContextManager[Opened]:
        """Open what games of a timing are flown in, in each process; it is closed when they are done."""

    @abstractmethod
    def fly(self, config: ConfigType, case: CaseType, opened: Opened) -> GameResult:
        """Fly one game. Its row has the keys `suite` and `case`; the runner adds the path of the arrays."""

    def report(self, run: RunDirectory) -> Report:
        """Return the report of a run, which is yet to be written. Raises UserError for a run without finished games."""
        run.form = self.form
        from uavaccel.suites.report import Report

        return Report(run, self)

    @property
    def form(self) -> RowForm:
        """The form of what its runs hold."""
        return RowForm(self.row, self.name, self.case_of, self.arrays)

    def case_of(self, row: Plain) -> str:
        """Return the name of a row's case by its other keys; overridden where these say it."""
        return str(row["case"])

    def score(self, report: Report) -> pd.DataFrame:
        """Return the report's games with columns that their arrays tell; it may be slow."""
        return report.games

    def summary(self, report: Report) -> Mapping[str, Any]:
        """Return the contents of summary.json, from the report's scores: plain data and numpy's."""
        return {"suite": self.name, "games": len(report.games)}

    def title(self, report: Report) -> str:
        """Return the page's title."""
        return self.name

    def headline(self, report: Report) -> str:
        """Return the result in a sentence, which stands on top of the page and is printed when the run ends."""
        return ""

    def source(self, report: Report) -> str:
        """Return where the page's numbers come from, which it says once: clocks, games, seeds."""
        from uavaccel.suites.report import CLOCK, source_line

        timings = report.games.get("timing", default=())
        return source_line(report.games) if len(timings) and all(each in [*CLOCK] for each in timings) else ""

    def overview(self, report: Report) -> Table | None:
        """Return the result in a small table, which is printed when the run ends."""
        return None

    def page(self, report: Report) -> Iterator[Block | str]:
        """Yield the blocks of the page; configuration and manifest are added below them."""
        names = [name for name in report.games if name not in ("suite", "arrays", "arrays_sha256")]
        yield Table.of(report.games, {name: itemgetter(name) for name in names})

    def flight(
        self, report: Report, game: Mapping[str, Any], pictures: bool = True, event_rate_hz: float | None = None
    ) -> Flight:
        """Return the flight of a game, one of the report's rows, to be watched, filmed or exported.

        Without `pictures` it need not have images and events. The events are those of the flight's own images, or, with
        `event_rate_hz`, where it is flown again, those of a second event camera. By default a flight is read from the
        game's arrays, if they have the names of a recording's. Raises UserError where nothing was kept of it.
        """
        from uavaccel.suites.flight import ARRAYS, FLIGHT, Flight

        if "arrays" not in game:
            raise UserError(
                f"{report.run.path}: a run of {self.name} keeps no flights to show; runs of dp1, dp2 and evaluate do, "
                "as does `uavaccel fly --out FOLDER`: evaluate a training's policy, and take that"
            )
        arrays = report.run.load_arrays(game)
        if missing := [name for name in ARRAYS if name not in arrays]:
            raise UserError(f"{report.run.path}: the arrays of {game['case']} have no {', '.join(missing)}")
        RowForm(GameRow, arrays=FLIGHT).check_arrays(arrays, {}, f"{report.run.path}: {game['case']}", "")
        speed = real(game.get("clock_speed"))
        return Flight.of(f"{game['case']}", speed if speed is not None and speed > 0 else 1.0, arrays)

    def interest(self, row: Row) -> Any:
        """Return a key that sorts games, the most interesting first: references last, the fastest first, TCSC's first.

        Of these the one with the longest commands, which is long enough to be watched.
        """
        speed = row.get("clock_speed")
        fast = -float(speed) if isinstance(speed, int | float) else 0.0
        return row.get("role") != "game", fast, row.get("command") != "tcsc", -float(row.get("t_move_s") or 0.0)

    def why_serial(self, config: ConfigType) -> str:
        """Return `serial`; overridden where it depends on the configuration."""
        return self.serial

    def may_grow(self, folder: Path) -> Mapping[str, str]:
        """Return `grows`, each with why it cannot with what the run in `folder` has; with "" if it can."""
        return dict.fromkeys(self.grows, "")

    def prepare(self, config: ConfigType, run: RunDirectory) -> None:
        """Bring the run's folder to a state from which it can be resumed; called before a run is begun or resumed."""

    def finish(self, config: ConfigType, run: RunDirectory) -> None:
        """Record what else the report needs; called once all games are flown."""

    def stage(self, case: CaseType) -> int:
        """Return the stage of a case, which is begun once all cases of earlier stages are done."""
        return 0

    def games(self, config: ConfigType, case: CaseType) -> int:
        """Return the number of games of a case, which may be a whole run of another suite."""
        return 1

    def renders(self, config: ConfigType) -> bool:
        """Return whether games need OpenGL."""
        return False

    @staticmethod
    def complete(mapping: Mapping[str, Plain]) -> Mapping[str, Plain]:
        """Return a YAML's mapping with omitted keys that are known from elsewhere. Raises UserError."""
        return mapping

    def check(self, config: ConfigType) -> None:
        """Raise UserError for mistakes that only other files or classes reveal; called before anything is written."""

    def provenance(self, config: ConfigType) -> Mapping[str, object]:
        """Return what the manifest has beside versions, host and renderer; of its device here."""
        return gpu(str(getattr(config, "device", "cpu")))

    def status(self, rows: Sequence[Row]) -> str:
        """Return a few words for the progress display."""
        return ""

    def compare(self, runs: Sequence[RunDirectory]) -> Sequence[Path]:
        """Compare several runs in files in the first one's folder, and return their paths."""
        return ()


AnySuite = Suite[Any, Any]
OnGame = Callable[[Case, Row], None]


def choose_row(suite: AnySuite, report: Report, case: str | None = None, number: int | None = None) -> Row:
    """Return a game's row by its case or its place in rows.jsonl, by default the most interesting. Raises UserError."""
    rows: Sequence[Row] = report.rows
    if number is not None:
        if not 0 <= number < len(rows):
            raise UserError(
                f"--game {number}: {report.run.path} has {counted(len(rows), 'game')}, from 0 to {len(rows) - 1}"
            )
        return rows[number]
    if case is None:
        return min(rows, key=suite.interest)
    by_name = {str(row["case"]): row for row in rows}
    if case not in by_name:
        raise UserError(f"--case {case}: not in {report.run.path}; {suggestion(case, sorted(by_name))}")
    return by_name[case]
