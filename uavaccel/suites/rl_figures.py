"""The figures of the RL experiment: success, over the gap too, distance travelled, and the trainings' time by phase."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from uavaccel.draw import style
from uavaccel.draw.labels import clock_label, command_name
from uavaccel.draw.page import Picture, listed
from uavaccel.metrics.intervals import Proportion
from uavaccel.sim.lane.layout import LENGTH_M, Difficulty, sample_layout
from uavaccel.suites import paper_results, plots
from uavaccel.suites.report import Report

if TYPE_CHECKING:
    from matplotlib.axes import Axes

KEY = ["variant", "profile", "timing", "command", "clock_speed"]
"""The conditions of a training; trainings that have them in common differ in their seed alone."""
THINKING = re.compile(r"_?think_\d+ms$")  # suffix of variants that differ in the duration of a decision alone
LEAST = 3  # gaps that a run needs for a figure of them, and cells for a line in it
COLLAPSED = 0.5  # share of the best success on the lane
BIN_M = 2.0


def panel_name(cell: Mapping[str, Any]) -> str:
    """Return command and profile, as in "TCSC, airsim", with timing and variant where they are not the usual ones."""
    clock = "" if cell["timing"] == "virtual" else f" {cell['timing']}"
    variant = f", {cell['variant'].replace('_', ' ')}" if cell["variant"] else ""
    return f"{command_name(cell['command'])}, {cell['profile']}{clock}{variant}"


def over_gaps(pooled: Sequence[Mapping[str, Any]]) -> dict[str, pd.DataFrame]:
    """Return the cells of each command on each `lane`, of all ClockSpeeds and durations of a decision, by rising gap.

    A lane is that of a profile and a variant: "airsim, hard" of hard_think_100ms.
    """
    cells = pd.DataFrame(pooled).query("timing == 'virtual'").sort_values(["gap_s", "clock_speed"], kind="stable")
    if cells.gap_s.nunique() < LEAST:
        return {}
    variant = cells.variant.str.replace(THINKING, "", regex=True).str.replace("_", " ")
    lines = cells.assign(lane=cells.profile + variant.where(variant == "", ", " + variant)).groupby(["lane", "command"])
    return {f"{command_name(command)}, {lane}": line for (lane, command), line in lines if len(line) >= LEAST}


def collapse(lines: Mapping[str, pd.DataFrame]) -> str:
    """Return in words from which gap on success stays below half of the lane's best."""
    best, said = pd.concat(lines.values()).groupby("lane").success_ratio.max(), []
    for label, line in lines.items():
        if line.gap_s.nunique() >= LEAST:
            most = best[line.lane.iloc[0]]
            above = line.gap_s[line.success_ratio >= COLLAPSED * most]
            below = line.gap_s[line.gap_s > above.max()] if len(above) else line.gap_s
            stays = f"success in real time stays below half of the best cell's {most:.1%}"
            none = f"no gap was flown, up to {line.gap_s.max():.2f} s, from which {stays}"
            found = f"{stays} from a gap of {below.iloc[0]:.2f} simulated seconds on" if len(below) else none
            said.append(f"{label}: {found}.")
    return " ".join(said)


def pooled_cells(report: Report) -> pd.DataFrame:
    """Return the summary's pooled cells by rising ClockSpeed, with their `panel` and the `distance_m` of all games."""
    own = report.scores.query("not exact and flight == 0").groupby(KEY, sort=False)
    distance_m = [np.concatenate(games.tolist()) for _, games in own.distance_m]
    panels = [panel_name(cell) for cell in report.summary["pooled"]]
    cells = pd.DataFrame(report.summary["pooled"]).assign(distance_m=distance_m, panel=panels)
    return cells.sort_values("clock_speed", kind="stable")


def _source(report: Report, seeds: bool = True) -> str:
    known = f" · seed {listed(sorted(report.games.seed.unique().tolist()))}" if seeds else ""
    return f"modelled · {report.summary['training_games']} training games each{known}"


def _success(cells: pd.DataFrame) -> pd.DataFrame:
    """Return cells with their `success`, its ends `low` and `high` over seeds and games, and that `by_seed`."""
    by_seed = [
        np.divide(won, games / len(won)) for won, games in zip(cells.successes_by_seed, cells.games, strict=True)
    ]
    return cells.assign(success=cells.success_ratio, low=cells.seeds_low, high=cells.seeds_high, by_seed=by_seed)


