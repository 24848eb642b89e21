"""The figures of the RL experiment: success, over the gap too, distance travelled, and the trainings' time by phase."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import cycle
from typing import TYPE_CHECKING, Any, NamedTuple

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
Cell = Mapping[str, Any]
"""An entry of the summary's `pooled`."""

THINKING = re.compile(r"_?think_\d+ms$")  # suffix of variants that differ in the duration of a decision alone
LEAST_GAPS, LEAST_CELLS = 3, 3  # that a run needs for a figure of gaps, and a line in it
COLLAPSED = 0.5  # share of the best success on the lane
BIN_M = 2.0


def panel_name(cell: Cell) -> str:
    """Return command and profile, as in "TCSC, airsim", with timing and variant where they are not the usual ones."""
    clock = "" if cell["timing"] == "virtual" else f" {cell['timing']}"
    variant = f", {cell['variant'].replace('_', ' ')}" if cell["variant"] else ""
    return f"{command_name(cell['command'])}, {cell['profile']}{clock}{variant}"


def over_gaps(pooled: Sequence[Cell]) -> dict[str, list[Cell]]:
    """Return the cells of each command on each lane, of all ClockSpeeds and durations of a decision, by rising gap.

    A line has three cells or more; none where a run has fewer than three gaps.
    """
    virtual = [cell for cell in pooled if cell["timing"] == "virtual"]
    lines: dict[tuple[str, str], list[Cell]] = {}
    for cell in sorted(virtual, key=lambda cell: (cell["gap_s"], cell["clock_speed"])):
        lines.setdefault((lane_of(cell), cell["command"]), []).append(cell)
    if len({cell["gap_s"] for cell in virtual}) < LEAST_GAPS:
        return {}
    return {
        f"{command_name(command)}, {lane}": cells
        for (lane, command), cells in sorted(lines.items())
        if len(cells) >= LEAST_CELLS
    }


def lane_of(cell: Cell) -> str:
    """Return profile and lane of a cell: "airsim, hard" of the variant hard_think_100ms."""
    variant = THINKING.sub("", cell["variant"]).replace("_", " ")
    return f"{cell['profile']}, {variant}" if variant else str(cell["profile"])


def collapse(lines: Mapping[str, Sequence[Cell]]) -> str:
    """Return in words from which gap on success stays below half of the lane's best."""
    cells = [cell for own in lines.values() for cell in own]
    said = []
    for label, own in lines.items():
        if len({cell["gap_s"] for cell in own}) >= LEAST_GAPS:
            best = max(cell["success_ratio"] for cell in cells if lane_of(cell) == lane_of(own[0]))
            above = [cell["gap_s"] for cell in own if cell["success_ratio"] >= COLLAPSED * best]
            below = [cell["gap_s"] for cell in own if not above or cell["gap_s"] > above[-1]]
            stays, flown = f"success in real time stays below half of the best cell's {best:.1%}", own[-1]["gap_s"]
            none = f"no gap was flown, up to {flown:.2f} s, from which {stays}"
            said.append(f"{label}: {f'{stays} from a gap of {below[0]:.2f} simulated seconds on' if below else none}.")
    return " ".join(said)


def pooled_cells(report: Report) -> pd.DataFrame:
    """Return the summary's pooled cells by rising ClockSpeed, with their `panel` and the `distance_m` of all games."""
    cells = pd.DataFrame(report.summary["pooled"])
    own = report.scores.query("not exact and flight == 0").groupby(KEY, sort=False)
    cells["distance_m"] = [np.concatenate(each.tolist()) for _, each in own.distance_m]
    cells["panel"] = [panel_name(cell) for cell in report.summary["pooled"]]
    return cells.sort_values("clock_speed", kind="stable")


def _source(report: Report) -> str:
    return f"modelled · {report.summary['training_games']} training games each"


def _source_with_seeds(report: Report) -> str:
    return f"{_source(report)} · seed {listed(sorted(report.games.seed.unique().tolist()))}"


