"""What learners share: finished games, charged time, schedules, and checkpoints.

A resumed training reaches the same weights as one that was never interrupted. A checkpoint has the learner, all random
generators and the running games as tensors, arrays and JSON, so that reading it runs no code. It is valid once its last
file, state.json, exists.
"""

from __future__ import annotations

import json
import math
import os
import shutil
import zipfile
import zlib
from abc import ABC, abstractmethod
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from pickle import UnpicklingError
from typing import Any

import numpy as np
import torch as th
from numpy.typing import NDArray

from uavaccel.clock import MonotonicClock
from uavaccel.envs.arrays import stacked_observations
from uavaccel.envs.batch import TurnBatch
from uavaccel.envs.stopwatch import Stopwatch
from uavaccel.envs.values import Info, State
from uavaccel.errors import UserError, naming
from uavaccel.files import Plain, open_bounded, parse_json, read_bounded, replacing
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


class Learner(ABC):
    """Flies lanes, a TurnBatch or those of a GPU, and learns from the games."""

    counters: tuple[str, ...] = ("games", "returns")
    """Attributes that a checkpoint keeps."""
    policy: Any
    """The policy, a module with all networks."""
    optimizer: th.optim.Optimizer
    exploration_rate: Any = None
    """Share of random actions; None if it explores differently."""
    at_rest: Any = True
    """Whether a checkpoint can be taken now."""
    holding = False
    """Set while a checkpoint is due: the learner then finishes what is in flight, until it is `at_rest`."""

    def __init__(self, config: LearnerConfig, lanes: Any) -> None:
        self.config, self.lanes, self.games = config, lanes, 0
        self.returns = [0.0] * config.environments
        """Rewards of the running games so far."""
        self.stopwatch = Stopwatch(MonotonicClock())

    @abstractmethod
    def begin(self) -> None:
        """Start the first games unless games are running; this counts as start-up, not as training time."""

    @abstractmethod
    def advance(self) -> list[Game]:
        """Fly and learn a little further; returns the games that ended meanwhile."""

    def get_state(self) -> LearnerState:
        """Return networks, optimizer, generator and counters."""
        networks = {"policy": self.policy.state_dict(), "optimizer": self.optimizer.state_dict()}
        kept = {name: getattr(self, name) for name in self.counters if hasattr(self, name)}
        return LearnerState({**networks, "torch": th.get_rng_state()}, {}, kept)

    def set_state(self, state: LearnerState, observations: Any) -> None:
        """Restore what `get_state` returned; `observations` (lanes, ...) are the lanes' present ones."""
        self.policy.load_state_dict(state.tensors["policy"])
        self.optimizer.load_state_dict(state.tensors["optimizer"])
        th.set_rng_state(state.tensors["torch"].cpu())
        for name in self.counters:
            if name in state.counters:
                setattr(self, name, state.counters[name])

    def finished(self, rewards: Any, over: Any, infos: Sequence[Info], lanes: Sequence[int]) -> list[Game]:
        """Add a step's rewards to the returns of `lanes`; returns the games that ended with it, by their last infos.

        Games beyond the configured number are not counted.
        """
        games: list[Game] = []
        for lane, reward, ends, info in zip(lanes, rewards.tolist(), over.tolist(), infos, strict=True):
            self.returns[lane] += reward
            if ends and self.games < self.config.games:
                ended = info.get("final_info", info)
                games.append(Game(self.games, lane, ended, self.returns[lane], self.exploration_rate))
                self.returns[lane] = 0.0
                self.games += 1
        return games

    def charge(self, duration_s: float, phase: str, which: NDArray[np.int64] | None = None) -> None:
        """In timing `virtual`, charge each of `which` lanes, by default all, for the agent's work."""
        if self.config.task.timing == "virtual" and duration_s:
            slots = list(range(self.lanes.num_envs)) if which is None else which.tolist()
            self.lanes.call_each("charge", [(duration_s, phase)] * len(slots), slots)


def learning_rhythm(commands_per_gradient_step: int, lanes: int) -> tuple[int, int]:
    """Return every how many steps of all lanes to learn, and the gradient steps to take then: the exact ratio."""
    divisor = math.gcd(commands_per_gradient_step, lanes)
    return commands_per_gradient_step // divisor, lanes // divisor


def falling(start: float, final_share: float, remaining: float) -> float:
    """Fall linearly from `start` to `final_share` of it as `remaining` goes from 1 to 0."""
    return start * (final_share + (1.0 - final_share) * remaining)


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
        from uavaccel.rl.ppo import PPOTraining

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


_COMPLETE = "state.json"
MOST_BYTES = 1 << 40  # of a replay buffer
DAMAGE = (
    *(OSError, EOFError, ValueError, KeyError, zipfile.BadZipFile, zlib.error, UnpicklingError),
    *(AttributeError, IndexError, RuntimeError, TypeError),
)
"""Exceptions that reading damaged files of tensors, arrays and JSON raises."""


