"""The exact simulator's lanes of a training, made without PyTorch: their processes load while this one imports it."""

from __future__ import annotations

from typing import Any

from uavaccel.envs.batch import EnvironmentBatch
from uavaccel.envs.obstacle_lane import LaneTask, ObstacleLane


def start_exact_lanes(task: LaneTask, count: int) -> EnvironmentBatch:
    """Start the processes of `count` lanes, and return while they load. Raises UserError as EnvironmentBatch does."""
    return EnvironmentBatch(ObstacleLane, count, autoreset_mode="SameStep", **training_keywords(task))


def training_keywords(task: LaneTask) -> dict[str, Any]:
    """Return the keywords of a training's environments: the task's, and infos that include host times."""
    return {**task.model_dump(mode="json"), "report_host_times": True}
