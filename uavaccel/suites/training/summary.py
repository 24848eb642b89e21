"""A training in numbers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from uavaccel.envs.stopwatch import PHASES
from uavaccel.metrics.intervals import Proportion
from uavaccel.suites.disturbed import disturbed_games
from uavaccel.suites.report import Values
from uavaccel.suites.training.config import TrainConfig
from uavaccel.suites.training.evaluations import EvaluationLine
from uavaccel.suites.training.rows import TrainRow


def summarise(config: TrainConfig, rows: Sequence[TrainRow], weights_sha256: str | None) -> Values:
    """The sums over all games, and the hash of what came out."""
    task = config.task
    disturbed = disturbed_games(rows)
    return {
        **({"disturbed_games": disturbed} if disturbed else {}),
        "suite": "train",
        "profile": task.profile,
        "command": task.command,
        "clock_speed": task.clock_speed,
        "timing": task.timing,
        "seed": config.seed,
        "games": len(rows),
        "successes": sum(row["is_success"] for row in rows),
        "commands": sum(row["commands"] for row in rows),
        "sim_time_s": sum(row["sim_time_s"] for row in rows),
        "phase_s": {phase: sum(row["phase_s"][phase] for row in rows) for phase in PHASES},
        "weights_sha256": weights_sha256,
    }


def summarise_evaluations(lines: Sequence[EvaluationLine]) -> list[Values]:
    """Of each line of evaluations.jsonl: success with its 95 % Wilson interval, and how far the policy got."""
    return [
        {
            **Proportion(line["successes"], len(line["lanes"])).as_summary(),
            "games": line["games"],
            "lanes": len(line["lanes"]),
            "distance_m_median": float(np.median(line["distance_m"])),
        }
        for line in lines
    ]
