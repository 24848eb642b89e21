"""The suite `rl`: each case trains a policy and evaluates it, resumed where it stopped; runs can be merged."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar, cast, get_type_hints

from numpy.typing import NDArray

from uavaccel.config import validate
from uavaccel.envs.simulators import EXACT
from uavaccel.errors import UserError
from uavaccel.records import RunDirectory
from uavaccel.rl.agents import DEFAULT
from uavaccel.suites.gpu import on_own_gpu
from uavaccel.suites.host_time import timed, wall_s
from uavaccel.suites.old_report import Summary
from uavaccel.suites.parts import fly_part, outcomes, part_folder, part_run, part_suite
from uavaccel.suites.rl.cases import (
    ARRAYS,
    EVALUATION_SEED,
    EvaluationResult,
    RlRow,
    Size,
    TrainingCase,
    TrainingResult,
    cases,
    evaluation_part,
    flights,
    part_configs,
    size_of,
    training_part,
)
from uavaccel.suites.rl.config import RlConfig
from uavaccel.suites.rl.report import RlReport
from uavaccel.suites.rows import Row
from uavaccel.suites.suite import GameResult, Suite
from uavaccel.suites.training.config import CHECKPOINTS

FOLDER = "merged"
MAY_DIFFER = ("cells", "command", "clock_speed", "profile", "timing", "seed", "seeds")


def merge_runs(runs: Sequence[RunDirectory]) -> RunDirectory:
    """Merge the finished cells of several runs into a new run directory, `merged`, in the first run's folder.

    Raises UserError where two runs hold the same cell, or were not trained and evaluated alike.
    """
    first = runs[0]
    _check_mergeable(runs)
    place = first.path / FOLDER
    shutil.rmtree(place, ignore_errors=True)
    config = validate(RlConfig, _merged_config(runs), str(first.path / "config.yaml"))
    made_of = {str(run.path): run.manifest() for run in runs}
    merged = RunDirectory.create(place, config, {**first.manifest(), "merged_from": made_of})
    for run in runs:
        host = {entry["case"]: entry for entry in run.timings()}
        for row in run.rows():
            merged.append_row(row | merged.save_arrays(row["case"], run.load_arrays(row)))
            if row["case"] in host:
                merged.append_timing(host[row["case"]])
    return merged


def _merged_config(runs: Sequence[RunDirectory]) -> dict[str, Any]:
    """Return the first run's configuration with the cells and seeds of all runs."""
    blocks: list[Mapping[str, Any]] = []
    for run in runs:
        blocks += [block for block in run.config()["cells"] if block not in blocks]
    whole = {key: value for key, value in runs[0].config().items() if key not in MAY_DIFFER}
    first = min(run.config()["seed"] for run in runs)
    last = max(run.config()["seed"] + run.config()["seeds"] for run in runs)
    return {**whole, "cells": blocks, "seed": first, "seeds": last - first}


def _check_mergeable(runs: Sequence[RunDirectory]) -> None:
    alike = {key: value for key, value in runs[0].config().items() if key not in MAY_DIFFER}
    owner: dict[str, RunDirectory] = {}
    for run in runs:
        for key, value in alike.items():
            if run.config().get(key) != value:
                where = f"{run.path}: {key} differs from that of {runs[0].path}"
                raise UserError(f"{where}: they make no one table")
        for row in run.rows():
            if row["case"] in owner:
                raise UserError(f"{run.path}: has {row['case']}, which {owner[row['case']].path} has too")
            owner[row["case"]] = run


