"""The trainer: a learner flies its lanes, learns, saves checkpoints, and returns one finished game after another."""

from __future__ import annotations

import signal
import threading
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from types import FrameType

import torch as th

from uavaccel.envs.batch import EnvironmentBatch
from uavaccel.errors import UserError
from uavaccel.records import RunDirectory
from uavaccel.rl.checkpoint import find_checkpoint, games_of, load_checkpoint, save_checkpoint
from uavaccel.rl.lanes import make_lanes, seed_lanes
from uavaccel.rl.learner import make_learner
from uavaccel.rl.policy import export_policy, weights_sha256
from uavaccel.suites.suite import GameResult
from uavaccel.suites.training.config import CHECKPOINTS, TrainConfig
from uavaccel.suites.training.evaluations import Evaluations, drop_evaluations_after
from uavaccel.suites.training.rows import GameRows


class Trainer:
    """A learner and its lanes; resumed from a checkpoint, it reaches the weights that it would have had."""

    def __init__(self, config: TrainConfig, run: RunDirectory, begun: EnvironmentBatch | None) -> None:
        th.set_num_threads(config.torch_threads)
        self._config, self._run = config, run
        self._interrupted = False
        self._finished: deque[GameResult] = deque()
        self._lanes = make_lanes(config.task, config.environments, config.simulator, config.device, begun)
        try:
            self._learner = make_learner(config, self._lanes)
            seed_lanes(self._lanes, config.seed)
            if (checkpoint := find_checkpoint(run.path / CHECKPOINTS)) is not None:
                load_checkpoint(checkpoint, self._learner)
            self._learner.begin()
            self._rows = GameRows(config, run.file("tensorboard"), run.rows())
            self._evaluations = Evaluations(config, run)
        except BaseException:
            self._lanes.close()
            raise
        self._saved = self._learner.games

    def next_game(self) -> GameResult:
        """Fly and learn until another game is over, and return it.

        Raises KeyboardInterrupt on Ctrl-C, after saving a checkpoint.
        """
        learner = self._learner
        while not self._finished:
            learner.holding = self._due()
            if learner.at_rest:
                self._save_if_due()  # every returned game has its row by now
            self._finished.extend(self._rows.finished(game, learner.stopwatch) for game in learner.advance())
            if self._evaluations.due(learner.games):
                with self._rows.clock_stopped():
                    self._evaluations.fly(learner)
        game = self._finished.popleft()
        if learner.games == self._config.games and not self._finished:
            self._export()
        return replace(game, next_is_ready=bool(self._finished))

    def _save_if_due(self) -> None:
        games = self._learner.games
        if self._due():
            save_checkpoint(self._run.file(CHECKPOINTS), self._learner)
            self._export()
            self._saved = games
        if self._interrupted:
            raise KeyboardInterrupt

    def _due(self) -> bool:
        return self._interrupted or self._learner.games - self._saved >= self._config.checkpoint_games

    def _export(self) -> None:
        policy = self._learner.policy
        trained = {"games": self._learner.games, "weights_sha256": weights_sha256(policy)}
        export_policy(self._run.path, policy, self._config, trained)

    def close(self) -> None:
        self._rows.close()
        self._evaluations.close()
        self._lanes.close()

    def interrupt(self, number: int, frame: FrameType | None) -> None:
        """Stop between rollouts, after a checkpoint; on a second Ctrl-C at once."""
        if self._interrupted:
            raise KeyboardInterrupt
        self._interrupted = True


@contextmanager
def open_trainer(
    config: TrainConfig, run: RunDirectory, begun: EnvironmentBatch | None = None
) -> Iterator[Trainer]:
    """Yield a trainer that saves a checkpoint on Ctrl-C or SIGTERM, unless another process handles these signals.

    Its lanes are those of the batch `begun`, or new ones.
    """
    trainer = Trainer(config, run, begun)
    heeded = {
        kind: before for kind in (signal.SIGINT, signal.SIGTERM) if callable(before := signal.getsignal(kind))
    }
    if threading.current_thread() is not threading.main_thread():
        heeded = {}
    for kind in heeded:
        signal.signal(kind, trainer.interrupt)
    try:
        yield trainer
    finally:
        for kind, before in heeded.items():
            signal.signal(kind, before)
        trainer.close()


def drop_games_after_checkpoint(run: RunDirectory) -> None:
    """Drop the rows and evaluations after the last checkpoint, since they will be flown again.

    Raises UserError where rows from before the checkpoint are missing.
    """
    checkpoint = find_checkpoint(run.path / CHECKPOINTS)
    games, rows = 0 if checkpoint is None else games_of(checkpoint), len(run.rows())
    if rows < games:
        raise UserError(
            f"{run.path / 'rows.jsonl'}: has {rows} games, {checkpoint} knows {games}: rows are missing; put them "
            f"back, or delete {run.path / CHECKPOINTS} and --resume to begin the training anew"
        )
    run.keep_first(games)
    drop_evaluations_after(run, games)
