"""DP1's report: the metrics of all cells, Figures 2 to 6, and a table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from functools import cached_property, partial

import joblib

from uavaccel.draw.document import Block, Heading, Paragraph, Picture, Table
from uavaccel.records import arrays_of
from uavaccel.suites.dp1.accuracy import accuracy_figure
from uavaccel.suites.dp1.scores import CellScores, cells_of, score_cells
from uavaccel.suites.dp1.speedup import speedup_figure
from uavaccel.suites.dp1.summary import summarise
from uavaccel.suites.dp1.table import overview, table
from uavaccel.suites.dp1.trajectories import trajectory_figure
from uavaccel.suites.dp1.trellis import trellis_figure
from uavaccel.suites.dp1.velocity import velocity_figure
from uavaccel.suites.report import Report, Summary, Values
from uavaccel.suites.source_line import source_line

PARALLEL_FROM_GAMES = 400  # below, starting worker processes takes longer than the work
MOST_JOBS = 8


class Dp1Report(Report):
    """Beside the summary it writes scores.json: accuracies game by game, for those who pool cells."""

    @cached_property
    def jobs(self) -> int:
        """Processes that compute the metrics; the results do not depend on it."""
        return 1 if len(self.rows) < PARALLEL_FROM_GAMES else min(joblib.cpu_count(), MOST_JOBS)

    @cached_property
    def scores(self) -> list[CellScores]:
        return score_cells(cells_of(self.rows), partial(arrays_of, self.run.path), self.jobs)

    def summarise(self) -> Summary:
        self.run.write_json("scores.json", [_games(score) for score in self.scores])
        return summarise(self.rows, self.scores)

    def title(self) -> str:
        return f"DP1, {self.summary['profile']} profile, seed {self.summary['seed']}"

    def figures(self) -> list[Picture]:
        rows, scores, load = self.rows, self.scores, self.run.load_arrays
        folder = self.run.path / "figures"
        return [
            velocity_figure(rows, load, folder / "figure2_velocity.png"),
            trajectory_figure(scores, load, folder / "figure3_trajectories.png"),
            trellis_figure(self.run.path, rows, folder / "figure4_trellis.png"),
            accuracy_figure(scores, folder / "figure5_accuracy.png"),
            speedup_figure(scores, self.summary, folder / "figure6_speedup.png"),
        ]

    def overview(self) -> Table:
        return overview(self.summary)

    def blocks(self, figures: Sequence[Picture]) -> list[Block]:
        return [
            Paragraph(f"Games: {source_line(self.rows)}."),
            *map(Paragraph, _warnings(self.summary)),
            Heading("Overview: worst cell, range of speeds"),
            self.overview(),
            Paragraph(_READING),
            Heading("Figures"),
            *figures,
            Heading("All cells"),
            table(self.summary),
        ]


def _games(score: CellScores) -> Values:
    return {**asdict(score.cell.key), "stlc": score.stlc, "position_rmse_m": score.position_rmse_m}


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
