"""The interface of learners, and what they share: finished games, charged time, schedules and saved states."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import torch as th
from numpy.typing import NDArray

from uavaccel.envs.batch import TurnBatch
from uavaccel.envs.stopwatch import Stopwatch
from uavaccel.envs.values import Info
from uavaccel.files import Plain
from uavaccel.rl.config import DOUBLE_DQN, PPO, LearnerConfig, check_options


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
    """Rewards of the running games so far."""
    stopwatch: Stopwatch
    holding: bool
    """Set while a checkpoint is due: the learner then finishes what is in flight, until it is `at_rest`."""

    @property
    def lanes(self) -> Any:
        """The environments: a TurnBatch, or lanes on a GPU."""
        ...

    @property
    def policy(self) -> th.nn.Module:
        """The policy, with all networks."""
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

    def set_state(self, state: LearnerState, observations: Any) -> None:
        """Restore what `get_state` returned; `observations` (lanes, ...) are the lanes' present ones."""
        ...


def finished_games(
    learner: Learner, rewards: Sequence[float], dones: Sequence[bool], infos: Sequence[Info], lanes: Sequence[int]
) -> list[Game]:
    """Add a step's rewards to the returns of `lanes`; returns the games that ended with it, by their last infos.

    Games beyond the configured number are not counted.
    """
    games: list[Game] = []
    for lane, reward, done, info in zip(lanes, rewards, dones, infos, strict=True):
        learner.returns[lane] += float(reward)
        if done and learner.games < learner.config.games:
            ended = info.get("final_info", info)
            games.append(Game(learner.games, lane, ended, learner.returns[lane], learner.exploration_rate))
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


def charge(
    lanes: TurnBatch, config: LearnerConfig, duration_s: float, phase: str, which: NDArray[np.int64] | None = None
) -> None:
    """In timing `virtual`, charge each of `which` lanes, by default all, for the agent's work."""
    if config.task.timing == "virtual" and duration_s:
        slots = list(range(lanes.num_envs)) if which is None else which.tolist()
        lanes.call_each("charge", [(duration_s, phase)] * len(slots), slots)


def compute_the_same_each_time() -> None:
    """Let a GPU compute the same bits each time. Call it before CUDA's first use."""
    os.environ.setdefault("CUBLAS_WORKSPACE_CONFIG", ":4096:8")  # cuBLAS is not deterministic without it
    th.use_deterministic_algorithms(True)
    th.utils.deterministic.fill_uninitialized_memory = False  # type: ignore[attr-defined]
    th.backends.cudnn.deterministic, th.backends.cudnn.benchmark = True, False


def first_seed(seed: int) -> int:
    """Return the seed of a training's first lane; a hash keeps the consecutive seeds of different trainings apart."""
    return int(np.random.SeedSequence([seed, 1]).generate_state(1)[0]) >> 1


def plain_generator(random: np.random.RandomState) -> list[Plain]:
    """Return a generator's state as plain values for JSON."""
    name, words, *rest = random.get_state(legacy=True)
    return [name, np.asarray(words).tolist(), *rest]


def set_generator(random: np.random.RandomState, state: list[Plain]) -> None:
    """Restore a state that `plain_generator` returned."""
    random.set_state((state[0], np.array(state[1], np.uint32), *state[2:]))


def make_learner(config: LearnerConfig, lanes: Any) -> Learner:
    """Make the untrained learner that a configuration asks for. Raises UserError for options that it rejects."""
    if config.algorithm == DOUBLE_DQN:
        from uavaccel.rl.double_dqn import DeviceDQN, HostDQN

        return DeviceDQN(config, lanes) if config.on_device else HostDQN(config, lanes)
    if config.algorithm == PPO:
        from uavaccel.rl.ppo_training import PPOTraining

        return PPOTraining(config, lanes)
    check_options(config)
    from uavaccel.rl.baseline import Baseline  # needs stable-baselines3

    return Baseline(config, lanes)


class StepStatistics:
    """Means over the gradient steps between two reads: `loss`, and `mean_q`, the online network's value of the
    actions in the batches. None before the first step, and where a mean is not finite.
    """

    def __init__(self, device: th.device) -> None:
        self.sums = th.zeros(3, dtype=th.float64, device=device)  # of losses, of mean Qs, of steps
        self._read = [0.0, 0.0, 0.0]  # what the sums were at the last read
        self.loss: float | None = None
        self.mean_q: float | None = None

    def add(self, loss: th.Tensor, chosen_q: th.Tensor) -> None:
        """Add a gradient step by its loss and the Qs (n,) of its batch's actions, without waiting for the device."""
        loss_sum, q_sum, steps = self.sums
        loss_sum.add_(loss.detach())
        q_sum.add_(chosen_q.detach().mean())
        steps.add_(1.0)

    def read(self, sums: th.Tensor) -> None:
        """Take the means of the steps since the last read from `sums`, by now perhaps copied to the host."""
        now: list[float] = sums.tolist()
        loss, q, steps = (after - before for after, before in zip(now, self._read, strict=True))
        if steps:
            self.loss, self.mean_q = (total / steps if math.isfinite(total) else None for total in (loss, q))
            self._read = now

    def get_state(self) -> dict[str, Plain]:
        """Return sums and means as plain values for JSON."""
        return {"sums": self.sums.tolist(), "read": self._read, "loss": self.loss, "mean_q": self.mean_q}

    def set_state(self, state: dict[str, Any]) -> None:
        """Restore what `get_state` returned."""
        self.sums.copy_(th.tensor(state["sums"], dtype=th.float64))
        self._read, self.loss, self.mean_q = state["read"], state["loss"], state["mean_q"]
