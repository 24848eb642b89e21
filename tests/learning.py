"""What the tests of the learning part share: a training small enough for a test."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from tests.running import run_into
from uavaccel.config import validate
from uavaccel.envs.batch import LanesHere
from uavaccel.rl import lanes
from uavaccel.rl.config import LearnerConfig
from uavaccel.suites import evaluate_lanes, trainer
from uavaccel.suites.evaluate import Evaluation
from uavaccel.suites.train import TrainConfig, Training

OPTIONS = {"learning_starts": 8, "batch_size": 8, "buffer_size": 300, "target_update_interval": 16}


def tiny_config(task: dict[str, Any] | None = None, **keys: Any) -> TrainConfig:
    """Four games of a dozen commands, and a network of a few hundred weights that learns after eight commands."""
    tiny = {"games": 4, "options": OPTIONS, "channels": [4, 4], "hidden": [16], "checkpoint_games": 2, **keys}
    return validate(TrainConfig, {**tiny, "task": {"max_commands": 12, **(task or {})}}, "test")


def train_into(out: Path, config: TrainConfig, resume: bool = False) -> dict[str, Any]:
    """Train; the summary."""
    return dict(run_into(out, Training(), config, resume))


def side_by_side(config: LearnerConfig, *_: Any) -> LanesHere:
    """As make_lanes, but in this process."""
    keywords: dict[str, Any] = {**config.task.model_dump(mode="json"), "report_host_times": True}
    return LanesHere(config.environment_class, config.environments, autoreset_mode="SameStep", **keywords)


def fly_here(put: Callable[[Any, str, Any], None] = setattr) -> None:
    """Trainings and evaluations fly in this process and nobody draws them: both take longer than a small one itself."""
    put(trainer, "make_lanes", side_by_side)
    put(evaluate_lanes, "EnvironmentBatch", LanesHere)
    put(lanes, "start_exact_lanes", lambda *_: None)
    put(Training, "page", lambda *_: iter(()))
    put(Evaluation, "page", lambda *_: iter(()))
