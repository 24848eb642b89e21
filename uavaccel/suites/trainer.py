"""The trainer: a learner flies its lanes, learns, saves checkpoints, and returns one finished game after another.

It evaluates the current policy between two steps, on lanes of their own, in processes and with random generators of
their own, by a copy of the policy below policies/: the weights are those of a training without evaluations.
"""

from __future__ import annotations

import signal
import threading
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import copy_context
from dataclasses import replace
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import torch as th

from uavaccel.clock import MonotonicClock
from uavaccel.config import validate
from uavaccel.draw.page import command_name, counted
from uavaccel.envs.batch import EnvironmentBatch
from uavaccel.envs.obstacle_lane import ObstacleLane
from uavaccel.errors import UserError
from uavaccel.files import append_lines, to_json
from uavaccel.records import RunDirectory
from uavaccel.rl.agents import FLIGHT, evaluation_keys
from uavaccel.rl.config import learns_from_a_buffer
from uavaccel.rl.lanes import make_lanes
from uavaccel.rl.learner import Game, Learner, find_checkpoint, games_of, load_checkpoint, make_learner, save_checkpoint
from uavaccel.rl.policy import export_policy, weights_sha256
from uavaccel.sim.camera.camera import BlankCamera, make_cameras_with
from uavaccel.suites.evaluate import EvaluateConfig
from uavaccel.suites.evaluate_lanes import GamesInBatch
from uavaccel.suites.event_file import EventFile
from uavaccel.suites.experiment import Row, game_row, number_of
from uavaccel.suites.suite import GameResult
from uavaccel.suites.train import CHECKPOINTS, EVALUATIONS, RECENT, TrainConfig, TrainRow, evaluations, game_case
from uavaccel.units import NS_PER_S

FIRST_LANE = 500_000  # beyond those of `uavaccel evaluate`, so that policies may be selected on these
REAL_TIME_COMMANDS = 20  # in the game that models real time, after which their mean changes by less than 1 %
CURVES = ("distance_m", "return", "commands", "exploration", "loss", "mean_q")  # of TensorBoard, beside two more
REAL_TIME_KEYS = ("command", "observation", "history", "image_processing_s", *FLIGHT)


class Trainer:
    """A learner and its lanes; resumed from a checkpoint, it reaches the weights that it would have had."""

    def __init__(self, config: TrainConfig, run: RunDirectory, begun: EnvironmentBatch | None) -> None:
        th.set_num_threads(config.torch_threads)
        self._config, self._run = config, run
        self._interrupted = False
        self._finished: deque[GameResult] = deque()
        self._lanes = make_lanes(config, begun)
        try:
            self._learner = make_learner(config, self._lanes)
            if (checkpoint := find_checkpoint(run.path / CHECKPOINTS)) is not None:
                load_checkpoint(checkpoint, self._learner)
            self._learner.begin()
            self._rows = GameRows(config, run.path, run.rows())
            self._evaluations = Evaluations(config, run)
        except BaseException:
            self._lanes.close()
            raise
        self._saved = self._learner.games

    def next_game(self) -> GameResult:
        """Fly and learn until another game is over, and return it; a checkpoint is saved before KeyboardInterrupt."""
        learner = self._learner
        while not self._finished:
            learner.holding = self._interrupted or learner.games - self._saved >= self._config.checkpoint_games
            if learner.holding and learner.at_rest:  # every returned game has its row by now
                save_checkpoint(self._run.file(CHECKPOINTS), learner)
                export_learned(self._run.path, learner, self._config)
                self._saved = learner.games
                if self._interrupted:
                    raise KeyboardInterrupt
            games = learner.advance()
            self._finished.extend(self._rows.finished(games, learner.stopwatch.spent_s()))
            if self._evaluations.due(learner.games):
                with self._rows.clock_stopped():
                    self._evaluations.fly(learner)
        game = self._finished.popleft()
        if learner.games == self._config.games and not self._finished:
            export_learned(self._run.path, learner, self._config)
        return replace(game, next_is_ready=bool(self._finished))

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
def open_trainer(config: TrainConfig, run: RunDirectory, begun: EnvironmentBatch | None = None) -> Iterator[Trainer]:
    """Yield a trainer, on the lanes `begun` or new ones, that saves a checkpoint on Ctrl-C or SIGTERM where it may."""
    trainer = Trainer(config, run, begun)
    kinds = (signal.SIGINT, signal.SIGTERM) if threading.current_thread() is threading.main_thread() else ()
    heeded = {kind: before for kind in kinds if callable(before := signal.getsignal(kind))}
    for kind in heeded:
        signal.signal(kind, trainer.interrupt)
    try:
        yield trainer
    finally:
        for kind, before in heeded.items():
            signal.signal(kind, before)
        trainer.close()


