"""DP1's report: tables, Figures 2 to 6, and warnings."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict
from functools import cached_property, partial
from operator import itemgetter

import joblib

from uavaccel.draw.document import Block, Heading, Paragraph, Picture, Table, or_dash
from uavaccel.draw.style import clock_label, command_name
from uavaccel.records import arrays_of
from uavaccel.suites.old_dp1.cell_figures import SIMILAR_STLC, accuracy_figure, speedup_figure
from uavaccel.suites.old_dp1.flight_figures import trajectory_figure, velocity_figure
from uavaccel.suites.old_dp1.scores import CellScores, cells_of, score_cells, summarise
from uavaccel.suites.old_dp1.trellis import trellis_figure
from uavaccel.suites.old_report import Report, Summary, SummaryCell, number
from uavaccel.suites.provenance import source_line
from uavaccel.suites.rows import grouped


def table(summary: Summary) -> Table:
    """Return the table of all cells, with "-" for numbers that cannot be known."""
    return Table.of(
        summary["cells"],
        ("command", lambda cell: command_name(cell["command"])),
        ("clock", lambda cell: clock_label(cell["clock_speed"])),
        ("T_move s", lambda cell: f"{cell['t_move_s']:g}"),
        ("rounds", lambda cell: str(cell["rounds"])),
        ("games", lambda cell: games_text(cell) + _disturbed([cell])),
        ("STLC median [q25, q75]", _stlc),
        ("RMSE m", lambda cell: or_dash(cell["position_rmse_m"], _metres)),
        ("v. lockstep", lambda cell: or_dash(cell["position_rmse_vs_lockstep_m"], _metres)),
        ("duration s", lambda cell: or_dash(cell["duration_error_s"], _seconds)),
        ("speed-up", lambda cell: or_dash(cell["effective_speedup"], "{:.2f}".format) + _mixed(cell)),
        number("achieved", "real_time_factor", "{:.2f}"),
        ("source", lambda cell: str(cell["provenance"])),
        folded=f"{len(summary['cells'])} cells",
    )


def overview(summary: Summary) -> Table:
    """Return a table of each command, ClockSpeed and timing: the worst cell, and the range of speeds."""
    groups = grouped(summary["cells"], itemgetter("command", "clock_speed", "timing"))
    worst_m = "position_rmse_m", "position_rmse_vs_lockstep_m"
    return Table.of(
        list(groups.values()),
        ("command", lambda cells: command_name(cells[0]["command"])),
        ("ClockSpeed", lambda cells: clock_label(cells[0]["clock_speed"])),
        ("games", lambda cells: str(sum(cell["games"] for cell in cells)) + _disturbed(cells)),
        ("lowest STLC median", lambda cells: or_dash(_extreme(min, cells, "stlc_median"), "{:.4f}".format)),
        ("largest RMSE v. reference, m", lambda cells: or_dash(_extreme(max, cells, worst_m[0]), _metres)),
        ("largest RMSE v. lockstep, m", lambda cells: or_dash(_extreme(max, cells, worst_m[1]), _metres)),
        ("effective speed-up", lambda cells: _range(cells, "effective_speedup") + _mixed(cells[0])),
        ("real-time factor", lambda cells: _range(cells, "real_time_factor")),
        ("source", lambda cells: str(cells[0]["provenance"])),
    )


def verdict(summary: Summary) -> str:
    """Return each command's likeness to real time, error and speed-up in a sentence.

    Cells in lockstep are left out, unless there are no others.
    """
    cells = [cell for cell in summary["cells"] if cell["timing"] != "lockstep"] or summary["cells"]
    compared = [cell for cell in cells if cell["clock_speed"] > 1 and cell["stlc_median"] is not None]
    if not compared:
        return f"{sum(cell['games'] for cell in cells)} games, none of them accelerated and comparable with real time"
    commands = sorted({cell["command"] for cell in compared})
    said = [_command_verdict([cell for cell in compared if cell["command"] == name]) for name in commands]
    return f"{'; '.join(said)} ({' and '.join(sorted({cell['provenance'] for cell in compared}))})"


def _command_verdict(cells: Sequence[SummaryCell]) -> str:
    clocks = sorted({cell["clock_speed"] for cell in cells})
    unlike = {cell["clock_speed"] for cell in cells if cell["stlc_median"] <= SIMILAR_STLC}
    alike = [clock for clock in clocks if clock < min(unlike, default=math.inf)]
    likeness = (
        f"flies as in real time up to {clock_label(alike[-1])}"
        if alike
        else f"no longer flies as in real time at {clock_label(clocks[0])}"
    )
    fastest = [cell for cell in cells if cell["clock_speed"] == clocks[-1]]
    error = or_dash(_extreme(max, fastest, "position_rmse_m"), _metres)
    return (
        f"{command_name(cells[0]['command'])} {likeness} (STLC above {SIMILAR_STLC:g}); at {clock_label(clocks[-1])} "
        f"it is up to {error} m off (RMSE) and {_range(fastest, 'effective_speedup')} times as fast"
    )


def games_text(cell: SummaryCell) -> str:
    """Return the number of games of a cell, with that of the failed ones: "18 (2 failed)"."""
    return str(cell["games"]) + (f" ({cell['failed_games']} failed)" if cell["failed_games"] else "")


def _stlc(cell: SummaryCell) -> str:
    known = cell["stlc_median"] is not None
    return "{stlc_median:.3f} [{stlc_q25:.3f}, {stlc_q75:.3f}]".format_map(cell) if known else "-"


def _disturbed(cells: Sequence[SummaryCell]) -> str:
    """Mark cells with games that lost wall time, or whose server stalled or was started again."""
    count = sum(cell.get("disturbed_games", 0) for cell in cells)
    return f" ({count} disturbed)" if count else ""


def _mixed(cell: SummaryCell) -> str:
    """Mark a speed-up of which one wall time is measured and the other modelled."""
    return " (mixed)" if cell["effective_speedup_provenance"] == "mixed" else ""


def _extreme(
    choose: Callable[[Iterable[float]], float], cells: Sequence[SummaryCell], key: str
) -> float | None:
    values = [cell[key] for cell in cells if cell[key] is not None]
    return choose(values) if values else None


def _range(cells: Sequence[SummaryCell], key: str) -> str:
    low, high = (or_dash(_extreme(choose, cells, key), "{:.2f}".format) for choose in (min, max))
    return low if low == high else f"{low} to {high}"


def _seconds(error_s: float) -> str:
    return f"{error_s:+.3f}".replace("-0.000", "+0.000")


def _metres(value: float) -> str:
    """Format with a few significant digits, as errors range from micrometres to metres; only an exact 0 is "0"."""
    if value == 0:
        return "0"
    return f"{value:.3f}" if value >= 0.01 else f"{value:.1e}"


PARALLEL_FROM_GAMES = 400  # below, starting worker processes takes longer than the work
MOST_JOBS = 8


class Dp1Report(Report):
    """DP1's report. Beside the summary it writes scores.json, the accuracy of each game, to pool cells from."""

    @cached_property
    def jobs(self) -> int:
        """The number of processes that compute the metrics; the results do not depend on it."""
        return 1 if len(self.rows) < PARALLEL_FROM_GAMES else min(joblib.cpu_count(), MOST_JOBS)

    @cached_property
    def scores(self) -> list[CellScores]:
        return score_cells(cells_of(self.rows), partial(arrays_of, self.run.path, form=self.run.form), self.jobs)

    def summarise(self) -> Summary:
        by_cell = [
            {**asdict(score.cell.key), "stlc": score.stlc, "position_rmse_m": score.position_rmse_m}
            for score in self.scores
        ]
        self.run.write_json("scores.json", by_cell)
        return summarise(self.rows, self.scores)

    def title(self) -> str:
        return f"DP1, {self.summary['profile']} profile, seed {self.summary['seed']}"

    def figures(self) -> list[Picture]:
        rows, scores, load = self.rows, self.scores, self.run.load_arrays
        folder = self.run.file("figures")
        return [
            velocity_figure(rows, load, folder / "figure2_velocity.png"),
            trajectory_figure(scores, load, folder / "figure3_trajectories.png"),
            trellis_figure(self.run.path, rows, folder / "figure4_trellis.png"),
            accuracy_figure(scores, folder / "figure5_accuracy.png"),
            speedup_figure(scores, self.summary, folder / "figure6_speedup.png"),
        ]

    def headline(self) -> str:
        return verdict(self.summary)

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
    "modelled baseline. The real-time factor is the simulated time of a game over its wall time: it stays at the "
    "ClockSpeed as long as the simulation keeps up, since with ADSC the drone flies on while the client reacts, and "
    "that time counts too. The effective speed-up compares wall times for the same commands: at T_move 0.1 s and a "
    "ClockSpeed of 50 a command lasts 2 ms of wall time, to which its messages add what no ClockSpeed shortens. The "
    "shorter the T_move, the further the speed-up falls short of the real-time factor. Native TCSC games of one cell "
    "are identical by construction, and ADSC games at 1x nearly so."
)
