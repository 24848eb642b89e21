"""DP1's report: summary.json, figures, report.md and report.html of a finished run."""

from __future__ import annotations

from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import joblib

from uavaccel.draw.document import Block, Heading, Paragraph, Picture, Table
from uavaccel.records import RunDirectory, arrays_of
from uavaccel.suites.dp1 import figures
from uavaccel.suites.dp1.scores import CellScores, LoadArrays, Row, cells_of, score_cells
from uavaccel.suites.dp1.summary import summary_of
from uavaccel.suites.dp1.table import HEADER, OVERVIEW_HEADER, overview, table
from uavaccel.suites.pages import finished_rows, write_pages

__all__ = ["HEADER", "table", "write_report"]

PARALLEL_FROM_GAMES = 400  # below, starting worker processes takes longer than the work
MOST_JOBS = 8

Summary = dict[str, Any]


def write_report(run: RunDirectory, jobs: int | None = None) -> Summary:
    """Write summary.json, figures/*.png, report.md and report.html into a DP1 run; returns the summary.

    `jobs` processes compute the metrics, by default one for a small run and otherwise one per core; the
    results do not depend on it. Raises UserError if the folder holds no DP1 run, no finished game, or damaged
    files.
    """
    rows: list[Row] = list(finished_rows(run, "dp1"))
    load_arrays = partial(arrays_of, run.path)
    scores = score_cells(cells_of(rows), load_arrays, jobs or _default_jobs(rows))
    summary = summary_of(rows, scores)
    run.write_json("summary.json", summary)
    run.write_json("scores.json", _games(scores))
    pictures = _draw(run.path, rows, scores, summary, load_arrays)
    title = f"DP1, {summary['profile']} profile, seed {summary['seed']}"
    blocks = _blocks(run, rows, summary, pictures)
    write_pages(run, title, blocks)
    return summary


def _games(scores: list[CellScores]) -> list[dict[str, Any]]:
    """Accuracies game by game, for those who pool cells."""
    return [
        {**asdict(score.cell.key), "stlc": score.stlc, "position_rmse_m": score.position_rmse_m}
        for score in scores
    ]


def _default_jobs(rows: list[Row]) -> int:
    return 1 if len(rows) < PARALLEL_FROM_GAMES else min(joblib.cpu_count(), MOST_JOBS)


def _draw(
    run_dir: Path, rows: list[Row], scores: list[CellScores], summary: Summary, load_arrays: LoadArrays
) -> list[Picture]:
    folder = run_dir / "figures"
    return [
        figures.velocity_figure(rows, load_arrays, folder / "figure2_velocity.png"),
        figures.trajectory_figure(scores, load_arrays, folder / "figure3_trajectories.png"),
        figures.trellis_figure(run_dir, rows, folder / "figure4_trellis.png"),
        figures.accuracy_figure(scores, folder / "figure5_accuracy.png"),
        figures.speedup_figure(scores, summary, folder / "figure6_speedup.png"),
    ]


def _blocks(run: RunDirectory, rows: list[Row], summary: Summary, pictures: list[Picture]) -> list[Block]:
    return [
        Paragraph(f"Games: {figures.source_line(rows)}."),
        *map(Paragraph, _warnings(summary)),
        Heading("Overview: worst cell, range of speeds"),
        Table(OVERVIEW_HEADER, overview(summary)),
        Paragraph(_READING),
        Heading("Figures"),
        *pictures,
        Heading("All cells"),
        Table(HEADER, table(summary), folded=f"{len(summary['cells'])} cells"),
    ]


def _warnings(summary: Summary) -> list[str]:
    cells = summary["cells"]
    failed = sum(cell["failed_games"] for cell in cells)
    lost_s = sum(cell["lost_wall_s"] or 0.0 for cell in cells)
    warnings = []
    if failed:
        warnings.append(f"Warning: {failed} games failed and are left out; rows.jsonl says why.")
    if lost_s:
        warnings.append(f"Warning: the machine could not keep up and lost {lost_s:.3f} s of wall time.")
    if disturbed := sum(cell.get("disturbed_games", 0) for cell in cells):
        warnings.append(
            f"Warning: {disturbed} games were disturbed: they lost wall time, or their server stalled or was started "
            "again; rows.jsonl says which."
        )
    if any(cell["reference"] is None for cell in cells):
        warnings.append("Warning: some cells have no real-time ADSC games to compare with.")
    return warnings


_READING = (
    "STLC (lambda 0.5, metres, seconds) is 2 for identical flights; above 1.8 they look alike. It matches "
    "places and times independently and cannot see a lap too few or too late, so the position error at equal "
    "times (RMSE, m) stands beside it. A game's accuracy is its mean over all reference games, ADSC at 1x of "
    "the same T_move and rounds; a reference is not compared with itself. Medians, quartiles and 95 % "
    "bootstrap intervals are over games. Effective speed-up is the ratio of mean wall times for the same "
    "commands. Measured: the machine's clock. Modelled: a simulated clock. Mixed: a measured game over a "
    "modelled baseline. Native TCSC games of one cell are identical by construction, and ADSC games at 1x "
    "nearly so."
)
