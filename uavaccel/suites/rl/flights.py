"""One cell from the first training game to the last evaluation lane; a cell that was stopped goes on where it was."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from uavaccel.records import RunDirectory
from uavaccel.suites.evaluation.outcomes import outcomes
from uavaccel.suites.parts import fly_part
from uavaccel.suites.rl.cells import EVALUATION_SEED, Cell, evaluation_part, flights, training_part
from uavaccel.suites.rl.config import RlConfig
from uavaccel.suites.suite import Flown
from uavaccel.suites.training.flights import CHECKPOINTS

LEARNED = ("games", "successes", "commands", "sim_time_s", "phase_s", "weights_sha256")
FLOWN = ("command", "clock_speed", "timing", "games", "successes")


def fly_cell(config: RlConfig, cell: Cell, run: RunDirectory) -> Flown:
    """Train and evaluate; the row holds both in numbers, the arrays each evaluation lane's outcome."""
    folder = run.path.resolve() / "parts" / cell.id
    manifest = {key: value for key, value in run.manifest().items() if key != "resumed"}
    training = folder / "training"
    learned = fly_part(training, training_part(config, cell), cell.seed, manifest)
    shutil.rmtree(
        training / CHECKPOINTS, ignore_errors=True
    )  # gigabytes that a finished training has no use for
    evaluations: list[dict[str, Any]] = []
    arrays: dict[str, NDArray[Any]] = {}
    for flight in flights(config, cell):
        part, place = evaluation_part(config, cell, flight, training), folder / f"evaluation-{flight.name}"
        _drop_other_agents(place, part.keys["agent"])
        summary = fly_part(place, part, EVALUATION_SEED, manifest)
        evaluations.append({key: summary[key] for key in FLOWN})
        arrays |= {f"{flight.name}_{name}": each for name, each in outcomes(RunDirectory(place)).items()}
    row = {
        "suite": "rl",
        "case": cell.id,
        **{name: getattr(cell, name) for name in ("variant", "profile", "command", "clock_speed", "seed")},
        "timing": cell.clock,
        "training": {name: learned[name] for name in LEARNED},
        "evaluations": evaluations,
    }
    return Flown(row, arrays, {"training_s": wall_s(RunDirectory(training).timings())})


def wall_s(timings: Sequence[Mapping[str, Any]]) -> float:
    """Wall seconds of a training on this machine; the readings begin anew whenever it was resumed."""
    readings = [float(entry["wall_s"]) for entry in timings]
    ends = [before for before, after in pairwise(readings) if after < before]
    return sum(ends) + (readings[-1] if readings else 0.0)


def _drop_other_agents(place: Path, agent: str) -> None:
    """An evaluation begun before the run was moved names its policy by another path: it is flown anew."""
    if (place / "config.yaml").is_file() and RunDirectory(place).config().get("agent") != agent:
        shutil.rmtree(place)
