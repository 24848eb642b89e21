"""What the tests of the learning part share: whether there is OpenGL, and a training small enough for a test."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tests.running import run_into
from uavaccel.config import validate
from uavaccel.suites.report import Summary
from uavaccel.suites.training.config import TrainConfig
from uavaccel.suites.training.suite import Training

OPTIONS = {"learning_starts": 8, "batch_size": 8, "buffer_size": 300, "target_update_interval": 16}


def tiny_config(task: dict[str, Any] | None = None, **keys: Any) -> TrainConfig:
    """Four games of a dozen commands, and a network of a few hundred weights that learns after eight commands."""
    tiny = {"games": 4, "options": OPTIONS, "channels": [4, 4], "hidden": [16], "checkpoint_games": 2, **keys}
    return validate(TrainConfig, {**tiny, "task": {"max_commands": 12, **(task or {})}}, "test")


def train_into(out: Path, config: TrainConfig, resume: bool = False) -> Summary:
    """Train; the summary."""
    return run_into(out, Training(), config, resume)