class Rl(Suite[RlConfig, TrainingCase]):
    """`uavaccel run rl`."""

    name = "rl"
    config = RlConfig
    report_class = RlReport
    row = RlRow
    arrays = ARRAYS
    batch = 1

    def check(self, config: RlConfig) -> None:
        """Check that training and evaluations of each cell can be configured. Raises UserError."""
        evaluations = {}
        for cell in cases(config.model_copy(update={"seeds": 1})):
            evaluations[cell.exact] = part_configs(config, cell)[-1]
        if config.exact_seeds:
            _refuse_other_lanes(evaluations[False], evaluations[True])

    def provenance(self, config: RlConfig) -> Mapping[str, Any]:
        """Check that this machine has the devices of training and evaluation. Raises UserError."""
        cell = next(cases(config))
        parts = training_part(config, cell), evaluation_part(config, cell, flights(config, cell)[0], DEFAULT)
        try:
            for suite, part in (part_suite(part, config.seed) for part in parts):
                suite.provenance(part)
        except UserError as error:
            raise UserError(f"{error}; without a GPU: uavaccel run rl_smoke") from error
        return {}

    def may_grow(self, folder: Path) -> tuple[str, ...]:
        return ("seeds", "exact_seeds")

    def stage(self, case: TrainingCase) -> int:
        """Policies are evaluated in the exact simulator once all of them are trained."""
        return int(case.exact)

    def cases(self, config: RlConfig) -> Iterator[TrainingCase]:
        known: dict[str, Size] = {}  # trainings that differ in their seed alone are of one size
        for cell in cases(config):
            kind = replace(cell, seed=0).id
            if kind not in known:
                known[kind] = size_of(config, cell)
            yield replace(cell, size=known[kind])

    def games(self, config: RlConfig, case: TrainingCase) -> int:
        return case.size.games

    def renders(self, config: RlConfig) -> bool:
        parts = [training_part(config, cell) for cell in cases(config.model_copy(update={"seeds": 1}))]
        return any(suite.renders(training) for suite, training in [part_suite(part, 0) for part in parts])

    def open(self, config: RlConfig, timing: str, run: RunDirectory) -> AbstractContextManager[RunDirectory]:
        part = training_part(config, next(cases(config)))
        return on_own_gpu(run, str(getattr(part_suite(part, config.seed)[1], "device", "cpu")))

    def fly(self, config: RlConfig, case: TrainingCase, opened: RunDirectory) -> GameResult:
        return fly_cell(config, case, opened)

    def status(self, rows: Sequence[Row]) -> str:
        flown = rows[-1]["evaluations"][0]
        return f"{rows[-1]['case']} won {flown['successes']} of {flown['games']}"

    def compare(self, runs: Sequence[RunDirectory]) -> list[Path]:
        """Write one report of the cells of several runs, in the folder `merged` of the first."""
        merged = merge_runs(runs)
        self.report(merged).write()
        return [merged.path / "report.html"]


def _refuse_other_lanes(evaluation: Any, exact: Any) -> None:
    """Raise UserError unless both simulators evaluate on the same lanes."""
    if exact.simulator != EXACT or evaluation.simulator == EXACT:
        raise UserError(
            f"exact_seeds: needs exact.keys.simulator = {EXACT}, not {exact.simulator}, beside an evaluation by the "
            f"kernels, not by {evaluation.simulator}; or exact_seeds = 0"
        )
    if (exact.first_lane, exact.games) != (evaluation.first_lane, evaluation.games):
        raise UserError("exact.keys: games and first_lane must be those of evaluation.keys, lane for lane")


Result = TypeVar("Result", TrainingResult, EvaluationResult)


def fly_cell(config: RlConfig, cell: TrainingCase, run: RunDirectory) -> GameResult:
    """Train, unless the cell evaluates a policy that exists, and evaluate.

    The row has the summaries of both, the arrays the outcome of each evaluated lane.
    """
    host: dict[str, float] = {}
    row: RlRow = {
        "suite": "rl",
        "case": cell.id,
        "variant": cell.variant,
        "profile": cell.profile,
        "command": cell.command,
        "clock_speed": cell.clock_speed,
        "seed": cell.seed,
        "timing": cell.clock,
        "evaluations": [],
    }
    if not cell.exact:
        row["training"], host = _train(config, cell, run)
    (row["evaluations"], arrays), took = timed(lambda: _evaluate(config, cell, run))
    return GameResult(row, arrays, {**host, "evaluations_s": took["host_wall_s"]})


def _train(
    config: RlConfig, cell: TrainingCase, run: RunDirectory
) -> tuple[TrainingResult, dict[str, float]]:
    """Return the result of the training, and how long it took on this machine."""
    name = f"{cell.trained}/training"
    learned = fly_part(run, name, training_part(config, cell), cell.seed, pages=False)
    # gigabytes that are of no use once the training is over
    shutil.rmtree(part_folder(run, name) / CHECKPOINTS, ignore_errors=True)
    return _kept(TrainingResult, learned), {"training_s": wall_s(part_run(run, name))}


def _evaluate(
    config: RlConfig, cell: TrainingCase, run: RunDirectory
) -> tuple[list[EvaluationResult], dict[str, NDArray[Any]]]:
    """Return the result of each flight, and the outcomes of its lanes."""
    agent = part_folder(run, f"{cell.trained}/training").resolve()
    evaluations: list[EvaluationResult] = []
    arrays: dict[str, NDArray[Any]] = {}
    for flight in flights(config, cell):
        part, name = evaluation_part(config, cell, flight, agent), f"{cell.trained}/evaluation-{flight.name}"
        _drop_other_agents(part_folder(run, name), part.keys["agent"])
        summary = fly_part(run, name, part, EVALUATION_SEED, pages=False)
        evaluations.append(_kept(EvaluationResult, summary))
        arrays |= {f"{flight.name}_{key}": each for key, each in outcomes(part_run(run, name)).items()}
    return evaluations, arrays


def _kept(result: type[Result], summary: Summary) -> Result:
    """Return the keys of a result out of a summary."""
    return cast(Result, {key: summary[key] for key in get_type_hints(result)})


def _drop_other_agents(place: Path, agent: str) -> None:
    """Delete an evaluation that was begun before the run was moved, and names its policy by another path."""
    if (place / "config.yaml").is_file() and RunDirectory(place).config().get("agent") != agent:
        shutil.rmtree(place)
