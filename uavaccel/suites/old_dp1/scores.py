"""DP1's scores, the accuracy of every game, which is the part of the report that takes time; and its summary.json.

A cell is all games of one command, ClockSpeed, T_move, number of rounds and timing. Its references are the
run's ADSC games at 1x of the same T_move and rounds (paper, section III-C2a).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass

import numpy as np
from joblib import Parallel, delayed

from uavaccel.metrics.intervals import median_interval
from uavaccel.metrics.speedup import combined_provenance, effective_speedup, speedup_interval, timing_provenance
from uavaccel.metrics.stlc import mean_stlc
from uavaccel.metrics.trajectory import (
    FloatArray,
    Trajectory,
    command_gaps_s,
    distinct,
    duration_error_s,
    mean_position_rmse,
    quartiles,
    trajectory,
)
from uavaccel.suites.old_dp1.flights import Dp1Row
from uavaccel.suites.old_report import Arrays, LoadArrays, Values
from uavaccel.suites.rows import Row, disturbed_games, grouped, subset


@dataclass(frozen=True, order=True)
class CellKey:
    """The conditions that the games of a cell share, ordered as the cells are."""

    command: str
    clock_speed: float
    t_move_s: float
    rounds: int
    timing: str


@dataclass(frozen=True)
class Cell:
    """A cell's finished games and those that they are compared with: each other, where `is_reference`.

    `lockstep_row` is the game without latency on the same path, that of the cell's own command if there are several.
    """

    key: CellKey
    rows: tuple[Dp1Row, ...]
    failed: int
    reference_rows: tuple[Dp1Row, ...]
    lockstep_row: Dp1Row | None
    is_reference: bool


@dataclass(frozen=True)
class CellScores:
    """Scores of a cell's finished games (games,), in the order of `cell.rows`; NaN where there is no reference.

    `stlc` and `position_rmse_m` are means over the references; `command_gap_s` pools the gaps of all games.
    """

    cell: Cell
    stlc: FloatArray
    position_rmse_m: FloatArray
    position_rmse_vs_lockstep_m: FloatArray
    command_gap_s: FloatArray
    distinct_games: int


def cells_of(rows: Sequence[Dp1Row]) -> list[Cell]:
    """Group the rows of role "game" and "reference" into cells, in canonical order.

    Where a cell has references, these are its games, so that ADSC at 1x is not counted twice.
    """
    flown = [row for row in rows if row["role"] in ("game", "reference")]
    return [_cell(key, members, rows) for key, members in sorted(grouped(flown, _key_of).items())]


def _key_of(row: Dp1Row) -> CellKey:
    speeds = float(row["clock_speed"]), float(row["t_move_s"])
    return CellKey(row["command"], *speeds, row["rounds"], row["timing"])


def score_cells(cells: Sequence[Cell], load_arrays: LoadArrays, jobs: int = 1) -> list[CellScores]:
    """Return the scores of all cells, in their order; they do not depend on `jobs`, the number of processes."""
    if jobs == 1:
        return [score_cell(cell, load_arrays) for cell in cells]
    longest_first = sorted(cells, key=lambda cell: -sum(row["duration_s"] for row in cell.rows))
    scored = Parallel(n_jobs=jobs, batch_size=1)(
        delayed(score_cell)(cell, load_arrays) for cell in longest_first
    )
    return sorted(scored, key=lambda score: score.cell.key)


def score_cell(cell: Cell, load_arrays: LoadArrays) -> CellScores:
    """Return the scores of one cell. Raises whatever `load_arrays` raises."""
    arrays = [load_arrays(row) for row in cell.rows]
    games = [_flight(a) for a in arrays]
    unknown = np.full(len(games), np.nan)
    stlc, rmse_m, lockstep_rmse_m = unknown, unknown, unknown
    if cell.reference_rows and games:
        references = (
            games if cell.is_reference else [_flight(load_arrays(row)) for row in cell.reference_rows]
        )
        stlc = mean_stlc(games, references, cell.is_reference)
        rmse_m = mean_position_rmse(games, references, cell.is_reference)
    if cell.lockstep_row is not None and games:
        lockstep_rmse_m = mean_position_rmse(games, [_flight(load_arrays(cell.lockstep_row))])
    gaps = [command_gaps_s(a["command_start_s"], a["command_end_s"]) for a in arrays]
    gap_s = np.concatenate(gaps) if gaps else np.empty(0)
    return CellScores(cell, stlc, rmse_m, lockstep_rmse_m, gap_s, len(distinct(games)[0]))


def _cell(key: CellKey, cell_rows: Sequence[Dp1Row], rows: Sequence[Dp1Row]) -> Cell:
    same_path = [row for row in rows if row["t_move_s"] == key.t_move_s and row["rounds"] == key.rounds]
    references = _finished(row for row in same_path if row["role"] == "reference")
    own_references = [row for row in cell_rows if row["role"] == "reference"]
    members = own_references or cell_rows
    finished = _finished(members)
    lockstep = _finished(row for row in same_path if row["role"] == "lockstep")
    own_lockstep = [row for row in lockstep if row["command"] == key.command]
    ideal = next(iter(own_lockstep or lockstep), None)
    return Cell(key, finished, len(members) - len(finished), references, ideal, bool(own_references))


def _finished(rows: Iterable[Dp1Row]) -> tuple[Dp1Row, ...]:
    """Return the rows of games that ended without an error, by game."""
    return tuple(sorted((row for row in rows if row.get("error") is None), key=lambda row: row["game"]))


def _flight(arrays: Arrays) -> Trajectory:
    return trajectory(arrays["time_s"], arrays["position_m"])


def rows_of(scores: Sequence[CellScores]) -> list[Dp1Row]:
    return [row for score in scores for row in score.cell.rows]


def summarise(rows: Sequence[Dp1Row], scores: Sequence[CellScores]) -> Values:
    """Summarise a run's rows and the scores of their cells.

    Accuracies are medians over games of each game's mean over the references; a reference is not compared with itself.
    Durations and wall times are compared with the references' means. Intervals are 95 % bootstrap intervals over games.
    Numbers that cannot be known (no reference in the run, a lone reference) are None. Raises ValueError without rows.
    """
    if not rows:
        raise ValueError("a summary needs at least one row")
    seed = int(rows[0]["seed"])
    cells = [_cell_summary(score, seed) for score in scores]
    return {"suite": "dp1", "profile": rows[0]["profile"], "seed": seed, "cells": cells}


def _cell_summary(score: CellScores, seed: int) -> Values:
    cell, key = score.cell, score.cell.key
    head = {
        **asdict(key),
        "games": len(cell.rows),
        "failed_games": cell.failed,
        "distinct_games": score.distinct_games,
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
        **subset(first, "command", "timing"),
        "clock_speed": float(first["clock_speed"]),
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
    durations_s = [_column(rows, "duration_s") for rows in (cell.reference_rows, cell.rows)]
    compared = cell.rows and cell.reference_rows
    return {
        "duration_error_s": float(np.median(duration_error_s(*durations_s))) if compared else None,
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
        "lost_wall_s": float(np.sum([row.get("lost_wall_s", 0.0) for row in rows])) if rows else None,
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
    return list(median_interval(values, seed)) if values.size and np.isfinite(values).all() else None