def save_checkpoint(folder: Path, learner: Learner) -> None:
    """Save the states of the learner and of its games; older checkpoints are removed."""
    checkpoint, state = folder / f"{learner.games:07d}", learner.get_state()
    shutil.rmtree(checkpoint, ignore_errors=True)
    checkpoint.mkdir(parents=True)
    path = checkpoint / "learner.pt"
    with naming(path), path.open("wb") as file:  # to a name torch would write with errors of its own
        cuda_states = th.cuda.get_rng_state_all() if th.cuda.is_available() else []
        th.save({**state.tensors, "cuda": cuda_states}, file)
    for name, arrays in (("buffer.npz", state.arrays), ("games.npz", _columns(_states(learner.lanes)))):
        with naming(checkpoint / name), (checkpoint / name).open("wb") as file:
            np.savez(file, **arrays)
    with replacing(checkpoint / _COMPLETE) as file:
        file.write(json.dumps({"games": learner.games, "counters": state.counters}).encode())
    for older in folder.iterdir():
        if older != checkpoint:
            shutil.rmtree(older)


def find_checkpoint(folder: Path) -> Path | None:
    """Return the newest complete checkpoint in `folder`; None without one."""
    return max((state.parent for state in folder.glob(f"*/{_COMPLETE}")), default=None)


def games_of(checkpoint: Path) -> int:
    """Return how many games had been completed when the checkpoint was taken. Raises UserError if it is damaged."""
    with _undamaged(checkpoint):
        return int(_plain(checkpoint)["games"])


def load_checkpoint(checkpoint: Path, learner: Learner) -> None:
    """Restore learner, games and all generators. Raises UserError if it is damaged or has another number of lanes."""
    with _undamaged(checkpoint):
        plain, games = _plain(checkpoint), _rows(_read_arrays(checkpoint / "games.npz"))
        if learner.lanes.num_envs != len(games):
            raise UserError(f"the checkpoint has {len(games)} environments; go on with as many")
        observations = _restore(learner.lanes, games)
        with open_bounded(checkpoint / "learner.pt", MOST_BYTES) as file:
            tensors = th.load(file, weights_only=True, map_location="cpu")
        arrays = _read_arrays(checkpoint / "buffer.npz")
        learner.set_state(LearnerState(tensors, arrays, plain["counters"]), observations)
        for device, tensor in enumerate(tensors["cuda"]):
            th.cuda.set_rng_state(tensor.cpu(), device)


@contextmanager
def _undamaged(checkpoint: Path) -> Iterator[None]:
    """Turn errors of reading wrong contents into one line that says how to go on."""
    try:
        yield
    except UserError:
        raise
    except DAMAGE as error:
        older = [path.parent for path in checkpoint.parent.glob(f"*/{_COMPLETE}") if path.parent < checkpoint]
        then = f"go on from {max(older).name}" if older else "begin the training anew"
        raise UserError(
            f"{checkpoint}: a damaged checkpoint ({type(error).__name__}); delete it and --resume to {then}"
        ) from error


def _plain(checkpoint: Path) -> dict[str, Any]:
    plain: dict[str, Any] = parse_json(read_bounded(checkpoint / _COMPLETE).decode("utf-8"))
    return plain


def _read_arrays(path: Path) -> dict[str, NDArray[np.generic]]:
    with open_bounded(path, MOST_BYTES) as file, np.load(file, allow_pickle=False) as arrays:
        return dict(arrays)


def _states(lanes: Any) -> list[State]:
    states: list[State] = (
        lanes.call_each("get_state", [()] * lanes.num_envs) if isinstance(lanes, TurnBatch) else lanes.get_states()
    )
    return states


def _restore(lanes: Any, states: Sequence[State]) -> Any:
    """Restore the states of all lanes, and return their observations."""
    if isinstance(lanes, TurnBatch):
        return stacked_observations(lanes.call_each("set_state", [(state,) for state in states]))
    return lanes.set_states(states)


def _columns(states: Sequence[State]) -> dict[str, NDArray[Any]]:
    """Return states as few arrays: those of one shape stacked, as "all:" and their key, others each under its lane."""
    columns: dict[str, NDArray[Any]] = {}
    for key in dict.fromkeys(key for state in states for key in state):
        parts = {lane: np.asarray(state[key]) for lane, state in enumerate(states) if key in state}
        if len(parts) == len(states) and len({part.shape for part in parts.values()}) == 1:
            columns[f"all:{key}"] = np.stack(list(parts.values()))
        else:
            columns |= {f"{lane}:{key}": part for lane, part in parts.items()}
    return columns


def _rows(columns: Mapping[str, NDArray[Any]]) -> list[State]:
    """Return the states of `_columns`."""
    rows: dict[int, State] = defaultdict(dict)
    for name, column in columns.items():
        lane, _, key = name.partition(":")
        for row, part in enumerate(column) if lane == "all" else [(int(lane), column)]:
            rows[row][key] = part
    return [rows[lane] for lane in sorted(rows)]