def export_learned(folder: Path, learner: Learner, config: TrainConfig) -> str:
    """Write the policy as it is now into a folder, and return the hash of its weights."""
    sha256 = weights_sha256(learner.policy)
    export_policy(folder, learner.policy, config, {"games": learner.games, "weights_sha256": sha256})
    return sha256


def drop_games_after_checkpoint(run: RunDirectory) -> None:
    """Drop rows and evaluations after the last checkpoint, which are flown again. Raises UserError where rows lack."""
    checkpoint = find_checkpoint(run.path / CHECKPOINTS)
    games, rows = 0 if checkpoint is None else games_of(checkpoint), len(run.rows())
    if rows < games:
        raise UserError(
            f"{run.path / 'rows.jsonl'}: has {counted(rows, 'game')}, {checkpoint} knows {games}: rows are missing; "
            f"put them back, or delete {run.path / CHECKPOINTS} and --resume to begin the training anew"
        )
    run.truncate_to(games)
    if (run.path / EVALUATIONS).is_file():
        kept = [line for line in evaluations(run) if line["games"] <= games]
        run.write_text(EVALUATIONS, "".join(to_json(line) + "\n" for line in kept))


class GameRows:
    """Makes the rows of games, after the `rows` of earlier starts, and writes curves for TensorBoard and `wandb`."""

    def __init__(self, config: TrainConfig, run: Path, rows: Sequence[Row]) -> None:
        self._t_move_s = config.task.t_move_s
        self._recent = deque([row["is_success"] for row in rows[-RECENT:]], maxlen=RECENT)
        self._simulated_s = 0.0
        self._clock = MonotonicClock()
        self._start_ns = self._clock.now_ns()
        self._wandb: Any = None
        if config.wandb is not None:  # a run for each start; its own settings say where it goes
            import wandb

            keys = config.model_dump(mode="json", exclude={"task": {"latency"}})
            try:
                self._wandb = wandb.init(project=config.wandb, name=str(run), dir=str(run), config=keys)
            except wandb.Error as error:
                raise UserError(f"wandb = {config.wandb!r}: {str(error).partition(chr(10))[0]}") from error
        self._curves = EventFile(run / "tensorboard")

    def close(self) -> None:
        """Close the curves' file, and end the run of Weights & Biases, which sends what it has yet to send."""
        self._curves.close()
        if self._wandb is not None:
            self._wandb.finish()

    @contextmanager
    def clock_stopped(self) -> Iterator[None]:
        """Exclude what is done meanwhile from the training's wall time."""
        begun_ns = self._clock.now_ns()
        try:
            yield
        finally:
            self._start_ns += self._clock.now_ns() - begun_ns

    def finished(self, games: Sequence[Game], learner_s: Mapping[str, float]) -> list[GameResult]:
        """Return the rows of games, and times since this start of the training: wall, the lane's, the learner's."""
        results = [self._finished(game, learner_s) for game in games]
        self._curves.write_waiting()
        return results

    def _finished(self, game: Game, learner_s: Mapping[str, float]) -> GameResult:
        wall_s = (self._clock.now_ns() - self._start_ns) / NS_PER_S
        row: TrainRow = {
            **game_row("train", game_case(game.number), game.info, self._t_move_s),
            **{key: game.info[key] for key in ("lane", "distance_m") if key in game.info},  # type: ignore[typeddict-item]
            "game": game.number,
            "environment": game.lane,
            "return": game.reward,
            "exploration": game.exploration_rate,
            "loss": game.loss,
            "mean_q": game.mean_q,
        }
        self._simulated_s += row["sim_time_s"]
        self._recent.append(row["is_success"])
        curves: dict[str, Any] = {name: value for name, value in row.items() if name in CURVES} | {
            "success_recent": sum(self._recent) / len(self._recent),
            "real_time_factor": self._simulated_s / wall_s,
        }
        points = {f"games/{name}": value for name, value in curves.items() if value is not None}
        self._curves.add(game.number + 1, points)
        if self._wandb is not None:
            self._wandb.log(points, step=game.number + 1)
        return GameResult(
            row, host={"wall_s": wall_s, "host_phase_s": game.info["host_phase_s"], "learner_s": learner_s}
        )


