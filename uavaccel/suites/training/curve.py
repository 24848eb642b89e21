"""The learning curve of a training: games won over the wall clock, from its rows and timing.jsonl."""

from __future__ import annotations

import json
from collections.abc import Sequence
from itertools import accumulate
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from uavaccel.draw.evaluated import Evaluated
from uavaccel.draw.learning_curve import LearningCurve, draw_learning_curves
from uavaccel.draw.learning_games import GamesCurve, draw_learning_games
from uavaccel.draw.style import clock_label, command_name
from uavaccel.errors import UserError
from uavaccel.metrics.speedup import timing_provenance
from uavaccel.records import RunDirectory
from uavaccel.suites.host_time import running_s
from uavaccel.suites.training.evaluations import evaluations
from uavaccel.suites.training.rows import RECENT

PAPER_S = {"paper: 5 000 games in real time, 182 h": 182 * 3600.0}  # section IV-D: one week and 14 hours


def learning_curve(run: RunDirectory, label: str) -> LearningCurve:
    """From the 100th game on: the wall clock so far, of all starts, and the share won of the last 100 games.

    A shorter training has the share of all its games so far. Raises UserError where the run has no game of a training,
    or no wall times.
    """
    rows, timings = run.rows(), run.timings()
    if not rows or len(timings) < len(rows) or any("wall_s" not in entry for entry in timings):
        raise UserError(f"{run.path}: is no training with a wall time in timing.jsonl for each game")
    games, success = _recent_success([row["is_success"] for row in rows])
    wall_s = np.array(running_s(run))
    return LearningCurve(label, wall_s[games - 1].tolist(), success.tolist(), evaluated(run, wall_s))


def games_curve(run: RunDirectory, label: str) -> GamesCurve:
    """The share won of the last 100 games, or of all so far, after each game from the 100th, or the first, on."""
    rows = run.rows()
    games, success = _recent_success([row["is_success"] for row in rows])
    return GamesCurve(label, games.tolist(), success.tolist(), evaluated(run, np.arange(1.0, len(rows) + 1)))


def evaluated(run: RunDirectory, after_game: NDArray[np.float64]) -> Evaluated | None:
    """Its evaluations, where an axis has the end of each game at `after_game` (n,); None where there were none."""
    lines = [line for line in evaluations(run) if line["games"] <= len(after_game)]
    if not lines:
        return None
    at = [float(after_game[line["games"] - 1]) for line in lines]
    return Evaluated(at, [line["successes"] for line in lines], len(lines[0]["lanes"]))


def _recent_success(won: Sequence[bool]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    so_far = np.array([0, *accumulate(won)])
    games = np.arange(RECENT if len(won) > RECENT else 1, len(won) + 1)
    before = np.maximum(games - RECENT, 0)
    return games, (so_far[games] - so_far[before]) / (games - before)


def draw_over_games(runs: Sequence[RunDirectory], path: Path) -> Path:
    """A curve for each training over its games; those that differ in their seed alone are one band. Returns `path`."""
    alike: dict[str, list[RunDirectory]] = {}
    for run in runs:
        alike.setdefault(json.dumps({**run.config(), "seed": None}, sort_keys=True), []).append(run)
    curves = [games_curve(run, _label(group)) for group in alike.values() for run in group]
    seeds = ", ".join(str(seed) for seed in sorted({run.config()["seed"] for run in runs}))
    timings = sorted({timing_provenance(run.config()["task"]["timing"]) for run in runs})
    return draw_learning_games(curves, path, f"{' and '.join(timings)} · seed {seeds}")


def _label(group: Sequence[RunDirectory]) -> str:
    task = group[0].config()["task"]
    flown_by = f"{command_name(task['command'])} {clock_label(task['clock_speed'])}, {group[0].path.name}"
    return flown_by if len(group) == 1 else f"{flown_by} and {len(group) - 1} more seeds"


def draw_runs(runs: Sequence[RunDirectory], labels: Sequence[str], path: Path) -> Path:
    """A curve for each training, and the paper's real time beside them; returns `path`."""
    curves = [learning_curve(run, label) for run, label in zip(runs, labels, strict=True)]
    seeds = ", ".join(str(seed) for seed in sorted({run.config()["seed"] for run in runs}))
    return draw_learning_curves(curves, path, f"measured, start-up not counted · seed {seeds}", PAPER_S)
