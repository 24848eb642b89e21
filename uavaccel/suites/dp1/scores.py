"""DP1's scores: the accuracy of every game, cell by cell, which is the part of the report that takes time.

A cell is all games of one command, ClockSpeed, T_move, number of rounds and timing. Its references are the
run's ADSC games at 1x of the same T_move and rounds (paper, section III-C2a).
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from joblib import Parallel, delayed

from uavaccel.metrics.stlc import mean_stlc
from uavaccel.metrics.trajectory import (
    FloatArray,
    Trajectory,
    command_gaps_s,
    distinct,
    mean_position_rmse,
    trajectory,
)
from uavaccel.suites.dp1.flights import Dp1Row
from uavaccel.suites.report import Arrays, LoadArrays


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
    """A cell's finished games and those that they are compared with: each other, where `is_reference`."""

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
    grouped: dict[CellKey, list[Dp1Row]] = defaultdict(list)
    for row in rows:
        if row["role"] in ("game", "reference"):
            speeds = float(row["clock_speed"]), float(row["t_move_s"])
            grouped[CellKey(row["command"], *speeds, row["rounds"], row["timing"])].append(row)
    return [_cell(key, grouped[key], rows) for key in sorted(grouped)]


def score_cells(cells: Sequence[Cell], load_arrays: LoadArrays, jobs: int = 1) -> list[CellScores]:
    """Return the scores of all cells, in their order; they do not depend on `jobs`, the number of processes."""
    if jobs == 1:
        return [score_cell(cell, load_arrays) for cell in cells]
    longest_first = sorted(range(len(cells)), key=lambda i: -sum(row["duration_s"] for row in cells[i].rows))
    scored = Parallel(n_jobs=jobs, batch_size=1)(
        delayed(score_cell)(cells[i], load_arrays) for i in longest_first
    )
    in_order = dict(zip(longest_first, scored, strict=True))
    return [in_order[i] for i in range(len(cells))]


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
    return Cell(
        key,
        finished,
        len(members) - len(finished),
        references,
        _lockstep_row(same_path, key.command),
        is_reference=bool(own_references),
    )


def _finished(rows: Iterable[Dp1Row]) -> tuple[Dp1Row, ...]:
    """Return the rows of games that ended without an error, by game."""
    return tuple(sorted((row for row in rows if row.get("error") is None), key=lambda row: row["game"]))


def _lockstep_row(rows: Sequence[Dp1Row], command: str) -> Dp1Row | None:
    """Return the game without latency on the same path, that of the cell's own command if there are several."""
    lockstep = _finished(row for row in rows if row["role"] == "lockstep")
    own = [row for row in lockstep if row["command"] == command]
    return next(iter(own or lockstep), None)


def _flight(arrays: Arrays) -> Trajectory:
    return trajectory(arrays["time_s"], arrays["position_m"])


def rows_of(scores: Sequence[CellScores]) -> list[Dp1Row]:
    """Return the rows of all games of these cells."""
    return [row for score in scores for row in score.cell.rows]
