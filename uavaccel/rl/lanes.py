"""Lanes for a learner: flown in processes of their own, while it learns; in `wall` one lane in this process."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecEnv, VecEnvWrapper
from stable_baselines3.common.vec_env.base_vec_env import VecEnvObs, VecEnvStepReturn

from uavaccel.envs.obstacle_lane import LaneTask, ObstacleLane


class Lanes(VecEnvWrapper):
    """Lanes side by side. `meanwhile` is called once per step, after the actions went out, while the lanes fly."""

    def __init__(self, lanes: VecEnv) -> None:
        super().__init__(lanes)
        self.meanwhile: Callable[[], None] = _nothing

    def reset(self) -> VecEnvObs:
        return self.venv.reset()

    def step_wait(self) -> VecEnvStepReturn:
        self.meanwhile()
        return self.venv.step_wait()


def make_lanes(task: LaneTask, count: int) -> Lanes:
    """`count` environments of a task, whose infos have host times. Spawned: what renders must not be forked.

    In `wall` the one lane is flown in this process, so that nothing learns beside it and disturbs its clock.
    """
    keywords = {**task.model_dump(mode="json"), "report_host_times": True}
    if task.timing == "wall":
        return Lanes(DummyVecEnv([partial(_make_lane, keywords)]))
    return Lanes(SubprocVecEnv([partial(_make_lane_alone, keywords)] * count, start_method="spawn"))


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


def _nothing() -> None:
    pass
