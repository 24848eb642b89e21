"""Finished flights as tracks: a game of a run, or what `uavaccel fly --out` has kept."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import numpy as np

from uavaccel.commands.paths import PATHS, velocities
from uavaccel.commands.slices import samples_due
from uavaccel.config import validate
from uavaccel.draw.labels import clock_label, command_name
from uavaccel.envs.obstacle_lane import ObstacleLane
from uavaccel.envs.simulators import EXACT
from uavaccel.errors import UsageError, UserError
from uavaccel.fly.trajectory import FILE_NAME as FLIGHT
from uavaccel.records import RunDirectory
from uavaccel.rl.agents import make_agent
from uavaccel.sim.lane.layout import LaneLayout
from uavaccel.suites.evaluation.again import evaluation_of, fly_again
from uavaccel.suites.evaluation.film import best_first
from uavaccel.suites.evaluation.flights import EvaluateRow, fly_lane
from uavaccel.suites.old_dp2.config import Dp2Config
from uavaccel.suites.old_dp2.flights import SCENE as LANE
from uavaccel.suites.registry import open_run
from uavaccel.suites.rows import Row
from uavaccel.suites.suite import choose_row
from uavaccel.watch.script_flight import script_track
from uavaccel.watch.track import Floats, Track, track_of
from uavaccel.wire.image_api import lane_layout

POSES = {"time_s", "position_m", "orientation_wxyz"}
COMMANDS = {"command_start_s", "command_end_s"}


@dataclass(frozen=True)
class Replay:
    """A finished flight, where it was flown, and in words what it is."""

    track: Track
    title: str
    scene: str = "blocks"
    lane: LaneLayout | None = None


def recorded(folder: Path, case: str | None = None, game: int | None = None) -> Replay:
    """A game of the run in `folder` by its name or its place in rows.jsonl, or the flight of a script in it.

    By default the game is the fastest, or the best. Raises UserError if there is none, or nothing recorded of it.
    """
    if case is not None and game is not None:
        raise UsageError("--case, --game: name the game by one of them")
    if (folder / FLIGHT).is_file():
        if case is not None or game is not None:
            raise UsageError(f"{folder}: is the flight of one script: without --case and --game")
        track, scene = script_track(folder)
        return Replay(track, f"The flight in `{folder}`.", scene)
    if not (folder / "config.yaml").is_file():
        raise UserError(_nothing_in(folder))
    run = open_run(folder)
    suite = str(run.config().get("suite"))
    row = _chosen(run, case, game)
    return _REPLAYS.get(suite, _of_samples)(run, row)


def _nothing_in(folder: Path) -> str:
    flights = sorted(file.parent.name for file in folder.glob(f"*/{FLIGHT}"))
    if flights:
        return f"{folder}: has several flights: name one of them, as in {folder / flights[0]}"
    return (
        f"{folder}: holds neither a run nor a flight: `uavaccel run` and `evaluate` keep runs, `uavaccel fly` keeps "
        "a flight with --out FOLDER"
    )


def _chosen(run: RunDirectory, case: str | None, game: int | None) -> Row:
    rows: list[Row] = run.rows()
    if game is not None and rows:
        if not 0 <= game < len(rows):
            raise UserError(f"--game {game}: {run.path} has {len(rows)} games, from 0 to {len(rows) - 1}")
        return rows[game]
    if run.config().get("suite") == "evaluate":
        return choose_row(run, case, best_first(cast(list[EvaluateRow], rows)))
    return choose_row(run, case, sorted(rows, key=interest))


def interest(row: Row) -> tuple[bool, float]:
    """Sort games before those that they are compared with, the fastest first."""
    speed = row.get("clock_speed")
    return row.get("role") != "game", -float(speed) if isinstance(speed, int | float) else 0.0


def _of_samples(run: RunDirectory, row: Row) -> Replay:
    """A game whose row names arrays with its path, as DP1's do."""
    arrays = _arrays(run, row, POSES | COMMANDS)
    path = run.config().get("path")
    known = isinstance(path, str) and path in PATHS
    asked = velocities(str(path), int(row["rounds"])) if known else ()
    return Replay(_track(row, arrays, asked), _title(run, row))


