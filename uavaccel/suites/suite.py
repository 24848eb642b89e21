"""What an experiment is: one protocol, which the runner flies, the command line shows and `report` reports.

A suite lives in one folder and is registered in one line of suites/registry.py; one of one's own lives anywhere, and
its YAML names it: `suite: my_module:MySuite`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Generic, NamedTuple, Protocol, TypeAlias, TypeVar

import numpy as np

from uavaccel.errors import UserError, suggestion
from uavaccel.files import Plain
from uavaccel.machine import usable_cores
from uavaccel.records import RunDirectory
from uavaccel.suites.experiment import Experiment, resolve
from uavaccel.suites.report import Report, Row

if TYPE_CHECKING:
    from uavaccel.draw.film import Film


class Case(Protocol):
    """One game of a run."""

    @property
    def id(self) -> str:
        """Its name: that of its row and of its arrays' file, the same in any subset of a run."""
        ...

    @property
    def timing(self) -> str:
        """The clock that it is flown by: wall, virtual or lockstep."""
        ...

    def simulated_s(self) -> float:
        """Simulated seconds that it takes, about."""
        ...


@dataclass(frozen=True)
class GameResult:
    """A finished game: its row, its raw samples, and what is never the same twice, for timing.jsonl."""

    row: Row
    arrays: Mapping[str, np.ndarray] = field(default_factory=dict)
    host: Mapping[str, object] = field(default_factory=dict)
    next_is_ready: bool = False
    """Whether the next game has been flown already: this one's row need not be on disk before it is asked for."""


class Cost(NamedTuple):
    """About what a game takes on this machine."""

    wall_s: float
    disk_bytes: float


Opened: TypeAlias = Any  # what a suite's games are flown in

ConfigType = TypeVar("ConfigType", bound=Experiment)
CaseType = TypeVar("CaseType", bound=Case)
RowType = TypeVar("RowType", bound=Mapping[str, object])


class Suite(ABC, Generic[ConfigType, CaseType]):
    """An experiment. A game is flown by `fly`, in whatever `open` opened: a session, an environment, a training."""

    name: ClassVar[str]
    """The key `suite` of its YAML."""
    config: type[ConfigType]
    serial: ClassVar[str] = ""
    """Why its games must be flown one after another in one process; empty where they need not."""
    batch: ClassVar[int] = 4
    """Games that a worker process is handed at once; 1 where each takes minutes."""
    quick: ClassVar[Mapping[str, object] | None] = None
    """Keys of a quick measurement on the wall clock: a shipped experiment with a single --clock. None: it has none."""

    @property
    @abstractmethod
    def report_class(self) -> type[Report]:
        """What a finished run says: a class attribute, or a property that imports it when it is asked for."""

    @abstractmethod
    def cases(self, config: ConfigType) -> Iterator[CaseType]:
        """Every game of a run, in canonical order."""

    @abstractmethod
    def open(self, config: ConfigType, timing: str, run: RunDirectory) -> AbstractContextManager[Opened]:
        """What games of that timing are flown in, one process at a time; closed when they are done."""

    @abstractmethod
    def fly(self, config: ConfigType, case: CaseType, opened: Opened) -> GameResult:
        """Fly one game. Its row has the keys `suite` and `case`; the runner adds the arrays' path."""

    def report(self, run: RunDirectory) -> Report:
        """The report of a run, which is yet to be written. Raises UserError if the run has no finished game."""
        return self.report_class(run, self.name)

    def why_serial(self, config: ConfigType) -> str:
        """`serial`, where that depends on the configuration."""
        return self.serial

    def may_grow(self, folder: Path) -> tuple[str, ...]:
        """Keys whose numbers may be larger when the run in `folder` is gone on with: its cases stay as they are."""
        return ()

    def prepare(self, config: ConfigType, run: RunDirectory) -> None:
        """Before a run is begun or gone on with: bring what is in its folder to a point from which it can go on."""

    def finish(self, config: ConfigType, run: RunDirectory) -> None:
        """Once all games are flown: record what else the report needs."""

    def cost(self, config: ConfigType, case: CaseType) -> Cost:
        """What a game takes, about; by default its simulated time over a usual speed, and a row."""
        return Cost(flying_s(case), ROW_BYTES)

    def stage(self, case: CaseType) -> int:
        """Cases of a later stage are begun once all of the earlier ones are done: they build on them."""
        return 0

    def games(self, config: ConfigType, case: CaseType) -> int:
        """How many games a case is, where it is a whole run of another suite."""
        return 1

    def renders(self, config: ConfigType) -> bool:
        """Whether games need OpenGL."""
        return False

    def complete(self, mapping: Mapping[str, Plain]) -> Mapping[str, Plain]:
        """A YAML with the keys that it leaves out and that are known from elsewhere. Raises UserError."""
        return mapping

    def check(self, config: ConfigType) -> None:
        """Before anything is written: raises UserError for what only looking at other files or classes can tell."""

    def provenance(self, config: ConfigType) -> Mapping[str, object]:
        """What the manifest has to say beside versions, host and renderer."""
        return {}

    def status(self, rows: Sequence[Row]) -> str:
        """How it goes, in a few words for the progress display."""
        return ""

    def compare(self, runs: Sequence[RunDirectory]) -> Sequence[Path]:
        """Draw several runs side by side, into the first one's folder, beside its own figures; the pictures' paths."""
        return ()

    def film(self, run: RunDirectory, case: str | None) -> tuple[str, Film]:
        """A game's name and film; without `case` the most interesting. Raises UserError where nothing can be shown."""
        raise UserError(f"{run.path}: a run of {self.name} keeps no images to show")


AnySuite = Suite[Any, Any]
OnGame = Callable[[Case, Row], None]

VIRTUAL_RATE = 300.0  # simulated seconds per wall second and process, about
CORE_RATE = 250.0  # of lanes over arrays in the threads of one core, pictures and decisions with them
LANE_RATE, FULL = 150.0, 1024  # of a lane on a GPU, as long as it has room for more
ROW_BYTES = 1_000


def flying_s(case: Case, clock_speed: float = 1.0) -> float:
    """Wall time of a game without calls and images, about."""
    return case.simulated_s() / (clock_speed if case.timing == "wall" else VIRTUAL_RATE)


def kernels_s(case: Case, device: str, lanes: int) -> float:
    """Wall time of a game that the kernels fly among so many lanes, about."""
    rate = LANE_RATE * min(lanes, FULL) if device.startswith("cuda") else CORE_RATE * usable_cores()
    return case.simulated_s() / rate


def configuration(
    suite: Suite[ConfigType, CaseType], mapping: Mapping[str, Plain], source: str
) -> ConfigType:
    """A suite's checked configuration from a YAML's mapping, what it leaves out completed. Raises UserError."""
    config = resolve(suite.config, suite.complete(mapping), source)
    suite.check(config)
    return config


def choose_row(run: RunDirectory, case: str | None, by_interest: Sequence[RowType]) -> RowType:
    """The row of a case, or without one the most interesting. Raises UserError if there is no such game."""
    if not by_interest:
        raise UserError(f"{run.path / 'rows.jsonl'}: holds no finished game")
    if case is None:
        return by_interest[0]
    by_name = {str(row["case"]): row for row in by_interest}
    if case not in by_name:
        raise UserError(f"--case {case}: not in {run.path}; {suggestion(case, sorted(by_name))}")
    return by_name[case]
