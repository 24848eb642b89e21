"""What every learner is to a training, and what they share: finished games, modelled time, schedules, saved states."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.policies import BasePolicy

from uavaccel.envs.stopwatch import Stopwatch
from uavaccel.envs.values import Frame, Info
from uavaccel.files import Plain
from uavaccel.rl.config import LearnerConfig
from uavaccel.rl.lanes import AnyLanes, Lanes


@dataclass(frozen=True)
class Game:
    """A finished game: its number, in which lane of those flown side by side, the last info, the sum of rewards."""

    number: int
    lane: int
    info: Info
    reward: float
    exploration_rate: float | None


@dataclass(frozen=True)
class LearnerState:
    """All that a learner knows: state dicts of tensors, arrays, and plain values for JSON."""

    tensors: dict[str, Any]
    arrays: dict[str, NDArray[np.generic]]
    counters: dict[str, Plain]


class Learner(Protocol):
    """Flies lanes and learns from them."""

    config: LearnerConfig
    games: int
    returns: list[float]
    stopwatch: Stopwatch
    holding: bool
    """Whether it is to come to rest soon, for a checkpoint."""

    @property
    def lanes(self) -> AnyLanes:
        """What it flies."""
        ...

    @property
    def policy(self) -> BasePolicy:
        """Networks and optimizer."""
        ...

    @property
    def exploration_rate(self) -> float | None:
        """Share of random actions; None where it explores otherwise."""
        ...

    @property
    def at_rest(self) -> bool:
        """Whether a checkpoint can be taken now."""
        ...

    def begin(self) -> None:
        """Begin the first games, unless games are under way: part of the start-up, which no pace counts."""
        ...

    def advance(self) -> list[Game]:
        """Fly on, learn on; the games that ended meanwhile."""
        ...

    def get_state(self) -> LearnerState: ...

    def set_state(self, state: LearnerState, observations: Frame) -> None: ...


def finished_games(
    learner: Learner,
    rewards: Sequence[float],
    dones: Sequence[bool],
    infos: Sequence[Info],
    lanes: Sequence[int] | None = None,
) -> list[Game]:
    """Count the rewards of a step of some lanes (all); the games that ended with it, up to as many as are wanted."""
    games: list[Game] = []
    flown = range(learner.lanes.num_envs) if lanes is None else lanes
    for lane, reward, done, info in zip(flown, rewards, dones, infos, strict=True):
        learner.returns[lane] += float(reward)
        if done and learner.games < learner.config.games:
            games.append(Game(learner.games, lane, info, learner.returns[lane], learner.exploration_rate))
            learner.returns[lane] = 0.0
            learner.games += 1
    return games


def learning_rhythm(commands_per_gradient_step: int, lanes: int) -> tuple[int, int]:
    """Steps of all lanes between two learnings, and gradient steps of each: the exact ratio."""
    divisor = math.gcd(commands_per_gradient_step, lanes)
    return commands_per_gradient_step // divisor, lanes // divisor


def falling(start: float, final_share: float, remaining: float) -> float:
    """Linearly from `start` to its `final_share` as `remaining` goes from 1 to 0."""
    return start * (final_share + (1.0 - final_share) * remaining)


def charge_inference(lanes: Lanes, config: LearnerConfig, which: Iterable[int] | None = None) -> None:
    """In `virtual` each lane pays for its decision; `which` of them, all by default."""
    if config.task.timing == "virtual":
        lanes.env_method("charge", config.inference_s, "inference", indices=which)


def charge_learning(
    lanes: Lanes, config: LearnerConfig, gradient_steps: int, which: Iterable[int] | None = None
) -> None:
    """In `virtual` each lane pays for the gradient steps that its own commands bring about."""
    if config.task.timing == "virtual" and gradient_steps:
        share_s = gradient_steps / lanes.num_envs * config.learning_s
        lanes.env_method("charge", share_s, "learning", indices=which)


def plain_generator(random: np.random.RandomState) -> list[Plain]:
    """A generator's state, for JSON."""
    name, words, *rest = random.get_state(legacy=True)
    return [name, np.asarray(words).tolist(), *rest]


def set_generator(random: np.random.RandomState, state: list[Plain]) -> None:
    """Put a state of `plain_generator` back."""
    random.set_state((state[0], np.array(state[1], np.uint32), *state[2:]))
