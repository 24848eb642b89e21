"""Parts of a run that are runs of other suites, each in a run directory of its own below the whole run's."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field

from uavaccel.config import Config
from uavaccel.files import Plain, inside
from uavaccel.forms import ArrayForm
from uavaccel.records import RunDirectory
from uavaccel.suites.experiment import Experiment
from uavaccel.suites.gpu import on_own_gpu
from uavaccel.suites.registry import configuration, find_suite, merged, open_run, read_mapping
from uavaccel.suites.report import Report
from uavaccel.suites.rows import Row
from uavaccel.suites.runner import run_suite, start_run
from uavaccel.suites.suite import AnySuite, CaseType, ConfigType, Suite


class Part(Config):
    """A run of another experiment, with some of its keys changed."""

    experiment: str
    """Name of an experiment that ships, or of a YAML file."""
    keys: dict[str, Plain] = Field(default_factory=dict)
    """Values by dotted key, as for --set."""


class SuiteOfRuns(Suite[ConfigType, CaseType]):
    """A suite whose cases are runs of other suites, its parts."""

    batch = 1
    unit = "cells"

    @abstractmethod
    def runs(self, config: ConfigType, case: CaseType) -> Sequence[tuple[AnySuite, Any]]:
        """Return suite and configuration of each run of a case. Raises UserError for invalid ones."""

    def games(self, config: ConfigType, case: CaseType) -> int:
        return sum(suite.games(run, game) for suite, run in self.runs(config, case) for game in suite.cases(run))

    def renders(self, config: ConfigType) -> bool:
        return any(suite.renders(run) for case in self.cases(config) for suite, run in self.runs(config, case))

    def open(self, config: ConfigType, timing: str, run: RunDirectory) -> AbstractContextManager[RunDirectory]:
        _, first = self.runs(config, next(self.cases(config)))[0]
        return on_own_gpu(run, str(getattr(first, "device", "cpu")))

    def status(self, rows: Sequence[Row]) -> str:
        return f"{rows[-1]['case']} won {rows[-1]['successes']} of {rows[-1]['games']}"


def simulated_s(suite: AnySuite, config: Any) -> float:
    """Estimate the simulated seconds of a run."""
    return sum(case.simulated_s() for case in suite.cases(config))


def part_suite(part: Part, seed: int) -> tuple[AnySuite, Experiment]:
    """Return the part's suite and configuration. Raises UserError."""
    mapping, source = read_mapping(part.experiment)
    suite = find_suite(mapping.get("suite"), source)
    return suite, configuration(suite, merged(mapping, {"seed": seed, **part.keys}), source)


def fly_part(run: RunDirectory, name: str, part: Part, seed: int, pages: bool = True) -> Report:
    """Fly, in this process, what the part still lacks, and return its report, which has been written.

    Without `pages` summary.json alone is written; `uavaccel run --report` makes the rest.
    """
    return fly_below(run, name, *part_suite(part, seed), pages)


def fly_below(run: RunDirectory, name: str, suite: AnySuite, config: Experiment, pages: bool = True) -> Report:
    """Fly a part as `fly_part` does, of a suite and a configuration."""
    manifest = {key: value for key, value in run.manifest().items() if key != "resumed"}
    flown = start_run(suite, config, part_folder(run, name), manifest, resume=True)
    run_suite(suite, config, flown)
    report = suite.report(flown)
    report.write() if pages else report.write_summary()
    return report


def part_folder(run: RunDirectory, name: str) -> Path:
    """Return the folder of a part, which need not exist."""
    return inside(run.path, f"parts/{name}")


def part_run(run: RunDirectory, name: str) -> RunDirectory:
    """Return a part's run directory. Raises UserError if it was not flown."""
    return open_run(part_folder(run, name))


OUTCOMES = {
    "lane": ArrayForm("iu", ("games",), optional=True),
    "game": ArrayForm("iu", ("games",), optional=True),
    "is_success": ArrayForm("b", ("games",)),
    "distance_m": ArrayForm("f8", ("games",), optional=True),
}
"""The arrays of an evaluation, as `outcomes` makes them."""


def outcomes(run: RunDirectory) -> dict[str, np.ndarray]:
    """Return lane, or game of another environment, success and metres north (n,) of an evaluation's games."""
    rows, kinds = run.rows(), {"lane": np.int64, "game": np.int64, "is_success": np.bool_, "distance_m": np.float64}
    return {key: np.array([row[key] for row in rows], kind) for key, kind in kinds.items() if key in rows[0]}