class Evaluations:
    """Flies evaluations when they are due, and writes a line of evaluations.jsonl for each."""

    def __init__(self, config: TrainConfig, run: RunDirectory) -> None:
        self._config, self._run = config, run
        done = evaluations(run)
        self._done = int(done[-1]["games"]) if done else 0
        self._batch: GamesInBatch | None = None

    def due(self, games: int) -> bool:
        """Return whether a multiple of `evaluate_every_games` or the last game has passed since the last evaluation."""
        every = self._config.evaluate_every_games
        if not every or games <= self._done:
            return False
        return games // every > self._done // every or games == self._config.games

    def fly(self, learner: Learner) -> None:
        """Evaluate the greedy policy on every lane, and write the line."""
        folder = self._run.file(f"policies/{learner.games:07d}/policy.pt").parent
        sha256, config = export_learned(folder, learner, self._config), evaluation_of(self._config, folder)
        lanes = range(FIRST_LANE, FIRST_LANE + self._config.evaluation_games)
        if self._batch is None:
            self._batch = GamesInBatch(config, lanes)
        else:
            self._batch.begin(config, lanes)
        rows = [self._batch.game(lane).row for lane in lanes]
        line = {
            "games": learner.games,
            "weights_sha256": sha256,
            "successes": sum(row["is_success"] for row in rows),
            "lanes": list(map(number_of, rows)),
            "is_success": [row["is_success"] for row in rows],
            **({"distance_m": [row["distance_m"] for row in rows]} if "distance_m" in rows[0] else {}),
        }
        append_lines(self._run.file(EVALUATIONS), [to_json(line)])
        self._done = learner.games

    def close(self) -> None:
        """End the processes."""
        if self._batch is not None:
            self._batch.close()


def evaluation_of(config: TrainConfig, folder: Path) -> EvaluateConfig:
    """Return the configuration with which `uavaccel evaluate` flies the same evaluation of a training's policy."""
    keys = {
        "agent": str(folder),
        "seed": config.seed,
        "games": config.evaluation_games,
        "first_lane": FIRST_LANE,
        "environments": min(config.environments, config.evaluation_games),
        "inference_s": config.inference_s,
        "env_id": config.env_id,
        "task": {**config.task.model_dump(mode="json"), **evaluation_keys(config.env_id)},
    }
    return validate(EvaluateConfig, keys, "evaluation")


def model_real_time(config: TrainConfig) -> dict[str, Any]:
    """Return the wall seconds of a command, from a short game straight ahead in an empty lane in the modelled AirSim.

    Images, DVS, decisions and, with a replay buffer, learning are charged to its wall clock, as in Figure 9.
    """
    task = config.task
    buffered = learns_from_a_buffer(config.algorithm)
    learning_s = config.learning_s * (1 / config.commands_per_gradient_step if buffered else 0.0)
    how = (
        f"{command_name(task.command)} under the profile airsim at ClockSpeed 1 with the latencies that ship, "
        f"{task.frames_per_command} samples per command, a decision of {config.inference_s * 1e3:g} ms and "
        f"{learning_s * 1e3:g} ms of learning per command; resets are not counted"
    )
    keys = task.model_dump(mode="json", include=set(REAL_TIME_KEYS))
    return {"command_s": copy_context().run(_fly_ahead, keys, config.inference_s, learning_s), "how": how}


def _fly_ahead(keys: dict[str, Any], inference_s: float, learning_s: float) -> float:
    make_cameras_with(BlankCamera)  # nobody looks at the pictures, whose time is modelled: no OpenGL is needed
    environment = ObstacleLane(**keys, timing="virtual", profile="airsim", clock_speed=1.0, lane={"obstacles": []})
    ahead, over = int(np.abs(environment.task.headings_deg).argmin()), False
    try:
        _, info = environment.reset(seed=0)
        while not over and info["commands"] < REAL_TIME_COMMANDS:
            environment.charge(inference_s, "inference")
            environment.charge(learning_s, "learning")
            _, _, terminated, truncated, info = environment.step(ahead)
            over = terminated or truncated
    finally:
        environment.close()
    return float(info["wall_s"] / info["commands"])