class Line(NamedTuple):
    """Success: a table with the columns `at`, ClockSpeed or gap, `success`, `low`, `high` and `by_seed`, ratios."""

    label: str
    colour: str
    points: pd.DataFrame
    papers: bool = False


def success_line(label: str, cells: pd.DataFrame, at: str, colour: str) -> Line:
    """Return a line through cells with the intervals over seeds and games."""
    by_seed = [
        np.divide(won, games / len(won)) for won, games in zip(cells.successes_by_seed, cells.games, strict=True)
    ]
    columns = {"at": cells[at], "success": cells.success_ratio, "low": cells.seeds_low, "high": cells.seeds_high}
    return Line(label, colour, pd.DataFrame({**columns, "by_seed": by_seed}))


def success_lines(cells: pd.DataFrame) -> Iterator[Line]:
    """Yield a line for each command, profile and variant, and the paper's own numbers for its profile."""
    others = cycle((style.GREEN, style.PURPLE, style.ORANGE, style.SKY))
    for panel, own in cells.groupby("panel"):
        first = own.iloc[0]
        usual = (first.profile, first.timing, first.variant) == ("airsim", "virtual", "")
        papers = style.COMMAND_COLOUR.get(first.command, style.GREEN)  # the paper's trainings have the command's colour
        yield success_line(str(panel), own, "clock_speed", papers if usual else next(others))
        if len(known := own.dropna(subset="paper_successes")):
            success = [Proportion(int(won), paper_results.GAMES) for won in known.paper_successes]
            low, high = zip(*(each.interval for each in success), strict=True)
            columns = {"at": known.clock_speed.tolist(), "success": [each.ratio for each in success]}
            points = pd.DataFrame({**columns, "low": low, "high": high, "by_seed": [[]] * len(known)})
            yield Line(f"{command_name(first.command)}, the paper's", papers, points, papers=True)


def draw_line(axes: Axes, line: Line, places: Sequence[float], dots: Sequence[float]) -> None:
    """Draw a line through `places`, with its intervals, and a dot for each seed at `dots`."""
    linestyle = "none" if len(set(places)) == 1 else ":" if line.papers else "-"
    drawn = {"label": line.label, "color": line.colour, "markersize": 4, "capsize": 3, "linestyle": linestyle}
    own, alpha = line.points, 0.5 if line.papers else 1.0
    intervals = list(zip(own.low, own.high, strict=True))
    plots.points(axes, places, own.success.tolist(), intervals, alpha=alpha, **drawn)
    for place, seeds in zip(dots, own.by_seed, strict=True):
        axes.plot([place] * len(seeds), seeds, ".", color=line.colour, markersize=4, alpha=0.6)


def success_figure(report: Report) -> Picture:
    """Draw success over ClockSpeed (the paper's Table I), the lines shifted aside a little; dots are seeds."""
    cells, source = pooled_cells(report), _source_with_seeds(report)
    clocks, lines = sorted(cells.clock_speed.unique()), list(success_lines(cells))
    figure = style.new_figure(8.0, 4.6, "Success by training", source)
    axes = figure.subplots()
    for number, line in enumerate(lines):
        places = np.searchsorted(clocks, line.points["at"]) + 0.06 * (number - (len(lines) - 1) / 2)
        draw_line(axes, line, places.tolist(), places + 0.03)
    plots.clock_axis(axes, clocks)
    axes.set(xlabel="ClockSpeed of the training", ylabel="success", ylim=(-0.03, 1.03))
    axes.legend(loc="best")
    return report.figure("table1_success", figure, TABLE1, source)


