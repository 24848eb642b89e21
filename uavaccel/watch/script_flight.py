"""What `uavaccel fly --out` has kept, as a track: the trajectory, and of the messages the commands and both clocks."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from uavaccel.errors import UserError
from uavaccel.files import Plain, parse_json, read_arrays, read_bounded, read_lines
from uavaccel.fly.messages import FILE_NAME as MESSAGES
from uavaccel.fly.options import SUMMARY
from uavaccel.fly.trajectory import FILE_NAME as FLIGHT
from uavaccel.kinematics import Vector
from uavaccel.units import NS_PER_S
from uavaccel.watch.track import Track
from uavaccel.wire.api import CALLS

SAMPLES = ("time_ns", "position_m", "orientation_wxyz")


def script_track(folder: Path) -> tuple[Track, str]:
    """The flight's track, and its scene. Raises UserError for a flight that is not whole."""
    summary, messages = _summary(folder / SUMMARY), read_lines(folder / MESSAGES)
    arrays = _arrays(folder / FLIGHT)
    if len(arrays["time_ns"]) < 2:
        raise UserError(f"{folder / FLIGHT}: has no path: no client connected, or it flew no time")
    time_s, speed = arrays["time_ns"] / NS_PER_S, float(summary["clock_speed"])
    calls = [row for row in messages if "call" in row]
    marks = _marks(calls, time_s, speed, summary.get("script_s"))
    starts, ends, asked = _commands(calls, messages, marks)
    track = Track(
        f"script at {speed:g}x",
        speed,
        time_s,
        arrays["position_m"],
        arrays["orientation_wxyz"],
        starts,
        ends,
        marks,
        asked,
    )
    return track, str(summary.get("scene", "blocks"))


def _summary(path: Path) -> Plain:
    try:
        summary = parse_json(read_bounded(path).decode("utf-8"))
    except (OSError, ValueError) as error:
        raise UserError(f"{path}: is missing or damaged, so that the flight is not whole: {error}") from None
    if not (isinstance(summary, dict) and isinstance(summary.get("clock_speed"), int | float)):
        raise UserError(f"{path}: is no summary of a flight: no number under 'clock_speed'")
    return summary


def _arrays(path: Path) -> dict[str, np.ndarray]:
    arrays = read_arrays(path)
    lengths = {len(arrays[name]) if name in arrays else None for name in SAMPLES}
    if None in lengths or len(lengths) > 1:
        raise UserError(f"{path}: is no trajectory: needs {', '.join(SAMPLES)}, of equal length")
    return arrays


def _marks(calls: Iterable[Plain], time_s: np.ndarray, speed: float, script_s: float | None) -> np.ndarray:
    """Wall and simulated seconds (m, 2), of the calls; of a flight on the machine's clock of its ends alone."""
    known = [(row["wall_ns"] / NS_PER_S, row["time_ns"] / NS_PER_S) for row in calls if row["time_ns"] is not None]
    if not known:
        return np.array([[0.0, time_s[0]], [(time_s[-1] - time_s[0]) / speed, time_s[-1]]])
    last_s = max(known[-1][0], script_s or 0.0)
    marks = np.array([(0.0, 0.0), *known, (last_s, time_s[-1])])
    return np.asarray(np.maximum.accumulate(marks))


def _commands(
    calls: list[Plain], messages: Iterable[Plain], marks: np.ndarray
) -> tuple[np.ndarray, np.ndarray, list[Vector | None]]:
    """Start and end of each command, in simulated seconds, and its velocity where it has one.

    A command ends where the script has its answer, which it only asks for with `join`, or at the next command.
    """
    moves = [
        row for row in calls if row["method"] in CALLS and CALLS[row["method"]].channel_of(row["params"]) == "move"
    ]
    answered = {row["answer"]: row["wall_ns"] for row in messages if "answer" in row}

    def at(wall_ns: int) -> float:
        return float(np.interp(wall_ns / NS_PER_S, marks[:, 0], marks[:, 1]))

    starts = [at(row["wall_ns"]) for row in moves]
    following = [*starts[1:], *([float(marks[-1, 1])] if starts else [])]
    ends = [
        min(at(answered[row["call"]]), after) if row["call"] in answered else after
        for row, after in zip(moves, following, strict=True)
    ]
    return np.array(starts), np.array(ends), [_velocity(row) for row in moves]


def _velocity(row: Plain) -> Vector | None:
    """The velocity that a call names, NED."""
    numbers = row["params"]
    if row["method"] == "moveByVelocity":
        return numbers[0], numbers[1], numbers[2]
    return (numbers[0], numbers[1], 0.0) if row["method"] == "moveByVelocityZ" else None
