"""What a training records of each game: its row, the host's times, and points of TensorBoard's learning curves."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from tensorboard.compat.proto.event_pb2 import Event
from tensorboard.compat.proto.summary_pb2 import Summary
from tensorboard.summary.writer.record_writer import RecordWriter
from typing_extensions import TypedDict

from uavaccel.clock import MonotonicClock, epoch_s
from uavaccel.envs.stopwatch import Stopwatch
from uavaccel.forms import Count, NotNegative, Number
from uavaccel.rl.learner import Game
from uavaccel.suites.rows import LaneRow, lane_row
from uavaccel.suites.suite import GameResult
from uavaccel.suites.training.config import TrainConfig, game_case
from uavaccel.units import NS_PER_S

VERSION = "brain.Event:2"  # the first record of each such file


class CurvesFile:
    """TensorBoard events of this process in `folder`, which is made if necessary, written without a thread."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / f"events.out.tfevents.{epoch_s():.0f}.{os.getpid()}"
        self._file = RecordWriter(path.open("ab"))
        self._write(Event(wall_time=epoch_s(), file_version=VERSION))

    def add(self, step: int, values: Mapping[str, float]) -> None:
        """Add a point to each of several curves, by their names, at one `step`."""
        points = [Summary.Value(tag=name, simple_value=value) for name, value in values.items()]
        self._write(Event(wall_time=epoch_s(), step=step, summary=Summary(value=points)))

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _write(self, event: Event) -> None:
        self._file.write(event.SerializeToString())
        self._file.flush()


RECENT = 100  # games of the moving average of success

_Return = TypedDict("_Return", {"return": Number})  # a keyword of Python's


class TrainRow(LaneRow, _Return):
    """The row of a game of a training."""

    game: Count
    environment: Count
    exploration: NotNegative | None
    loss: Number | None
    mean_q: Number | None


class GameRows:
    """Makes the rows of games and writes TensorBoard's curves; `rows` are those of earlier starts."""

    def __init__(self, config: TrainConfig, folder: Path, rows: Sequence[TrainRow]) -> None:
        self._t_move_s = config.task.t_move_s
        self._curves = CurvesFile(folder)
        self._recent = deque([row["is_success"] for row in rows[-RECENT:]], maxlen=RECENT)
        self._simulated_s = 0.0
        self._clock = MonotonicClock()
        self._start_ns = self._clock.now_ns()

    def close(self) -> None:
        """Close the curves' file."""
        self._curves.close()

    @contextmanager
    def clock_stopped(self) -> Iterator[None]:
        """Exclude what is done meanwhile from the training's wall time."""
        begun_ns = self._clock.now_ns()
        try:
            yield
        finally:
            self._start_ns += self._clock.now_ns() - begun_ns

    def finished(self, game: Game, learning: Stopwatch) -> GameResult:
        """Return a finished game's row, and times since this start of the training: wall, the lane's, the learner's."""
        wall_s = (self._clock.now_ns() - self._start_ns) / NS_PER_S
        row: TrainRow = {
            **lane_row("train", game_case(game.number), game.info, self._t_move_s),
            "game": game.number,
            "environment": game.lane,
            "return": game.reward,
            "exploration": game.exploration_rate,
            "loss": game.loss,
            "mean_q": game.mean_q,
        }
        self._add_to_curves(row, wall_s)
        host = {
            "wall_s": wall_s,
            "host_phase_s": game.info["host_phase_s"],
            "learner_s": learning.spent_s(),
        }
        return GameResult(row, host=host)

    def _add_to_curves(self, row: TrainRow, wall_s: float) -> None:
        self._simulated_s += row["sim_time_s"]
        self._recent.append(row["is_success"])
        values = {
            "games/success_recent": sum(self._recent) / len(self._recent),
            "games/distance_m": row["distance_m"],
            "games/return": row["return"],
            "games/commands": row["commands"],
            "games/real_time_factor": self._simulated_s / wall_s,
        }
        learned = {name: row[name] for name in ("exploration", "loss", "mean_q")}
        values |= {f"games/{name}": value for name, value in learned.items() if value is not None}
        self._curves.add(row["game"] + 1, values)