def gaps_figure(report: Report, lines: Mapping[str, Sequence[Cell]]) -> Picture:
    """Draw success over the gap between two commands, linear up to .1 s and logarithmic beyond; dots are seeds.

    Only the dots of two seeds are drawn, since an interval over two spans nearly everything, and only the points of
    cells that share a gap, as all of TCSC do: their intervals would hide one another.
    """
    title = "Success in real time over the gap of the training"
    figure = style.new_figure(8.0, 4.6, title, _source(report))
    axes = figure.subplots()
    for number, (label, cells) in enumerate(lines.items()):
        line = success_line(label, pd.DataFrame(cells), "gap_s", style.colour(number))
        own = line.points
        hidden = (own.by_seed.map(len) == 2) | own["at"].duplicated(keep=False)
        own[["low", "high"]] = own[["low", "high"]].mask(hidden, own.success, axis=0)
        draw_line(axes, line, own["at"].tolist(), own["at"])
    axes.set_xscale("symlog", linthresh=0.1)
    axes.xaxis.set_major_formatter("{x:g}")
    axes.set(xlabel="gap between two commands of the training, simulated s", ylabel="success in real time")
    axes.set(xlim=(-0.01, None), ylim=(-0.03, 1.03))
    axes.legend(loc="best")
    return report.figure("success_over_gap", figure, f"{title}. {POINTS}", _source(report))


def distances_figure(report: Report) -> Picture:
    """Draw how far policies got down the lane (the paper's Figure 8), a column per panel and a line per ClockSpeed.

    Above is the share of games that reached each distance, below the share that ended there; rows of obstacles are
    marked.
    """
    cells, source = pooled_cells(report), _source_with_seeds(report)
    clocks, panels = sorted(cells.clock_speed.unique()), cells.groupby("panel")
    rows_m = np.unique(sample_layout(0, Difficulty()).x_m)
    figure = style.new_figure(1.5 + 5.2 * len(panels), 6.4, "Distance travelled", source)
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
            for row_m in rows_m:
                axes.axvline(row_m, color=style.GREY, linewidth=0.7, linestyle=":", zorder=0)
        upper.axvline(LENGTH_M, color=style.BLACK, linewidth=1.0, linestyle="--")
        lower.set_xlabel("distance north, m (dotted: rows of obstacles)")
    grid[0, 0].set(ylabel="share of games that got there", ylim=(0.0, 1.05))
    grid[1, 0].set_ylabel(f"share of games that ended\nin {BIN_M:g} m")
    style.shared_legend(figure, grid[0])
    return report.figure("figure8_distances", figure, FIGURE8, source)


def time_figure(report: Report) -> Picture:
    """Draw the time of a training, the mean of its seeds, by phase (the paper's Figure 9), a panel per command.

    Phases are stacked bars, with rendering as part of the paper's simulation; speed-ups over real time are points on an
    axis of their own. Trainings in lockstep have no clock and no panel.
    """
    cells, source = pooled_cells(report).query("timing == 'virtual'"), _source_with_seeds(report)
    phase_s = pd.DataFrame(cells.phase_s.tolist(), cells.index).div(cells.seeds.map(len), axis=0)
    phase_s.insert(0, "simulation (with rendering)", phase_s.pop("simulation") + phase_s.pop("rendering"))
    unit, panels = plots.time_unit(phase_s.sum(axis=1).max()), cells.groupby("panel")
    figure = style.new_figure(2.0 + 5.0 * len(panels), 4.6, "Time of the training by phase", source)
    shared = []
    for axes, (title, panel) in zip(figure.subplots(1, len(panels), squeeze=False)[0], panels, strict=True):
        axes.set_title(title, loc="center")
        plots.stacked(axes, phase_s.loc[panel.index], unit)
        plots.clock_axis(axes, panel.clock_speed)
        axes.set(ylabel=f"{unit} of the training", xlim=(-0.6, len(panel) - 0.4))
        speed = axes.twinx()
        for name, (label, marker) in SPEEDUPS.items():
            values = panel[name].to_numpy(float)
            if np.isfinite(values).any():
                speed.plot(range(len(panel)), values, marker, color=style.BLACK, label=label, markersize=6)
        speed.set(ylabel="effective speed-up")
        speed.set_ylim(bottom=0.0)
        speed.grid(visible=False)
        shared += [axes, speed]
    style.shared_legend(figure, shared)
    return report.figure("figure9_training_time", figure, FIGURE9, source)


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
