"""DP1's summary.json: an entry for each cell, from its rows and scores."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from uavaccel.metrics.intervals import median_interval
from uavaccel.metrics.speedup import (
    combined_provenance,
    effective_speedup,
    speedup_interval,
    timing_provenance,
)
from uavaccel.metrics.trajectory import duration_error_s, quartiles
from uavaccel.suites.dp1.flights import Dp1Row
from uavaccel.suites.dp1.scores import Cell, CellScores
from uavaccel.suites.report import Values
from uavaccel.suites.rows import Row, disturbed_games


def summarise(rows: Sequence[Dp1Row], scores: Sequence[CellScores]) -> Values:
    """Summarise a run's rows and the scores of their cells.

    Accuracies are medians over games of each game's mean over the references; a reference is not compared with itself.
    Durations and wall times are compared with the references' means. Intervals are 95 % bootstrap intervals over games.
    Numbers that cannot be known (no reference in the run, a lone reference) are None. Raises ValueError without rows.
    """
    if not rows:
        raise ValueError("a summary needs at least one row")
    seed = int(rows[0]["seed"])
    return {
        "suite": "dp1",
        "profile": rows[0]["profile"],
        "seed": seed,
        "cells": [_cell_summary(score, seed) for score in scores],
    }


def _cell_summary(score: CellScores, seed: int) -> Values:
    cell, key = score.cell, score.cell.key
    head = {
        "command": key.command,
        "clock_speed": key.clock_speed,
        "t_move_s": key.t_move_s,
        "rounds": key.rounds,
        "games": len(cell.rows),
        "failed_games": cell.failed,
        "distinct_games": score.distinct_games,
        "timing": key.timing,
        "provenance": timing_provenance(key.timing),
        "seed": seed,
        "reference": _reference(cell),
    }
    if disturbed := disturbed_games(cell.rows):
        head["disturbed_games"] = disturbed
    return head | _accuracy(score, seed) | _durations(score) | _speed(cell, seed)


def _reference(cell: Cell) -> Values | None:
    if not cell.reference_rows:
        return None
    first = cell.reference_rows[0]
    return {
        "command": first["command"],
        "clock_speed": float(first["clock_speed"]),
        "timing": first["timing"],
        "provenance": timing_provenance(first["timing"]),
        "games": len(cell.reference_rows),
        "is_this_cell": cell.is_reference,
    }


def _accuracy(score: CellScores, seed: int) -> Values:
    q25, median, q75 = _quartiles(score.stlc)
    return {
        "stlc_median": median,
        "stlc_q25": q25,
        "stlc_q75": q75,
        "stlc_median_interval": _interval(score.stlc, seed),
        "position_rmse_m": _quartiles(score.position_rmse_m)[1],
        "position_rmse_interval_m": _interval(score.position_rmse_m, seed),
        "position_rmse_vs_lockstep_m": _quartiles(score.position_rmse_vs_lockstep_m)[1],
    }


def _durations(score: CellScores) -> Values:
    cell, gaps = score.cell, score.command_gap_s
    error_s = None
    if cell.rows and cell.reference_rows:
        errors_s = duration_error_s(
            _column(cell.reference_rows, "duration_s"), _column(cell.rows, "duration_s")
        )
        error_s = float(np.median(errors_s))
    return {
        "duration_error_s": error_s,
        "command_gap_median_s": float(np.median(gaps)) if gaps.size else None,
        "command_gap_q95_s": float(np.quantile(gaps, 0.95)) if gaps.size else None,
    }


def _speed(cell: Cell, seed: int) -> Values:
    rows = cell.rows
    speed: Values = {
        "effective_speedup": None,
        "effective_speedup_interval": None,
        "effective_speedup_provenance": None,
        "real_time_factor": float(np.mean(_column(rows, "real_time_factor"))) if rows else None,
        "lost_wall_s": float(np.sum(_column(rows, "lost_wall_s"))) if rows else None,
    }
    if rows and cell.reference_rows:
        baseline, wall_s = _column(cell.reference_rows, "wall_s"), _column(rows, "wall_s")
        timings = (rows[0]["timing"], cell.reference_rows[0]["timing"])
        speed["effective_speedup"] = effective_speedup(baseline, wall_s)
        if not cell.is_reference:  # the baseline over itself is 1 by definition
            speed["effective_speedup_interval"] = list(speedup_interval(baseline, wall_s, seed))
        speed["effective_speedup_provenance"] = combined_provenance(*map(timing_provenance, timings))
    return speed


def _column(rows: Sequence[Row], name: str) -> np.ndarray:
    return np.array([float(row[name]) for row in rows])


def _quartiles(values: np.ndarray) -> tuple[float | None, float | None, float | None]:
    if values.size == 0 or np.isnan(values).any():
        return None, None, None
    return quartiles(values)


def _interval(values: np.ndarray, seed: int) -> list[float] | None:
    if values.size == 0 or not all(map(math.isfinite, values)):
        return None
    return list(median_interval(values, seed))
