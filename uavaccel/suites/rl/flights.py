"""One cell from the first training game to the last evaluation lane; a cell that was stopped goes on where it was."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from uavaccel.records import RunDirectory
from uavaccel.suites.evaluation.parts import outcomes
from uavaccel.suites.host_time import timed, wall_s
from uavaccel.suites.parts import fly_part, part_folder, part_run
from uavaccel.suites.rl.cases import EVALUATION_SEED, TrainingCase, evaluation_part, flights, training_part
from uavaccel.suites.rl.config import RlConfig
from uavaccel.suites.suite import GameResult
from uavaccel.suites.training.flights import CHECKPOINTS

LEARNED = ("games", "successes", "commands", "sim_time_s", "phase_s", "weights_sha256")
FLOWN = ("command", "clock_speed", "timing", "simulator", "games", "successes")
NAMES = ("variant", "profile", "command", "clock_speed", "seed")


def fly_cell(config: RlConfig, cell: TrainingCase, run: RunDirectory) -> GameResult:
    """Train, unless the cell is of a policy that is there, and evaluate.

    The row holds both in numbers, the arrays each evaluation lane's outcome.
    """
    row = {
        "suite": "rl",
        "case": cell.id,
        **{name: getattr(cell, name) for name in NAMES},
        "timing": cell.clock,
    }
    host: dict[str, float] = {}
    if not cell.exact:
        row["training"], host = _train(config, cell, run)
    (row["evaluations"], arrays), took = timed(lambda: _evaluate(config, cell, run))
    return GameResult(row, arrays, {**host, "evaluations_s": took["host_wall_s"]})


def _train(
    config: RlConfig, cell: TrainingCase, run: RunDirectory
) -> tuple[dict[str, Any], dict[str, float]]:
    """What was learned, and what that took on this machine."""
    name = f"{cell.trained}/training"
    learned = fly_part(run, name, training_part(config, cell), cell.seed, pages=False)
    # gigabytes that a finished training has no use for
    shutil.rmtree(part_folder(run, name) / CHECKPOINTS, ignore_errors=True)
    return {key: learned[key] for key in LEARNED}, {"training_s": wall_s(part_run(run, name))}


def _evaluate(
    config: RlConfig, cell: TrainingCase, run: RunDirectory
) -> tuple[list[dict[str, Any]], dict[str, NDArray[Any]]]:
    """Each flight in numbers, and its lanes' outcomes."""
    agent = part_folder(run, f"{cell.trained}/training").resolve()
    evaluations: list[dict[str, Any]] = []
    arrays: dict[str, NDArray[Any]] = {}
    for flight in flights(config, cell):
        part, name = evaluation_part(config, cell, flight, agent), f"{cell.trained}/evaluation-{flight.name}"
        _drop_other_agents(part_folder(run, name), part.keys["agent"])
        summary = fly_part(run, name, part, EVALUATION_SEED, pages=False)
        evaluations.append({key: summary[key] for key in FLOWN})
        arrays |= {f"{flight.name}_{key}": each for key, each in outcomes(part_run(run, name)).items()}
    return evaluations, arrays


def _drop_other_agents(place: Path, agent: str) -> None:
    """An evaluation begun before the run was moved names its policy by another path: it is flown anew."""
    if (place / "config.yaml").is_file() and RunDirectory(place).config().get("agent") != agent:
        shutil.rmtree(place)
