"""An ablation's report: accuracy and speed-up of each command and ClockSpeed under every variant."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence

import numpy as np

from uavaccel.draw import style
from uavaccel.draw.document import Block, Paragraph, Picture, Table, or_dash
from uavaccel.draw.style import clock_label, command_name
from uavaccel.suites.ablation.variants import curves, plot_variants
from uavaccel.suites.dp1 import summary as dp1_summary
from uavaccel.suites.dp1.scores import CellScores, cells_of, score_cells
from uavaccel.suites.report import Report, Summary, SummaryCell, Values, number
from uavaccel.suites.source_line import source_line

GOAL_TIMEOUT_S = 0.063  # AirSim's, on its 3 ms grid


class AblationReport(Report):
    """Of `uavaccel run ablation`."""

    def summarise(self) -> Summary:
        entries: list[Values] = []
        for variant in self.config["variants"]:
            own = [row for row in self.rows if row["variant"] == variant["name"]]
            if own:
                scores = score_cells(cells_of(own), self.run.load_arrays)
                entries += summarise(variant["name"], scores, dp1_summary.summarise(own, scores)["cells"])
        title, seed = self.title(), self.config["seed"]
        return {"suite": "ablation", "title": title, "seed": seed, "entries": entries}

    def title(self) -> str:
        return str(self.config["title"])

    def figures(self) -> list[Picture]:
        drawn = curves(self.summary["entries"], self.config["times_clock_speed"])
        source, path = source_line(self.rows), self.run.file("figures/ablation.png")
        style.save(plot_variants(drawn, self.config["axis"], self.title(), source), path)
        return [Picture(path, f"{self.title()}. {_READING} Source: {source}.")]

    def overview(self) -> Table:
        return table(self.summary)

    def blocks(self, figures: Sequence[Picture]) -> list[Block]:
        return [self.overview(), Paragraph(_READING), *figures]


def summarise(variant: str, scores: Sequence[CellScores], cells: Sequence[SummaryCell]) -> list[Values]:
    """An entry a command and ClockSpeed: games of all T_moves and rounds pooled, games without latency left out.

    The speed-up is the mean over the T_moves of the most rounds, as the paper averages it.
    """
    pooled: dict[tuple[str, float], list[CellScores]] = defaultdict(list)
    for score in scores:
        if score.cell.key.timing != "lockstep":
            pooled[score.cell.key.command, score.cell.key.clock_speed].append(score)
    entries = []
    for (command, clock_speed), members in pooled.items():
        stlc = np.concatenate([member.stlc for member in members])
        rmse_m = np.concatenate([member.position_rmse_m for member in members])
        gap_s = np.concatenate([member.command_gap_s for member in members])
        most = max(member.cell.key.rounds for member in members)
        speedups = [
            cell["effective_speedup"]
            for cell in cells
            if (cell["command"], cell["clock_speed"], cell["rounds"]) == (command, clock_speed, most)
            and cell["timing"] != "lockstep"
        ]
        known = stlc[np.isfinite(stlc)]
        entries.append(
            {
                "variant": variant,
                "command": command,
                "clock_speed": clock_speed,
                "games": len(stlc),
                "failed_games": sum(member.cell.failed for member in members),
                "stlc_quartiles": [float(q) for q in np.quantile(known, (0.25, 0.5, 0.75))]
                if known.size
                else None,
                "position_rmse_m_median": float(np.nanmedian(rmse_m)) if known.size else None,
                "effective_speedup": float(np.mean(speedups)) if None not in speedups and speedups else None,
                "share_beyond_goal_timeout": float(np.mean(gap_s > GOAL_TIMEOUT_S + 1e-9))
                if gap_s.size
                else None,
            }
        )
    return entries


def table(summary: Summary) -> Table:
    """A row for each variant, command and ClockSpeed; what cannot be known is "-"."""
    return Table.of(
        summary["entries"],
        ("variant", lambda entry: str(entry["variant"])),
        ("command", lambda entry: command_name(entry["command"])),
        ("ClockSpeed", lambda entry: clock_label(entry["clock_speed"])),
        ("games", lambda entry: str(entry["games"]) + _failed(entry)),
        ("STLC median [q25, q75]", lambda entry: or_dash(entry["stlc_quartiles"], _quartiles)),
        number("RMSE median, m", "position_rmse_m_median", "{:.3f}"),
        number("effective speed-up", "effective_speedup", "{:.2f}"),
        number("gaps beyond the goal timeout", "share_beyond_goal_timeout", "{:.0%}"),
    )


def _failed(entry: SummaryCell) -> str:
    return f" ({entry['failed_games']} failed)" if entry["failed_games"] else ""


def _quartiles(stlc: Sequence[float]) -> str:
    low, median, high = stlc
    return f"{median:.3f} [{low:.3f}, {high:.3f}]"


_READING = (
    "STLC and position error against ADSC at 1x under the same variant: medians over games, T_moves and rounds pooled; "
    "effective speed-up: its mean over the T_moves of the most rounds."
)