def draw_line(axes: Axes, cells: pd.DataFrame, places: Sequence[float], dots: Sequence[float], **line: Any) -> None:
    """Draw a line through cells at `places`, with their intervals, and a dot for each seed at `dots`."""
    intervals = list(zip(cells.low, cells.high, strict=True))
    drawn = {"markersize": 4, "capsize": 3, "linestyle": "-"} | line
    if len(set(places)) == 1:
        drawn["linestyle"] = "none"
    plots.points(axes, places, cells.success.tolist(), intervals, **drawn)
    for place, seeds in zip(dots, cells.by_seed, strict=True):
        axes.plot([place] * len(seeds), seeds, ".", color=line["color"], markersize=4, alpha=0.6)


def success_figure(report: Report, cells: pd.DataFrame) -> Picture:
    """Draw success over ClockSpeed (the paper's Table I), the lines shifted aside a little; dots are seeds.

    There is a line for each command, profile and variant, and the paper's own numbers for its profile.
    """
    others = cycle((style.GREEN, style.PURPLE, style.ORANGE, style.SKY))
    clocks, lines = sorted(cells.clock_speed.unique()), []
    for panel, own in cells.groupby("panel"):
        first = own.iloc[0]
        colour = style.COMMAND_COLOUR.get(first.command, style.GREEN)  # the paper's trainings have the command's colour
        usual = (first.profile, first.timing, first.variant) == ("airsim", "virtual", "")
        lines.append((_success(own), {"label": panel, "color": colour if usual else next(others)}))
        if len(known := own.dropna(subset="paper_successes")):
            won = [Proportion(int(successes), paper_results.GAMES) for successes in known.paper_successes]
            low, high = zip(*(success.interval for success in won), strict=True)
            papers = known.assign(
                success=[success.ratio for success in won], low=low, high=high, by_seed=[[]] * len(won)
            )
            label = f"{command_name(first.command)}, the paper's"
            lines.append((papers, {"label": label, "color": colour, "alpha": 0.5, "linestyle": ":"}))
    figure = style.new_figure(8.0, 4.6, "Success by training", _source(report))
    axes = figure.subplots()
    for number, (own, line) in enumerate(lines):
        places = np.searchsorted(clocks, own.clock_speed) + 0.06 * (number - (len(lines) - 1) / 2)
        draw_line(axes, own, places.tolist(), places + 0.03, **line)
    plots.clock_axis(axes, clocks)
    axes.set(xlabel="ClockSpeed of the training", ylabel="success", ylim=(-0.03, 1.03))
    axes.legend(loc="best")
    return report.figure("table1_success", figure, TABLE1)


def gaps_figure(report: Report, lines: Mapping[str, pd.DataFrame]) -> Picture:
    """Draw success over the gap between two commands, linear up to .1 s and logarithmic beyond; dots are seeds.

    Only the dots of two seeds are drawn, since an interval over two spans nearly everything, and only the points of
    cells that share a gap, as all of TCSC do: their intervals would hide one another.
    """
    title = "Success in real time over the gap of the training"
    figure = style.new_figure(8.0, 4.6, title, _source(report, seeds=False))
    axes = figure.subplots()
    for number, (label, line) in enumerate(lines.items()):
        own = _success(line)
        hidden = (own.seeds.map(len) == 2) | own.gap_s.duplicated(keep=False)
        own[["low", "high"]] = own[["low", "high"]].mask(hidden, own.success, axis=0)
        draw_line(axes, own, own.gap_s.tolist(), own.gap_s, label=label, color=style.colour(number))
    axes.set_xscale("symlog", linthresh=0.1)
    axes.xaxis.set_major_formatter("{x:g}")
    axes.set(xlabel="gap between two commands of the training, simulated s", ylabel="success in real time")
    axes.set(xlim=(-0.01, None), ylim=(-0.03, 1.03))
    axes.legend(loc="best")
    return report.figure("success_over_gap", figure, f"{title}. {POINTS}")


