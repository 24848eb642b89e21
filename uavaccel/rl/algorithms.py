"""Learners by name: Double DQN of this project's own, and stable-baselines3's algorithms as baselines."""

from __future__ import annotations

from typing import Any

import numpy as np
import stable_baselines3
import torch as th
from numpy.typing import NDArray
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.type_aliases import Schedule
from stable_baselines3.dqn.policies import DQNPolicy

from uavaccel.errors import UserError
from uavaccel.rl.config import LearnerConfig
from uavaccel.rl.network import LaneFeatures

OWN = "double_dqn"
ALGORITHMS = f"{OWN}, dqn, ppo, a2c"


def check_algorithm(config: LearnerConfig) -> None:
    """Raises UserError for an algorithm that there is not, or that has no use for the lane's actions."""
    if config.algorithm != OWN:
        baseline_class(config.algorithm)


def baseline_class(name: str) -> type[BaseAlgorithm]:
    """A class of stable-baselines3. Raises UserError if there is none for discrete actions."""
    found = getattr(stable_baselines3, name.upper(), None)
    if not (isinstance(found, type) and issubclass(found, BaseAlgorithm)):
        raise UserError(f"algorithm = {name!r} is unknown; there are {ALGORITHMS}")
    if name.lower() not in ALGORITHMS.split(", "):
        raise UserError(
            f"algorithm = {name!r}: wants continuous actions, the lane's are discrete: {ALGORITHMS}"
        )
    return found


def policy_name(config: LearnerConfig) -> str:
    """Which of stable-baselines3's policies sees the observations."""
    return "MlpPolicy" if config.task.observation == "state" else "CnnPolicy"


def policy_keywords(config: LearnerConfig) -> dict[str, Any]:
    """Network layout."""
    keywords: dict[str, Any] = {"net_arch": list(config.hidden)}
    if config.task.observation != "state":
        keywords |= {
            "normalize_images": False,  # the network reads grey levels
            "features_extractor_class": LaneFeatures,
            "features_extractor_kwargs": {"channels": list(config.channels)},
        }
    if config.algorithm == OWN:
        # On a GPU the step is recorded as a graph, with the optimizer in it.
        keywords["optimizer_kwargs"] = {"fused": True, "capturable": config.device.startswith("cuda")}
    return keywords


def make_policy(config: LearnerConfig, learning_rate: Schedule) -> BasePolicy:
    """The untrained policy: networks, and the optimizer of those that learn."""
    found = stable_baselines3.DQN if config.algorithm == OWN else baseline_class(config.algorithm)
    make: Any = found.policy_aliases[policy_name(config)]
    space, actions = config.task.observation_space(), config.task.action_space()
    policy: BasePolicy = make(space, actions, learning_rate, **policy_keywords(config))
    return policy


def greedy(policy: BasePolicy, observations: NDArray[Any]) -> NDArray[np.int64]:
    """The best actions (n,) for observations (n, ...)."""
    if not isinstance(policy, DQNPolicy):
        return np.asarray(policy.predict(observations, deterministic=True)[0])
    with (
        th.inference_mode()
    ):  # as `predict`, without its checks and switches, which take longer than the network
        ratings = policy.q_net(th.from_numpy(observations).to(policy.device))
        return np.asarray(ratings.argmax(dim=1).cpu())
