"""The report of an ablation: accuracy and speed-up of each command and ClockSpeed under every variant."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from operator import itemgetter

import numpy as np
from matplotlib.figure import Figure

from uavaccel.draw import style
from uavaccel.draw.document import Block, Paragraph, Picture, Table, or_dash
from uavaccel.draw.style import clock_label, command_at_clock, command_name
from uavaccel.metrics.trajectory import quartiles
from uavaccel.suites.old_dp1.cell_figures import SIMILAR_STLC
from uavaccel.suites.old_dp1.report import games_text
from uavaccel.suites.old_dp1.scores import CellScores, cells_of, score_cells
from uavaccel.suites.old_dp1.scores import summarise as summarise_dp1
from uavaccel.suites.old_report import Report, Summary, SummaryCell, Values, number
from uavaccel.suites.provenance import source_line
from uavaccel.suites.rows import grouped

_LINES = {"adsc": "-", "tcsc": "--"}
SETTING = itemgetter("command", "clock_speed")
LABELS = {
    "stlc": "STLC, median",
    "position_rmse_m": "position error, m (RMSE, median)",
    "speedup": "effective speed-up",
}


@dataclass(frozen=True)
class VariantCurve:
    """A command at a ClockSpeed: the variants' places on the axis, numbers or names, and their values (variants,)."""

    command: str
    clock_speed: float
    places: Sequence[float | str]
    stlc: np.ndarray
    position_rmse_m: np.ndarray
    speedup: np.ndarray


def curves(entries: Sequence[SummaryCell], times_clock_speed: bool) -> list[VariantCurve]:
    """Return a curve for each command and ClockSpeed; values without a reference are NaN."""
    return [
        VariantCurve(
            command,
            clock_speed,
            [_place(entry["variant"], clock_speed if times_clock_speed else 1.0) for entry in own],
            np.array([(entry["stlc_quartiles"] or [np.nan] * 3)[1] for entry in own], float),
            np.array([entry["position_rmse_m_median"] for entry in own], float),
            np.array([entry["effective_speedup"] for entry in own], float),
        )
        for (command, clock_speed), own in sorted(grouped(entries, SETTING).items())
    ]


def _place(name: str, factor: float) -> float | str:
    try:
        return float(name) * factor
    except ValueError:
        return name


def plot_variants(curves: Sequence[VariantCurve], axis: str, title: str, source: str) -> Figure:
    """Plot STLC, position error and speed-up in three panels; places that are numbers are on a logarithmic axis."""
    places = [place for curve in curves for place in curve.places]
    numbers, names = (
        [each for each in places if isinstance(each, float)],
        list(dict.fromkeys(map(str, places))),
    )
    numeric = len(numbers) == len(places)
    with style.project_style():
        figure = style.new_figure(12, 4.2, title, source)
        panels = figure.subplots(1, 3)
        clocks = sorted({curve.clock_speed for curve in curves})
        for axes, (name, label) in zip(panels, LABELS.items(), strict=True):
            for curve in curves:
                x = [place if numeric else names.index(str(place)) for place in curve.places]
                colour = style.colour(clocks.index(curve.clock_speed))
                text = f"{style.command_name(curve.command)} {style.clock_label(curve.clock_speed)}"
                line: style.LineStyle = {"marker": "o", "markersize": 4, "color": colour, "label": text}
                axes.plot(x, getattr(curve, name), _LINES.get(curve.command, ":"), **line)
            axes.set(ylabel=label, xlabel=axis)
            above = [place for place in numbers if place > 0]
            if not numeric:
                axes.set_xticks(range(len(names)), names, rotation=20, ha="right")
            elif above and max(above) / min(above) > 20:
                axes.set_xscale("symlog", linthresh=min(above))
        panels[0].axhline(SIMILAR_STLC, color="#C00000", linewidth=1.0, zorder=1)
        panels[2].set_yscale("log")
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside right center", fontsize=7.5)
        return figure


GOAL_TIMEOUT_S = 0.063  # AirSim's, on its 3 ms grid


