"""Parts of a run that are runs of other suites, each in a run directory of its own below the whole run's.

Processes that fly them take a GPU each, and its share of the cores, whichever run started them.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from abc import abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO, TypeAlias

import numpy as np
from pydantic import Field, field_validator

from uavaccel.config import MOST_PROCESSES, Config
from uavaccel.errors import UserError
from uavaccel.files import Plain, inside
from uavaccel.forms import ArrayForm
from uavaccel.own_code import file_beside, trusting
from uavaccel.records import RunDirectory
from uavaccel.suites.experiment import Row
from uavaccel.suites.registry import (
    configuration,
    find_suite,
    folder_beside,
    is_file,
    merged,
    open_run,
    read_mapping,
    with_task,
)
from uavaccel.suites.report import Report
from uavaccel.suites.runner import run_suite, start_run
from uavaccel.suites.suite import AnySuite, CaseType, ConfigType, Suite

if TYPE_CHECKING:
    from uavaccel.suites.flight import Flight

VISIBLE, EGL_DEVICE = "CUDA_VISIBLE_DEVICES", "MUJOCO_EGL_DEVICE_ID"
Run: TypeAlias = tuple[AnySuite, Any]
"""A run's suite and its configuration."""
_place: TextIO | None = None  # among the GPUs, held as long as this process lives

OUTCOMES = {
    "lane": ArrayForm("iu", ("games",), optional=True),
    "game": ArrayForm("iu", ("games",), optional=True),
    "is_success": ArrayForm("b", ("games",)),
    "distance_m": ArrayForm("f8", ("games",), optional=True),
}
"""The arrays of an evaluation, as `outcomes` makes them."""


class Part(Config):
    """A run of another experiment, with some of its keys changed."""

    experiment: str
    """Name of an experiment that ships, or of a YAML file, here or beside the one that names it."""
    keys: dict[str, Plain] = Field(default_factory=dict)
    """Values by dotted key, as for --set."""

    @field_validator("experiment")
    @classmethod
    def _is_found(cls, experiment: str) -> str:
        return str(file_beside(experiment)) if is_file(experiment) else experiment

    def resolve(self, seed: int) -> Run:
        """Return suite and configuration. Raises UserError."""
        mapping, source = read_mapping(self.experiment)
        beside = folder_beside(self.experiment) if is_file(self.experiment) else None
        with trusting(beside=beside, modules=()):  # no code of it
            suite = find_suite(mapping.get("suite"), source)
            keys = merged(with_task(suite, mapping), {"seed": seed, **self.keys})
            return suite, configuration(suite, keys, f"part {source}")


class SuiteOfRuns(Suite[ConfigType, CaseType]):
    """A suite whose cases are runs of other suites, its parts."""

    batch = 1
    unit = "cell"

    @abstractmethod
    def runs(self, config: ConfigType, case: CaseType) -> Sequence[Run]:
        """Return the runs of a case. Raises UserError for invalid ones."""

    def size(self, config: ConfigType, case: CaseType) -> tuple[int, float]:
        """Count the games of the runs of a case, and estimate their simulated seconds."""
        games, seconds = 0, 0.0
        for suite, run in self.runs(config, case):
            for game in suite.cases(run):
                games += suite.games(run, game)
                seconds += game.simulated_s()
        return games, seconds

    def games(self, config: ConfigType, case: CaseType) -> int:
        return self.size(config, case)[0]

    def renders(self, config: ConfigType) -> bool:
        return any(suite.renders(run) for case in self.cases(config) for suite, run in self.runs(config, case))

    def provenance(self, config: ConfigType) -> Mapping[str, object]:
        """Check that this machine has the devices of the first case, the last run of each suite. Raises UserError."""
        found: dict[str, object] = {}
        for suite, run in {run[0].name: run for run in self.runs(config, next(self.cases(config)))}.values():
            found |= {key: value for key, value in suite.provenance(run).items() if key == "gpu"}
        return found

    @contextmanager
    def open(self, config: ConfigType, timing: str, run: RunDirectory) -> Iterator[RunDirectory]:
        """Yield the run, in a process that has a GPU of its own from now on."""
        _, first = self.runs(config, next(self.cases(config)))[0]
        acquire_gpu(str(getattr(first, "device", "cpu")))
        yield run

    def flight(
        self, report: Report, game: Mapping[str, Any], pictures: bool = True, event_rate_hz: float | None = None
    ) -> Flight:
        raise UserError(f"{report.run.path}: a run of {self.name} has its flights in the runs below parts/; take one")

    def status(self, rows: Sequence[Row]) -> str:
        return f"{rows[-1]['case']} won {rows[-1]['successes']} of {rows[-1]['games']}"


