"""Networks and policies by algorithm: this project's own Double DQN, and stable-baselines3's as baselines."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from inspect import unwrap
from typing import Any

import numpy as np
import stable_baselines3
import torch as th
from numpy.typing import NDArray
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.policies import ActorCriticPolicy, BasePolicy
from stable_baselines3.common.type_aliases import Schedule
from stable_baselines3.dqn.policies import DQNPolicy

from uavaccel.envs.values import Frame
from uavaccel.errors import UserError
from uavaccel.rl.config import ALGORITHMS, OWN, LearnerConfig
from uavaccel.rl.network import LaneFeatures, rated_both_ways


def baseline_class(name: str) -> type[BaseAlgorithm]:
    """Return the class of a stable-baselines3 algorithm. Raises UserError unless it takes discrete actions."""
    found = getattr(stable_baselines3, name.upper(), None)
    if not (isinstance(found, type) and issubclass(found, BaseAlgorithm)):
        raise UserError(f"algorithm = {name!r} is unknown; there are {ALGORITHMS}")
    if name.lower() not in ALGORITHMS.split(", "):
        raise UserError(f"algorithm = {name!r}: wants continuous actions, the lane's are discrete: {ALGORITHMS}")
    return found


def policy_name(config: LearnerConfig) -> str:
    """Return the name of the stable-baselines3 policy that fits the observations."""
    return "MlpPolicy" if config.task.observation == "state" else "CnnPolicy"


def policy_keywords(config: LearnerConfig) -> dict[str, object]:
    """Return the keywords that make stable-baselines3's policy the configured network."""
    keywords: dict[str, object] = {"net_arch": list(config.hidden)}
    if config.task.observation != "state":
        keywords |= {
            "normalize_images": False,  # the network reads grey levels
            "features_extractor_class": LaneFeatures,
            "features_extractor_kwargs": {"channels": list(config.channels)},
        }
    if config.algorithm == OWN:
        # On a GPU the step is recorded as a graph, with the optimizer in it.
        keywords["optimizer_class"] = Adam
        keywords["optimizer_kwargs"] = {"fused": True, "capturable": config.device.startswith("cuda")}
    return keywords


class Adam(th.optim.Adam):
    """PyTorch's Adam without the wrappers that load its compiler at their first call, which takes 1.4 s.

    They only keep a method out of compiled graphs, which are not used here, and leave it as `__wrapped__`.
    """

    add_param_group = unwrap(th.optim.Optimizer.add_param_group)
    zero_grad = unwrap(th.optim.Optimizer.zero_grad)
    state_dict = unwrap(th.optim.Optimizer.state_dict)
    load_state_dict = unwrap(th.optim.Optimizer.load_state_dict)
    step = th.no_grad()(unwrap(th.optim.Adam.step))


class NoOptimizer:
    """Stands for the optimizer of a policy that only flies: PyTorch's load its compiler, most of the start-up time."""

    def __init__(self, parameters: Iterable[th.nn.Parameter], **_: object) -> None: ...


def make_policy(config: LearnerConfig, learning_rate: Schedule, learns: bool = True) -> BasePolicy:
    """Make an untrained policy: the networks and, if it `learns`, their optimizer."""
    found = stable_baselines3.DQN if config.algorithm == OWN else baseline_class(config.algorithm)
    make: Callable[..., BasePolicy] = found.policy_aliases[policy_name(config)]
    space, actions = config.task.observation_space(), config.task.action_space()
    keywords = policy_keywords(config) | ({} if learns else {"optimizer_class": NoOptimizer})
    return make(space, actions, learning_rate, **keywords)


def greedy(policy: BasePolicy, observations: Frame, turned: Sequence[int] | None = None) -> NDArray[np.int64]:
    """Return the greedy actions (n,) for observations (n, ...); `turned` averages with the mirror's values."""
    if not isinstance(policy, DQNPolicy):
        return np.asarray(policy.predict(observations, deterministic=True)[0])
    with th.inference_mode():  # `predict` without its checks, which take longer than the network
        ratings = action_values(policy, th.from_numpy(observations).to(policy.device), turned)
        return np.asarray(ratings.argmax(dim=1).cpu())


def action_values(policy: DQNPolicy, seen: th.Tensor, turned: Sequence[int] | None) -> th.Tensor:
    """Return DQN's action values (n, actions), averaged with those of the mirror image if `turned` is given."""
    if turned is None:
        ratings: th.Tensor = policy.q_net(seen)
        return ratings
    return rated_both_ways(policy.q_net, seen, turned)


def action_ratings(
    policy: BasePolicy, observations: Frame, turned: Sequence[int] | None = None
) -> tuple[str, NDArray[np.float64]]:
    """Return what the numbers are, and (n, actions) of them: DQN's action values or other policies' probabilities."""
    seen = th.from_numpy(observations).to(policy.device)
    with th.inference_mode():
        if isinstance(policy, DQNPolicy):
            return "action values", action_values(policy, seen, turned).cpu().numpy().astype(np.float64)
        assert isinstance(policy, ActorCriticPolicy)
        chances: Any = policy.get_distribution(seen).distribution
        return "probabilities of the actions", chances.probs.cpu().numpy().astype(np.float64)
