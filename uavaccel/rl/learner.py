"""The interface of learners, and what they share: finished games, charged time, schedules and saved states."""

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
from uavaccel.rl.config import OWN, LearnerConfig
from uavaccel.rl.lanes import AnyLanes, Lanes


@dataclass(frozen=True)
class Game:
    """A finished game: its number, the lane that flew it, its last info, and its return, the sum of its rewards.

    `loss` and `mean_q` are means over the gradient steps since games ended before; see `StepStatistics`.
    """

    number: int
    lane: int
    info: Info
    reward: float
    exploration_rate: float | None
    loss: float | None = None
    mean_q: float | None = None


@dataclass(frozen=True)
class LearnerState:
    """A learner's saved state: state dicts of tensors, arrays, and plain values for JSON."""

    tensors: dict[str, Any]
    arrays: dict[str, NDArray[np.generic]]
    counters: dict[str, Plain]


class Learner(Protocol):
    """Flies lanes and learns from the games."""

    config: LearnerConfig
    games: int
    returns: list[float]
    stopwatch: Stopwatch
    holding: bool
    """Set while a checkpoint is due: the learner then finishes what is in flight, until it is `at_rest`."""

    @property
    def lanes(self) -> AnyLanes:
        """The environments."""
        ...

    @property
    def policy(self) -> BasePolicy:
        """The policy, with networks and optimizer."""
        ...

    @property
    def exploration_rate(self) -> float | None:
        """Share of random actions; None if it explores differently."""
        ...

    @property
    def at_rest(self) -> bool:
        """Whether a checkpoint can be taken now."""
        ...

    def begin(self) -> None:
        """Start the first games unless games are running; this counts as start-up, not as training time."""
        ...

    def advance(self) -> list[Game]:
        """Fly and learn a little further; returns the games that ended meanwhile."""
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
    """Add a step's rewards to the returns of `lanes`, by default all; returns the games that ended with it.

    Games beyond the configured number are not counted.
    """
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
    """Return every how many steps of all lanes to learn, and the gradient steps to take then: the exact ratio."""
    divisor = math.gcd(commands_per_gradient_step, lanes)
    return commands_per_gradient_step // divisor, lanes // divisor


def falling(start: float, final_share: float, remaining: float) -> float:
    """Fall linearly from `start` to `final_share` of it as `remaining` goes from 1 to 0."""
    return start * (final_share + (1.0 - final_share) * remaining)


def charge_inference(lanes: Lanes, config: LearnerConfig, which: Iterable[int] | None = None) -> None:
    """In timing `virtual`, charge each of `which` lanes, by default all, for its decision."""
    if config.task.timing == "virtual":
        lanes.env_method("charge", config.inference_s, "inference", indices=which)


def charge_learning(
    lanes: Lanes, config: LearnerConfig, gradient_steps: int, which: Iterable[int] | None = None
) -> None:
    """In timing `virtual`, charge each of `which` lanes, by default all, for its share of the gradient steps."""
    if config.task.timing == "virtual" and gradient_steps:
        share_s = gradient_steps / lanes.num_envs * config.learning_s
        lanes.env_method("charge", share_s, "learning", indices=which)


def plain_generator(random: np.random.RandomState) -> list[Plain]:
    """Return a generator's state as plain values for JSON."""
    name, words, *rest = random.get_state(legacy=True)
    return [name, np.asarray(words).tolist(), *rest]


def set_generator(random: np.random.RandomState, state: list[Plain]) -> None:
    """Restore a state that `plain_generator` returned."""
    random.set_state((state[0], np.array(state[1], np.uint32), *state[2:]))


def make_learner(config: LearnerConfig, lanes: AnyLanes) -> Learner:
    """Make the untrained learner that a configuration asks for. Raises UserError for options that it rejects."""
    if config.on_device:
        from uavaccel.rl.device_dqn import DeviceDQN  # needs numba-cuda and a GPU

        return DeviceDQN(config, lanes)
    if config.algorithm == OWN:
        from uavaccel.rl.double_dqn import DoubleDQN

        return DoubleDQN(config, lanes)
    from uavaccel.rl.baseline import Baseline

    return Baseline(config, lanes)
