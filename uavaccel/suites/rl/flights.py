"""Training and evaluation of a case of the RL experiment; an interrupted case continues where it stopped."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any, TypeVar, cast, get_type_hints

from numpy.typing import NDArray

from uavaccel.records import RunDirectory
from uavaccel.suites.evaluation.parts import outcomes
from uavaccel.suites.host_time import timed, wall_s
from uavaccel.suites.parts import fly_part, part_folder, part_run
from uavaccel.suites.report import Summary
from uavaccel.suites.rl.cases import (
    EVALUATION_SEED,
    EvaluationResult,
    RlRow,
    TrainingCase,
    TrainingResult,
    evaluation_part,
    flights,
    training_part,
)
from uavaccel.suites.rl.config import RlConfig
from uavaccel.suites.suite import GameResult
from uavaccel.suites.training.flights import CHECKPOINTS

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
