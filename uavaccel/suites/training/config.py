"""Configuration of a training."""

from __future__ import annotations

from typing import Literal

from uavaccel.rl.config import LearnerConfig
from uavaccel.suites.experiment import Experiment


class TrainConfig(LearnerConfig, Experiment):
    """Keys of experiments/train.yaml."""

    suite: Literal["train"] = "train"
