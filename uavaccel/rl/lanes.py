"""Lanes for a learner: flown in processes of their own, while it learns; in `wall` one lane in this process."""

from __future__ import annotations

import os
import signal
from functools import partial
from typing import Any

import numpy as np
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecEnv

from uavaccel.envs.obstacle_lane import LaneTask, ObstacleLane

Lanes = VecEnv  # what a learner flies: step_async, step_wait, env_method


def make_lanes(task: LaneTask, count: int) -> Lanes:
    """`count` environments of a task, whose infos have host times. Spawned: what renders must not be forked.

    In `wall` the one lane is flown in this process, so that nothing learns beside it and disturbs its clock.
    """
    keywords = {**task.model_dump(mode="json"), "report_host_times": True}
    if task.timing == "wall":
        return DummyVecEnv([partial(_make_lane, keywords)])
    return SubprocVecEnv([partial(_make_lane_alone, keywords)] * count, start_method="spawn")


def _make_lane(keywords: dict[str, Any]) -> Any:
    return ObstacleLane(**keywords)


def _make_lane_alone(keywords: dict[str, Any]) -> Any:
    """A lane in a process of its own, which leaves Ctrl-C to its parent and, drawing in software, the other cores."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.environ.setdefault("LP_NUM_THREADS", "0")
    return _make_lane(keywords)


def seed_lanes(environment: VecEnv, seed: int) -> None:
    """Seeds far apart for environments of different trainings: stable-baselines3 counts up by one from the first."""
    environment.seed(int(np.random.SeedSequence([seed, 1]).generate_state(1)[0]) >> 1)
