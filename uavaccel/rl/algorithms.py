"""Models by name: stable-baselines3's algorithms, with their schedules on games and their phases measured."""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import stable_baselines3
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

from uavaccel.clock import MonotonicClock
from uavaccel.envs.stopwatch import Stopwatch
from uavaccel.errors import UserError
from uavaccel.rl.config import TrainConfig
from uavaccel.rl.double_dqn import DoubleDQN
from uavaccel.rl.lanes import Lanes
from uavaccel.rl.network import LaneFeatures

DOUBLE_DQN_DEFAULTS: dict[str, Any] = {
    "learning_rate": 3e-4,
    "buffer_size": 150_000,
    "learning_starts": 2_000,
    "batch_size": 32,
    "gamma": 0.95,
    "n_steps": 3,
    "target_update_interval": 2_000,
    "exploration_fraction": 0.3,
    "exploration_final_eps": 0.01,
    "max_grad_norm": 10.0,
}


class ByGames:
    """Mixed into an algorithm: exploration and learning rate follow the share of games flown, not of timesteps.

    What learns from a buffer learns while the next command is flown: `train` notes the steps, `learn_owed` makes them.
    """

    games_done: int
    games_total: int
    owed = 0  # gradient steps
    stopwatch: Stopwatch
    batch_size: int

    def _update_current_progress_remaining(self, num_timesteps: int, total_timesteps: int) -> None:
        self._current_progress_remaining = 1.0 - self.games_done / self.games_total

    def train(self, gradient_steps: int | None = None, batch_size: int = 0) -> None:
        if gradient_steps is None:
            self._learn()
        else:
            self.owed += gradient_steps

    def learn_owed(self) -> None:
        """The gradient steps that `train` was asked for."""
        if self.owed:
            self._learn(gradient_steps=self.owed, batch_size=self.batch_size)
            self.owed = 0

    def _learn(self, **keywords: int) -> None:
        self.stopwatch.switch("learning")
        super().train(**keywords)  # type: ignore[misc]
        self.stopwatch.switch(None)

    def _sample_action(self, *args: Any, **kwargs: Any) -> Any:
        self.stopwatch.switch("inference")
        actions = super()._sample_action(*args, **kwargs)  # type: ignore[misc]
        self.stopwatch.switch(None)
        return actions


def algorithm_class(name: str) -> type[BaseAlgorithm]:
    """DoubleDQN, or a class of stable-baselines3. Raises UserError if there is none of that name."""
    if name == "double_dqn":
        return DoubleDQN
    found = getattr(stable_baselines3, name.upper(), None)
    if not (isinstance(found, type) and issubclass(found, BaseAlgorithm)):
        raise UserError(f"algorithm = {name!r} is unknown; there are double_dqn, dqn, ppo, a2c")
    return found


def make_model(config: TrainConfig, environment: Lanes) -> BaseAlgorithm:
    """The untrained model. Raises UserError for options that its class does not know."""
    base = algorithm_class(config.algorithm)
    scheduled: Any = type(f"{base.__name__}ByGames", (ByGames, base), {})
    keywords = {"seed": config.seed, "device": config.device, **_keywords(config, base), **config.options}
    if (rate := keywords.get("learning_rate")) is not None:
        keywords["learning_rate"] = partial(_falling, float(rate), config.final_learning_rate_share)
    try:
        model: BaseAlgorithm = scheduled(
            policy_name(config), environment, policy_kwargs=policy_keywords(config), **keywords
        )
    except TypeError as error:
        raise UserError(f"options of {config.algorithm}: {error}") from error
    model.games_done, model.games_total = 0, config.games  # type: ignore[attr-defined]
    model.stopwatch = Stopwatch(MonotonicClock())  # type: ignore[attr-defined]
    environment.meanwhile = model.learn_owed  # type: ignore[attr-defined]
    return model


def _falling(start: float, final_share: float, progress_remaining: float) -> float:
    return start * (final_share + (1.0 - final_share) * progress_remaining)


def policy_name(config: TrainConfig) -> str:
    """Which of stable-baselines3's policies sees the observations."""
    return "MlpPolicy" if config.task.observation == "state" else "CnnPolicy"


def policy_keywords(config: TrainConfig) -> dict[str, Any]:
    """Network layout."""
    keywords: dict[str, Any] = {"net_arch": list(config.hidden)}
    if config.task.observation != "state":
        keywords |= {
            "normalize_images": False,  # the network reads grey levels
            "features_extractor_class": LaneFeatures,
            "features_extractor_kwargs": {"channels": list(config.channels)},
        }
    if config.algorithm == "double_dqn":
        keywords["optimizer_kwargs"] = {"fused": True}
    return keywords


def learning_rhythm(commands_per_gradient_step: int, environments: int) -> tuple[int, int]:
    """Steps of all environments between two learnings, and gradient steps of each: the exact ratio."""
    divisor = math.gcd(commands_per_gradient_step, environments)
    return commands_per_gradient_step // divisor, environments // divisor


def _keywords(config: TrainConfig, base: type[BaseAlgorithm]) -> dict[str, Any]:
    keywords: dict[str, Any] = {}
    if issubclass(base, OffPolicyAlgorithm):
        steps, gradient_steps = learning_rhythm(config.commands_per_gradient_step, config.environments)
        keywords |= {"train_freq": steps, "gradient_steps": gradient_steps}
    if base is DoubleDQN:
        keywords |= DOUBLE_DQN_DEFAULTS
        if config.mirror:
            headings = list(config.task.headings_deg)
            keywords["mirror"] = tuple(headings.index(-heading) for heading in headings)
    return keywords
