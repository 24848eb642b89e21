"""One cell from the first training game to the last evaluation lane; a cell that was stopped goes on where it was."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from uavaccel.records import RunDirectory
from uavaccel.suites.evaluation.parts import outcomes
from uavaccel.suites.host_time import wall_s
from uavaccel.suites.parts import fly_part, part_folder, part_run
from uavaccel.suites.rl.cases import EVALUATION_SEED, TrainingCase, evaluation_part, flights, training_part
from uavaccel.suites.rl.config import RlConfig
from uavaccel.suites.suite import GameResult
from uavaccel.suites.training.flights import CHECKPOINTS

LEARNED = ("games", "successes", "commands", "sim_time_s", "phase_s", "weights_sha256")
FLOWN = ("command", "clock_speed", "timing", "games", "successes")


def train_and_evaluate(config: RlConfig, cell: TrainingCase, run: RunDirectory) -> GameResult:
    """Train and evaluate; the row holds both in numbers, the arrays each evaluation lane's outcome."""
    trained = f"{cell.id}/training"
    learned = fly_part(run, trained, training_part(config, cell), cell.seed)
    training = part_folder(run, trained).resolve()
    # gigabytes that a finished training has no use for
    shutil.rmtree(training / CHECKPOINTS, ignore_errors=True)
    evaluations: list[dict[str, Any]] = []
    arrays: dict[str, NDArray[Any]] = {}
    for flight in flights(config, cell):
        part, flown = evaluation_part(config, cell, flight, training), f"{cell.id}/evaluation-{flight.name}"
        _drop_other_agents(part_folder(run, flown), part.keys["agent"])
        summary = fly_part(run, flown, part, EVALUATION_SEED)
        evaluations.append({key: summary[key] for key in FLOWN})
        arrays |= {f"{flight.name}_{name}": each for name, each in outcomes(part_run(run, flown)).items()}
    row = {
        "suite": "rl",
        "case": cell.id,
        **{name: getattr(cell, name) for name in ("variant", "profile", "command", "clock_speed", "seed")},
        "timing": cell.clock,
        "training": {name: learned[name] for name in LEARNED},
        "evaluations": evaluations,
    }
    return GameResult(row, arrays, {"training_s": wall_s(part_run(run, trained))})


def _drop_other_agents(place: Path, agent: str) -> None:
    """An evaluation begun before the run was moved names its policy by another path: it is flown anew."""
    if (place / "config.yaml").is_file() and RunDirectory(place).config().get("agent") != agent:
        shutil.rmtree(place)
