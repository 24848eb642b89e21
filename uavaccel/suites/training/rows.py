"""What a training keeps of a game: its row, what it took on this machine, and its place on the learning curves."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TypedDict

from uavaccel.clock import MonotonicClock
from uavaccel.envs.flight_env import CONDITIONS
from uavaccel.envs.stopwatch import Stopwatch
from uavaccel.rl.learner import Game
from uavaccel.suites.disturbed import note_disturbances
from uavaccel.suites.report import LaneRow
from uavaccel.suites.suite import GameResult
from uavaccel.suites.training.config import TrainConfig
from uavaccel.suites.training.curves_file import CurvesFile
from uavaccel.units import NS_PER_S

RECENT = 100  # games whose success is shown

_Return = TypedDict("_Return", {"return": float})  # a keyword of Python's


class TrainRow(LaneRow, _Return):
    """A game of a training."""

    game: int
    environment: int
    exploration: float | None


class GameRows:
    """Makes rows of games and draws TensorBoard's curves; `rows` are those of earlier starts."""

    def __init__(self, config: TrainConfig, folder: Path, rows: Sequence[TrainRow]) -> None:
        self._t_move_s = config.task.t_move_s
        self._curves = CurvesFile(folder)
        self._recent = deque([row["is_success"] for row in rows[-RECENT:]], maxlen=RECENT)
        self._simulated_s = 0.0
        self._clock = MonotonicClock()
        self._start_ns = self._clock.now_ns()

    def close(self) -> None:
        """End the curves' file."""
        self._curves.close()

    @contextmanager
    def clock_stopped(self) -> Iterator[None]:
        """What is done meanwhile is no part of the training's wall time."""
        begun_ns = self._clock.now_ns()
        try:
            yield
        finally:
            self._start_ns += self._clock.now_ns() - begun_ns

    def flown(self, game: Game, learning: Stopwatch) -> GameResult:
        """A game's row, and host times since this start of the training: wall, the lane's own, the learner's."""
        wall_s = (self._clock.now_ns() - self._start_ns) / NS_PER_S
        info = game.info
        row: TrainRow = {
            "case": f"game-{game.number:07d}",
            "suite": "train",
            "game": game.number,
            "environment": game.lane,
            "return": game.reward,
            "exploration": game.exploration_rate,
            "sim_time_s": info["commands"] * self._t_move_s,
            "is_success": info["is_success"],
            "distance_m": info["distance_m"],
            "collision": info["collision"],
            "lane": info["lane"],
            "commands": info["commands"],
            "phase_s": info["phase_s"],
        }
        note_disturbances(row, info)
        if CONDITIONS in info:
            row[CONDITIONS] = info[CONDITIONS]
        self._draw(row, wall_s)
        host = {
            "wall_s": wall_s,
            "host_phase_s": game.info["host_phase_s"],
            "learner_s": learning.spent_s(),
        }
        return GameResult(row, host=host)

    def _draw(self, row: TrainRow, wall_s: float) -> None:
        self._simulated_s += row["sim_time_s"]
        self._recent.append(row["is_success"])
        values = {
            "games/success_recent": sum(self._recent) / len(self._recent),
            "games/distance_m": row["distance_m"],
            "games/return": row["return"],
            "games/real_time_factor": self._simulated_s / wall_s,
        }
        self._curves.add(row["game"] + 1, values)