def _of_dp2(run: RunDirectory, row: Row) -> Replay:
    """A game of DP2, whose samples are at the pictures."""
    config = validate(Dp2Config, run.config(), str(run.path / "config.yaml"))
    arrays = _arrays(run, row, POSES | {"sample_index", "command_velocity_m_s"})
    flat, time_s = arrays["command_velocity_m_s"], arrays["time_s"]
    slots = len(samples_due(config.t_move_s, config.t_sample_s))
    began = time_s[np.searchsorted(arrays["sample_index"], np.arange(len(flat)) * slots)]
    ended = np.minimum(began + config.t_move_s, [*began[1:], time_s[-1]])
    arrays = {**arrays, "command_start_s": began, "command_end_s": ended}
    asked = [(north, east, 0.0) for north, east in flat.tolist()]
    return Replay(_track(row, arrays, asked), _title(run, row), LANE, config.layout())


def _of_evaluation(run: RunDirectory, row: Row) -> Replay:
    """A game of an evaluation, which keeps its actions: it is flown again, and has to make the same row.

    One that the kernels flew is flown in the exact simulator, where it may end otherwise.
    """
    config = evaluation_of(run, "watch")
    task, lane = config.task, int(row["lane"])
    again = "flown again from its actions"
    asked = []
    with closing(ObstacleLane(**task.model_dump(mode="json"))) as environment:
        if config.simulator == EXACT:
            actions = [step.action for step in fly_again(run, config, environment, cast(EvaluateRow, row))]
        else:
            agent = make_agent(config.agent, task)
            actions = [info["action"] for info in fly_lane(config, environment, agent, lane)]
            again = "flown again in the exact simulator, where it may end otherwise"
        flown = environment.episode_task
        asked = (
            [flown.velocity_goal(action).velocity_m_s for action in actions]
            if flown.action == "velocity"
            else []
        )
        arrays = environment.recording().arrays()
        layout = lane_layout(flown.wire_lane(lane))
    named = {"command": task.command, "clock_speed": task.clock_speed}
    won = (
        "reached the end"
        if row["is_success"]
        else f"hit {row['collision']}"
        if row.get("collision")
        else "did not arrive"
    )
    title = f"{_title(run, row)[:-1]}, {again}; it {won}."
    return Replay(_track(named, arrays, asked), title, LANE, layout)


def _of_training(run: RunDirectory, row: Row) -> Replay:
    raise UserError(
        f"{run.path}: a training keeps no paths of its games; evaluate its policy, and watch that: "
        f"uavaccel evaluate {run.path} --out FOLDER, uavaccel watch FOLDER"
    )


def _arrays(run: RunDirectory, row: Row, needed: set[str]) -> Mapping[str, Floats]:
    """The arrays of a row. Raises UserError where they hold no path."""
    if "arrays" not in row:
        raise UserError(
            f"{run.path}: a run of {run.config().get('suite')} keeps no path of {row['case']}; runs of dp1, dp2 and "
            "evaluate do, and `uavaccel fly --out FOLDER`"
        )
    arrays = run.load_arrays(row)
    if missing := sorted(needed - arrays.keys()):
        raise UserError(f"{run.path}: the samples of {row['case']} have no {', '.join(missing)}")
    return arrays


def _track(
    row: Mapping[str, object], arrays: Mapping[str, Floats], asked: Sequence[tuple[float, float, float]]
) -> Track:
    speed = float(str(row["clock_speed"]))
    return track_of(f"{command_name(str(row['command']))} at {clock_label(speed)}", speed, arrays, asked)


def _title(run: RunDirectory, row: Row) -> str:
    return f"Game `{row['case']}` of `{run.path}`."


_REPLAYS: Mapping[str, Callable[[RunDirectory, Row], Replay]] = {
    "dp2": _of_dp2,
    "evaluate": _of_evaluation,
    "train": _of_training,
}
