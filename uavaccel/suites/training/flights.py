"""Games of a training: a learner flies its lanes and learns, and hands out one finished game after another."""

from __future__ import annotations

import signal
import threading
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType
from typing import Any

import torch as th
from stable_baselines3.common.logger import configure

from uavaccel.envs.stopwatch import PHASES
from uavaccel.records import RunDirectory
from uavaccel.rl.algorithms import make_model
from uavaccel.rl.checkpoint import find_checkpoint, load_checkpoint, read_notes, save_checkpoint
from uavaccel.rl.lanes import make_lanes, seed_lanes
from uavaccel.rl.policy import export_policy, weights_sha256
from uavaccel.suites.suite import Flown
from uavaccel.suites.training.callback import TrainingCallback
from uavaccel.suites.training.config import TrainConfig

CHECKPOINTS = "checkpoints"


@dataclass(frozen=True)
class Case:
    """One game to learn from."""

    game: int
    timing: str
    typical_s: float

    @property
    def id(self) -> str:
        return f"game-{self.game:07d}"

    def simulated_s(self) -> float:
        return self.typical_s


def cases(config: TrainConfig) -> Iterator[Case]:
    """Games by number: which lane and environment each one is comes out of the training."""
    for game in range(config.games):
        yield Case(game, config.task.timing, config.task.typical_s)


class Trainer:
    """A learner and its lanes, which goes on from its last checkpoint to the weights that it would have had."""

    def __init__(self, config: TrainConfig, run: RunDirectory) -> None:
        th.set_num_threads(config.torch_threads)
        self._config, self._run = config, run
        self._interrupted = False
        self._finished: deque[Flown] = deque()
        self._environment = make_lanes(config.task, config.environments)
        try:
            self._prepare()
        except BaseException:
            self._environment.close()
            raise

    def _prepare(self) -> None:
        self._model = make_model(self._config, self._environment)
        seed_lanes(self._environment, self._config.seed)
        self._model.set_logger(configure(str(self._run.path / "tensorboard"), ["tensorboard"]))
        self._callback = TrainingCallback(self._config, self._finished.append, self._between_rollouts)
        checkpoint = find_checkpoint(self._run.path / CHECKPOINTS)
        self._begins_anew = checkpoint is None
        if checkpoint is not None:
            notes, random = load_checkpoint(checkpoint, self._model)
            self._callback.restore(notes["rows"], notes["returns"], random, self._run.rows())
        self._saved = self._callback.games

    def next_game(self) -> Flown:
        """Fly and learn until another game is over. Raises KeyboardInterrupt, after a checkpoint, on Ctrl-C."""
        while not self._finished:
            # One rollout, and what is learned after it; never more, so that rows are written as games end.
            self._model.learn(1, self._callback, log_interval=1, reset_num_timesteps=self._begins_anew)
            self._begins_anew = False
        game = self._finished.popleft()
        if self._callback.games == self._config.games and not self._finished:
            self._export(game.row["game"] + 1)
        return game

    def _export(self, games: int) -> None:
        export_policy(
            self._run.path,
            self._model,
            self._config,
            {"games": games, "weights_sha256": weights_sha256(self._model)},
        )

    def _between_rollouts(self) -> None:
        """Every game handed out has its row by now: the moment at which a checkpoint is consistent."""
        games = self._callback.games
        if self._interrupted or games - self._saved >= self._config.checkpoint_games:
            notes = {"rows": games, "returns": self._callback.returns}
            save_checkpoint(self._run.path / CHECKPOINTS, self._model, notes)
            self._export(games)
            self._saved = games
        if self._interrupted:
            raise KeyboardInterrupt

    def close(self) -> None:
        self._environment.close()

    def interrupt(self, number: int, frame: FrameType | None) -> None:
        """A first Ctrl-C is heeded between rollouts, once there is a checkpoint; a second one at once."""
        if self._interrupted:
            raise KeyboardInterrupt
        self._interrupted = True


@contextmanager
def open_trainer(config: TrainConfig, run: RunDirectory) -> Iterator[Trainer]:
    """A trainer that Ctrl-C asks for a checkpoint."""
    trainer = Trainer(config, run)
    in_main = threading.current_thread() is threading.main_thread()
    before = signal.signal(signal.SIGINT, trainer.interrupt) if in_main else None
    try:
        yield trainer
    finally:
        if in_main:
            signal.signal(signal.SIGINT, before)
        trainer.close()


def drop_games_after_checkpoint(run: RunDirectory) -> None:
    """Forget the rows that the last checkpoint does not know: a training goes on from there, and flies them again."""
    checkpoint = find_checkpoint(run.path / CHECKPOINTS)
    run.keep_first(0 if checkpoint is None else read_notes(checkpoint)["rows"])


def spent_by_phase(rows: list[dict[str, Any]]) -> dict[str, float]:
    """Seconds of the games' own wall clocks, by phase."""
    return {phase: sum(row["phase_s"][phase] for row in rows) for phase in PHASES}