def fly_part(run: RunDirectory, name: str, part: Run, pages: bool = True) -> Report:
    """Fly what a part still lacks, and return its report, of which without `pages` summary.json alone is written."""
    suite, config = part
    manifest = {key: value for key, value in run.manifest().items() if key != "resumed"}
    flown = start_run(suite, config, part_folder(run, name), manifest, resume=True)
    run_suite(suite, config, flown)
    report = suite.report(flown)
    report.write() if pages else report.write_summary()
    return report


def train_part(run: RunDirectory, name: str, part: Run) -> Report:
    """Fly a training, and return its report; its checkpoints, gigabytes of no use once it is over, are removed.

    Raises UserError where its device is missing.
    """
    from uavaccel.suites.train import CHECKPOINTS

    suite, config = part
    suite.provenance(config)
    report = fly_part(run, name, part, pages=False)
    shutil.rmtree(report.run.path / CHECKPOINTS, ignore_errors=True)
    return report


def evaluate_part(run: RunDirectory, name: str, part: Run) -> Report:
    """Fly an evaluation, and return its report.

    One that was begun before the run was moved names a policy of the run by another path, and begins anew.
    """
    folder = part_folder(run, name)
    if (folder / "config.yaml").is_file() and RunDirectory(folder).config().get("agent") != part[1].agent:
        shutil.rmtree(folder)
    return fly_part(run, name, part, pages=False)


def part_folder(run: RunDirectory, name: str) -> Path:
    """Return the folder of a part, which need not exist."""
    return inside(run.path, f"parts/{name}")


def part_run(run: RunDirectory, name: str) -> RunDirectory:
    """Return a part's run directory. Raises UserError if it was not flown."""
    return open_run(part_folder(run, name))


def outcomes(run: RunDirectory) -> dict[str, np.ndarray]:
    """Return lane, or game of another environment, success and metres north (n,) of an evaluation's games."""
    rows, kinds = run.rows(), {"lane": np.int64, "game": np.int64, "is_success": np.bool_, "distance_m": np.float64}
    return {key: np.array([row[key] for row in rows], kind) for key, kind in kinds.items() if key in rows[0]}


# --- GPUs -----------------------------------------------------------------------------------------------------------


def acquire_gpu(device: str) -> None:
    """Assign a free GPU to this process and those that it starts, where `device` is `cuda` and there are several.

    GPUs are claimed by locks on files in the temporary folder, so that processes of different runs share them, and a
    GPU is free again however its process ended. Call it before CUDA's first use, which fixes the visible GPUs.
    """
    import torch as th

    if device != "cuda" or _place is not None or th.cuda.is_initialized():
        return
    visible = [name.strip() for name in os.environ.get(VISIBLE, "").split(",") if name.strip()]
    visible = visible or list(map(str, range(th.cuda.device_count())))
    if len(visible) < 2:
        return
    place = _acquire_slot() % len(visible)
    os.environ[VISIBLE] = gpu = visible[place]
    if gpu.isdigit():
        os.environ.setdefault(EGL_DEVICE, gpu)
    if hasattr(os, "sched_setaffinity"):  # Linux alone has it; so that no process slows those of other GPUs down
        cores = sorted(os.sched_getaffinity(0))
        size = len(cores) // len(visible)
        if size >= 2:
            os.sched_setaffinity(0, cores[place * size : (place + 1) * size])


def _acquire_slot() -> int:
    """Return the first place that no other process holds."""
    import fcntl  # not on Windows

    global _place
    folder = Path(tempfile.gettempdir()) / f"uavaccel-gpus-{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    for number in range(MOST_PROCESSES):
        _place = (folder / str(number)).open("a")
        with suppress(BlockingIOError):
            fcntl.flock(_place, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return number
        _place.close()
    _place = None
    return 0
