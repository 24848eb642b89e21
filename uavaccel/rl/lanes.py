"""Environments side by side: one in this process, several in spawned processes of their own."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecEnv

from uavaccel.envs.obstacle_lane import ObstacleLane
from uavaccel.envs.task import LaneTask


def make_lanes(task: LaneTask, count: int) -> VecEnv:
    """`count` environments of a task, whose infos have host times. Spawned: what renders must not be forked."""
    keywords = {**task.model_dump(mode="json"), "report_host_times": True}
    makers: list[Callable[[], Any]] = [partial(_make_lane, keywords)] * count
    if count == 1:
        return DummyVecEnv(makers)
    return SubprocVecEnv(makers, start_method="spawn")


def _make_lane(keywords: dict[str, Any]) -> ObstacleLane:
    return ObstacleLane(**keywords)


def seed_lanes(environment: VecEnv, seed: int) -> None:
    """Seeds far apart for environments of different trainings: stable-baselines3 counts up by one from the first."""
    environment.seed(int(np.random.SeedSequence([seed, 1]).generate_state(1)[0]) >> 1)