def distances_figure(report: Report, cells: pd.DataFrame) -> Picture:
    """Draw how far policies got down the lane (the paper's Figure 8), a column per panel and a line per ClockSpeed.

    Above is the share of games that reached each distance, below the share that ended there; rows of obstacles are
    marked.
    """
    clocks, panels = sorted(cells.clock_speed.unique()), cells.groupby("panel")
    figure = style.new_figure(1.5 + 5.2 * len(panels), 6.4, "Distance travelled", _source(report))
    grid = figure.subplots(2, len(panels), sharex=True, sharey="row", squeeze=False, height_ratios=[3, 2])
    for (upper, lower), (title, panel) in zip(grid.T, panels, strict=True):
        upper.set_title(title, loc="center")
        for clock, distance_m in zip(panel.clock_speed, panel.distance_m, strict=True):
            places, share = style.survival(distance_m, LENGTH_M)
            games, colour = len(distance_m), style.colour(clocks.index(clock))
            upper.step(places, share, where="post", color=colour, label=f"{clock_label(clock)}, {games} games")
            ended = distance_m[distance_m < LENGTH_M]
            counts, edges = np.histogram(ended, np.arange(0.0, LENGTH_M + BIN_M, BIN_M))
            lower.stairs(counts / games, edges, color=colour)
        for axes in (upper, lower):
            for row_m in np.unique(sample_layout(0, Difficulty()).x_m):
                axes.axvline(row_m, color=style.GREY, linewidth=0.7, linestyle=":", zorder=0)
        upper.axvline(LENGTH_M, color=style.BLACK, linewidth=1.0, linestyle="--")
        lower.set_xlabel("distance north, m (dotted: rows of obstacles)")
    grid[0, 0].set(ylabel="share of games that got there", ylim=(0.0, 1.05))
    grid[1, 0].set_ylabel(f"share of games that ended\nin {BIN_M:g} m")
    style.shared_legend(figure, grid[0])
    return report.figure("figure8_distances", figure, FIGURE8)


def time_figure(report: Report, cells: pd.DataFrame) -> Picture:
    """Draw the time of a training, the mean of its seeds, by phase (the paper's Figure 9), a panel per command.

    Phases are stacked bars, with rendering as part of the paper's simulation; speed-ups over real time are points on an
    axis of their own. Trainings in lockstep have no clock and no panel.
    """
    cells, shared = cells[cells.timing == "virtual"], []
    phase_s = pd.DataFrame(cells.phase_s.tolist(), cells.index).div(cells.seeds.map(len), axis=0)
    phase_s.insert(0, "simulation (with rendering)", phase_s.pop("simulation") + phase_s.pop("rendering"))
    unit, panels = plots.time_unit(phase_s.sum(axis=1).max()), cells.groupby("panel")
    figure = style.new_figure(2.0 + 5.0 * len(panels), 4.6, "Time of the training by phase", _source(report))
    for axes, (title, panel) in zip(figure.subplots(1, len(panels), squeeze=False)[0], panels, strict=True):
        axes.set_title(title, loc="center")
        plots.stacked(axes, phase_s.loc[panel.index], unit)
        plots.clock_axis(axes, panel.clock_speed)
        axes.set(ylabel=f"{unit} of the training", xlim=(-0.6, len(panel) - 0.4))
        speed = axes.twinx()
        for name, (label, marker) in SPEEDUPS.items():
            if panel[name].notna().any():
                speed.plot(
                    range(len(panel)), panel[name].astype(float), marker, color=style.BLACK, label=label, markersize=6
                )
        speed.set(ylabel="effective speed-up")
        speed.set_ylim(bottom=0.0)
        speed.grid(visible=False)
        shared += [axes, speed]
    style.shared_legend(figure, shared)
    return report.figure("figure9_training_time", figure, FIGURE9)


SPEEDUPS = {
    "training_speedup": ("speed-up, simulation alone (right)", "o"),
    "whole_training_speedup": ("speed-up, whole training (right)", "s"),
    "paper_training_speedup": ("the paper's, simulation alone", "x"),
    "paper_whole_training_speedup": ("the paper's, whole training", "+"),
}
TABLE1 = "Table I as a picture: bars are 95 % intervals over seeds and games, of the paper's Wilson's; dots are seeds."
POINTS = "A point is a cell, with its 95 % interval over seeds and games; dots are seeds."
FIGURE8 = "Figure 8. How far the evaluated policies got, seeds pooled."
FIGURE9 = "Figure 9. Modelled time of a training by phase, mean of its seeds."