class AblationReport(Report):
    """The report of `uavaccel run ablation`."""

    def summarise(self) -> Summary:
        entries: list[Values] = []
        for variant in self.config["variants"]:
            own = [row for row in self.rows if row["variant"] == variant["name"]]
            if own:
                scores = score_cells(cells_of(own), self.run.load_arrays)
                entries += summarise(variant["name"], scores, summarise_dp1(own, scores)["cells"])
        title, seed = self.title(), self.config["seed"]
        return {"suite": "ablation", "title": title, "seed": seed, "entries": entries}

    def title(self) -> str:
        return str(self.config["title"])

    def figures(self) -> list[Picture]:
        by_setting = curves(self.summary["entries"], self.config["times_clock_speed"])
        source, path = source_line(self.rows), self.run.file("figures/ablation.png")
        figure = plot_variants(by_setting, self.config["axis"], self.title(), source)
        return [style.picture(figure, path, f"{self.title()}. {_READING}", source)]

    def headline(self) -> str:
        entries = [entry for entry in self.summary["entries"] if entry["stlc_quartiles"]]
        if not entries:
            return "no variant has games to compare"
        fastest = max(entry["clock_speed"] for entry in entries)
        by_stlc = sorted(entries, key=lambda entry: float(entry["stlc_quartiles"][1]))
        compared = sorted(grouped(by_stlc, SETTING).items())
        return "; ".join(_between(own[0], own[-1]) for (_, clock), own in compared if clock == fastest)

    def overview(self) -> Table:
        return table(self.summary)

    def blocks(self, figures: Sequence[Picture]) -> list[Block]:
        return [self.overview(), Paragraph(_READING), *figures]


def summarise(variant: str, scores: Sequence[CellScores], cells: Sequence[SummaryCell]) -> list[Values]:
    """Return an entry for each command and ClockSpeed, with the games of all T_moves and rounds pooled.

    Games in lockstep are left out. The speed-up is the mean over the T_moves of the most rounds, as in the paper.
    """
    accelerated = [score for score in scores if score.cell.key.timing != "lockstep"]
    pooled = grouped(accelerated, lambda score: (score.cell.key.command, score.cell.key.clock_speed))
    entries = []
    for (command, clock_speed), members in pooled.items():
        stlc = np.concatenate([member.stlc for member in members])
        rmse_m = np.concatenate([member.position_rmse_m for member in members])
        gap_s = np.concatenate([member.command_gap_s for member in members])
        most = max(member.cell.key.rounds for member in members)
        speedups = [
            cell["effective_speedup"]
            for cell in cells
            if (*SETTING(cell), cell["rounds"]) == (command, clock_speed, most)
            and cell["timing"] != "lockstep"
        ]
        known = stlc[np.isfinite(stlc)]
        beyond = float(np.mean(gap_s > GOAL_TIMEOUT_S + 1e-9)) if gap_s.size else None
        entries.append(
            {
                "variant": variant,
                "command": command,
                "clock_speed": clock_speed,
                "games": len(stlc),
                "failed_games": sum(member.cell.failed for member in members),
                "stlc_quartiles": list(quartiles(known)) if known.size else None,
                "position_rmse_m_median": float(np.nanmedian(rmse_m)) if known.size else None,
                "effective_speedup": float(np.mean(speedups)) if None not in speedups and speedups else None,
                "share_beyond_goal_timeout": beyond,
            }
        )
    return entries


def table(summary: Summary) -> Table:
    """Return a table of each variant, command and ClockSpeed, with "-" for numbers that cannot be known."""
    return Table.of(
        summary["entries"],
        ("variant", lambda entry: str(entry["variant"])),
        ("command", lambda entry: command_name(entry["command"])),
        ("ClockSpeed", lambda entry: clock_label(entry["clock_speed"])),
        ("games", games_text),
        ("STLC median [q25, q75]", lambda entry: or_dash(entry["stlc_quartiles"], _quartiles)),
        number("RMSE median, m", "position_rmse_m_median", "{:.3f}"),
        number("effective speed-up", "effective_speedup", "{:.2f}"),
        number("gaps beyond the goal timeout", "share_beyond_goal_timeout", "{:.0%}"),
    )


def _between(least: SummaryCell, most: SummaryCell) -> str:
    """Return the least and the most accurate of a command's variants in words."""
    low, high = (f"{entry['stlc_quartiles'][1]:.3f} with {entry['variant']}" for entry in (least, most))
    flown = command_at_clock(least)
    return f"{flown}: STLC {low}" if least is most else f"{flown}: STLC from {low} to {high}"


def _quartiles(stlc: Sequence[float]) -> str:
    low, median, high = stlc
    return f"{median:.3f} [{low:.3f}, {high:.3f}]"


_READING = (
    "STLC and position error against ADSC at 1x under the same variant: medians over games, T_moves and rounds pooled; "
    "effective speed-up: its mean over the T_moves of the most rounds."
)
