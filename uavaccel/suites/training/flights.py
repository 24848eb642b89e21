"""Training: games flown and learned from until there were enough, resumable at any moment to the same weights."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch as th
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import configure

from uavaccel.clock import MonotonicClock
from uavaccel.envs.stopwatch import PHASES
from uavaccel.files import to_json
from uavaccel.records import RunDirectory
from uavaccel.rl.algorithms import make_model
from uavaccel.rl.checkpoint import find_checkpoint, load_checkpoint, save_checkpoint, set_random
from uavaccel.rl.config import TrainConfig
from uavaccel.rl.lanes import make_lanes, seed_lanes
from uavaccel.rl.policy import export_policy, weights_sha256
from uavaccel.units import NS_PER_S

CHECKPOINTS = "checkpoints"
UNLIMITED = 1 << 62  # of timesteps: a training ends by games
RECENT = 100  # games whose success is shown

Report = Callable[[dict[str, Any]], None]


def train(config: TrainConfig, run: RunDirectory, report: Report = lambda status: None) -> dict[str, Any]:
    """Train into a run directory, or go on from its last checkpoint; returns the summary, which is written there.

    `report` is told after each game: games, success_recent, simulated_s, wall_s (of this start).
    """
    th.set_num_threads(config.torch_threads)
    environment = make_lanes(config.task, config.environments)
    try:
        model = make_model(config, environment)
        seed_lanes(environment, config.seed)
        model.set_logger(configure(str(run.path / "tensorboard"), ["tensorboard"]))
        keeper = _Keeper(config, run, report)
        checkpoint = find_checkpoint(run.path / CHECKPOINTS)
        if checkpoint is not None:
            keeper.go_on(checkpoint, model)
        else:
            keeper.keep_rows(0)
        if keeper.games < config.games:
            model.learn(UNLIMITED, callback=keeper, reset_num_timesteps=checkpoint is None)
        return _finish(config, run, model)
    finally:
        environment.close()


class _Keeper(BaseCallback):
    """Counts games, writes their rows, charges modelled work, saves checkpoints, and ends the training."""

    def __init__(self, config: TrainConfig, run: RunDirectory, report: Report) -> None:
        super().__init__()
        self._config, self._run, self._report = config, run, report
        self.games = 0
        self._simulated_s = 0.0
        self._random: dict[str, Any] | None = None
        self._recent: deque[bool] = deque(maxlen=RECENT)
        self._returns = [0.0] * config.environments
        self._saved = 0
        self._clock = MonotonicClock()
        self._start_ns = self._clock.now_ns()

    # --- going on ---------------------------------------------------------------------------------

    def go_on(self, checkpoint: Path, model: BaseAlgorithm) -> None:
        """Take a checkpoint's state; rows written after it are dropped, their games are flown again."""
        notes, self._random = load_checkpoint(checkpoint, model)
        self._returns = notes["returns"]
        self.keep_rows(notes["rows"])

    def keep_rows(self, count: int) -> None:
        """Drop all rows but the first `count`."""
        rows, timings = self._run.rows()[:count], self._run.timings()[:count]
        self._run.write_text("rows.jsonl", "".join(to_json(row) + "\n" for row in rows))
        self._run.write_text("timing.jsonl", "".join(to_json(entry) + "\n" for entry in timings))
        self._run = RunDirectory(self._run.path)
        self.games = self._saved = count
        self._recent.extend(row["is_success"] for row in rows[-RECENT:])

    def _on_training_start(self) -> None:
        if self._random is not None:
            set_random(self._random, self.model)

    # --- flying -----------------------------------------------------------------------------------

    def _on_rollout_start(self) -> None:
        if self.games - self._saved >= self._config.checkpoint_games:
            notes = {"rows": self.games, "returns": self._returns}
            save_checkpoint(self._run.path / CHECKPOINTS, self.model, notes)
            export_policy(self._run.path, self.model, self._config, {"games": self.games})
            self._saved = self.games
        self._charge_learning()

    def _charge_learning(self) -> None:
        """Each environment pays for the gradient steps that its own commands bring about."""
        owed = self.model.owed  # type: ignore[attr-defined]
        if self._config.task.timing == "virtual" and owed:
            share = owed / self._config.environments
            self.training_env.env_method("charge", share * self._config.learning_s, "learning")

    def _on_step(self) -> bool:
        for index, (done, info) in enumerate(zip(self.locals["dones"], self.locals["infos"], strict=True)):
            self._returns[index] += float(self.locals["rewards"][index])
            if done and self.games < self._config.games:
                self._finish_game(index, info)
        if self._config.task.timing == "virtual":
            self.training_env.env_method("charge", self._config.inference_s, "inference")
        return self.games < self._config.games

    def _finish_game(self, environment: int, info: dict[str, Any]) -> None:
        game, host_s = self.games, info["host_phase_s"]
        wall_s = (self._clock.now_ns() - self._start_ns) / NS_PER_S
        learner_s = self.model.stopwatch.spent_s()  # type: ignore[attr-defined]
        names = ("is_success", "distance_m", "collision", "lane", "commands", "phase_s")
        row = {
            "case": f"game-{game:07d}",
            "suite": "train",
            "game": game,
            "environment": environment,
            "return": self._returns[environment],
            "exploration": getattr(self.model, "exploration_rate", None),
            "sim_time_s": info["commands"] * self._config.task.t_move_s,
            **{name: info[name] for name in names},
        }
        self._run.append_timing(
            {"game": game, "wall_s": wall_s, "host_phase_s": host_s, "learner_s": learner_s}
        )
        self._run.append_row(row)
        self._returns[environment] = 0.0
        self._count(row, wall_s)

    def _count(self, row: dict[str, Any], wall_s: float) -> None:
        self.games += 1
        self.model.games_done = self.games  # type: ignore[attr-defined]
        self._simulated_s += row["sim_time_s"]
        self._recent.append(row["is_success"])
        success = sum(self._recent) / len(self._recent)
        self.logger.record("games/count", self.games)
        self.logger.record("games/success_recent", success)
        self.logger.record_mean("games/distance_m", row["distance_m"])
        self.logger.record_mean("games/return", row["return"])
        self.logger.record("games/real_time_factor", self._simulated_s / wall_s)
        self._report(
            {
                "games": self.games,
                "success_recent": success,
                "simulated_s": self._simulated_s,
                "wall_s": wall_s,
            }
        )


def _finish(config: TrainConfig, run: RunDirectory, model: BaseAlgorithm) -> dict[str, Any]:
    """Weights, their hash and the sums over all games."""
    rows = run.rows()
    task = config.task
    summary = {
        "suite": "train",
        "profile": task.profile,
        "command": task.command,
        "clock_speed": task.clock_speed,
        "timing": task.timing,
        "seed": config.seed,
        "games": len(rows),
        "successes": sum(row["is_success"] for row in rows),
        "commands": sum(row["commands"] for row in rows),
        "sim_time_s": sum(row["sim_time_s"] for row in rows),
        "phase_s": {phase: sum(row["phase_s"][phase] for row in rows) for phase in PHASES},
        "weights_sha256": weights_sha256(model),
    }
    export_policy(run.path, model, config, summary)
    run.write_json("summary.json", summary)
    return summary
