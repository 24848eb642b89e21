"""Models by name: stable-baselines3's algorithms, with their schedules on games and their phases measured."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Any

import stable_baselines3
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.type_aliases import TrainFreq

from uavaccel.clock import MonotonicClock
from uavaccel.envs.stopwatch import Stopwatch
from uavaccel.errors import UserError
from uavaccel.rl.config import LearnerConfig
from uavaccel.rl.double_dqn import DoubleDQN
from uavaccel.rl.lanes import Lanes
from uavaccel.rl.network import LaneFeatures

ALGORITHMS = "double_dqn, dqn, ppo, a2c"

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

    What learns from a buffer learns while lanes are flown: `train` notes the gradient steps, `learn_a_part` makes them.
    """

    batch_size: int
    games_done: int
    games_total: int
    owed = 0  # gradient steps
    parts: deque[Callable[[], None]]  # of them, that are left
    stopwatch: Stopwatch
    train_freq: TrainFreq

    def _update_current_progress_remaining(self, num_timesteps: int, total_timesteps: int) -> None:
        self._current_progress_remaining = 1.0 - self.games_done / self.games_total

    def train(self, gradient_steps: int | None = None, batch_size: int = 0) -> None:
        if gradient_steps is None:
            with self.stopwatch.phase("learning"):
                super().train()  # type: ignore[misc]
        else:
            self.owed += gradient_steps

    def learn_a_part(self) -> None:
        """While a command is flown: an equal part of what is owed, so that all is done before `train` asks for more."""
        if self.owed and not self.parts:
            self.parts.extend(self._parts_of(self.owed))
            self._flights_left = self.train_freq.frequency
        if not self.parts:
            return
        with self.stopwatch.phase("learning"):
            for _ in range(math.ceil(len(self.parts) / self._flights_left)):
                self.parts.popleft()()
        self._flights_left -= 1
        if not self.parts:
            self.owed = 0

    def _parts_of(self, gradient_steps: int) -> list[Callable[[], None]]:
        if hasattr(self, "gradient_parts"):
            parts: list[Callable[[], None]] = self.gradient_parts(gradient_steps, self.batch_size)
            return parts
        return [partial(super().train, gradient_steps, self.batch_size)]  # type: ignore[misc]

    def _sample_action(self, *args: Any, **kwargs: Any) -> Any:
        with self.stopwatch.phase("inference"):
            return super()._sample_action(*args, **kwargs)  # type: ignore[misc]


def algorithm_class(name: str) -> type[BaseAlgorithm]:
    """DoubleDQN, or a class of stable-baselines3. Raises UserError if there is none for discrete actions."""
    if name == "double_dqn":
        return DoubleDQN
    found = getattr(stable_baselines3, name.upper(), None)
    if not (isinstance(found, type) and issubclass(found, BaseAlgorithm)):
        raise UserError(f"algorithm = {name!r} is unknown; there are {ALGORITHMS}")
    if name.lower() not in ALGORITHMS.split(", "):
        raise UserError(
            f"algorithm = {name!r}: wants continuous actions, the lane's are discrete: {ALGORITHMS}"
        )
    return found


def make_model(config: LearnerConfig, environment: Lanes) -> BaseAlgorithm:
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
    model.stopwatch, model.parts = Stopwatch(MonotonicClock()), deque()  # type: ignore[attr-defined]
    environment.meanwhile = model.learn_a_part  # type: ignore[attr-defined]
    return model


def _falling(start: float, final_share: float, progress_remaining: float) -> float:
    return start * (final_share + (1.0 - final_share) * progress_remaining)


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
    if config.algorithm == "double_dqn":
        keywords["optimizer_kwargs"] = {"fused": True}
    return keywords


def learning_rhythm(commands_per_gradient_step: int, environments: int) -> tuple[int, int]:
    """Steps of all environments between two learnings, and gradient steps of each: the exact ratio."""
    divisor = math.gcd(commands_per_gradient_step, environments)
    return commands_per_gradient_step // divisor, environments // divisor


def _keywords(config: LearnerConfig, base: type[BaseAlgorithm]) -> dict[str, Any]:
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
