"""Finished flights as tracks: a game of a run, or what `uavaccel fly --out` kept."""

from __future__ import annotations

from pathlib import Path

from uavaccel.commands.paths import PATHS, velocities
from uavaccel.draw.labels import clock_label, command_name
from uavaccel.errors import UserError
from uavaccel.records import RunDirectory
from uavaccel.suites.rows import Row
from uavaccel.suites.suite import choose_row
from uavaccel.watch.track import Track, track_of

NEEDED = {"time_s", "position_m", "orientation_wxyz", "command_start_s", "command_end_s"}


def recorded_track(folder: Path, case: str | None) -> Track:
    """The track of a run's game, without `case` the first of its fastest.

    Raises UserError if there is none, or no samples of it.
    """
    run = RunDirectory(folder)
    rows: list[Row] = [row for row in run.rows() if isinstance(row, dict)]
    row = choose_row(run, case, sorted(rows, key=_interest))
    if "arrays" not in row:
        raise UserError(f"{folder}: keeps no samples of {row['case']}; `watch` replays games of dp1")
    arrays = run.load_arrays(row)
    if missing := sorted(NEEDED - arrays.keys()):
        raise UserError(f"{folder}: the samples of {row['case']} have no {', '.join(missing)}")
    speed = float(row["clock_speed"])
    path = run.config().get("path")
    known = isinstance(path, str) and path in PATHS
    name = f"{command_name(str(row['command']))} at {clock_label(speed)}"
    return track_of(name, speed, arrays, velocities(str(path), int(row["rounds"])) if known else ())


def _interest(row: Row) -> tuple[bool, float]:
    """Games before those that they are compared with, the fastest first."""
    speed = row.get("clock_speed")
    return row.get("role") != "game", -float(speed) if isinstance(speed, int | float) else 0.0
