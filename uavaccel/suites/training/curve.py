"""The learning curve of a training: games won over the wall clock, from its rows and timing.jsonl."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate
from pathlib import Path

import numpy as np

from uavaccel.draw.learning_curve import LearningCurve, draw_learning_curves
from uavaccel.errors import UserError
from uavaccel.records import RunDirectory
from uavaccel.suites.host_time import running_s
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
    won = np.array([0, *accumulate(row["is_success"] for row in rows)])
    games = np.arange(RECENT if len(rows) > RECENT else 1, len(rows) + 1)
    before = np.maximum(games - RECENT, 0)
    success = (won[games] - won[before]) / (games - before)
    wall_s = np.array(running_s(run))[games - 1]
    return LearningCurve(label, wall_s.tolist(), success.tolist())


def draw_runs(runs: Sequence[RunDirectory], labels: Sequence[str], path: Path) -> Path:
    """A curve for each training, and the paper's real time beside them; returns `path`."""
    curves = [learning_curve(run, label) for run, label in zip(runs, labels, strict=True)]
    seeds = ", ".join(str(seed) for seed in sorted({run.config()["seed"] for run in runs}))
    return draw_learning_curves(curves, path, f"measured, start-up not counted · seed {seeds}", PAPER_S)
