"""The figures of the RL experiment: success, distance travelled, and the time of the trainings by phase."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import cycle
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from uavaccel.draw import style
from uavaccel.draw.document import Picture
from uavaccel.draw.style import command_name
from uavaccel.metrics.intervals import Proportion
from uavaccel.records import RunDirectory
from uavaccel.sim.lane.layout import LENGTH_M, Difficulty, draw_layout
from uavaccel.suites import paper_results
from uavaccel.suites.old_report import Summary, SummaryCell, listed
from uavaccel.suites.rl.cases import RlRow
from uavaccel.suites.rl.gaps import over_gaps
from uavaccel.suites.rl.summary import key_of
from uavaccel.suites.training.phases import plot_stacked, unit_of


def panel_name(cell: SummaryCell) -> str:
    """Return command and profile, as in "TCSC, airsim", with timing and variant where they are not the usual ones."""
    clock = "" if cell["timing"] == "virtual" else f" {cell['timing']}"
    variant = f", {cell['variant'].replace('_', ' ')}" if cell["variant"] else ""
    return f"{command_name(cell['command'])}, {cell['profile']}{clock}{variant}"


def plot_figures(run: RunDirectory, summary: Summary, rows: Sequence[RlRow]) -> list[Picture]:
    """Plot Table I, Figure 8 and, where a clock was simulated, Figure 9."""
    pooled = summary["pooled"]
    seeds = listed(sorted({seed for cell in pooled for seed in cell["seeds"]}))
    source = f"modelled · {summary['training_games']} training games each · seed {seeds}"
    distances = _by_panel(pooled, lambda cell: distances_m(run, rows, cell))
    rows_m = np.unique(draw_layout(0, Difficulty()).x_m).tolist()
    pictures = [
        (
            plot_success(success_lines(pooled), "Success by training", source),
            "table1_success",
            "Table I as a picture: bars are 95 % intervals over seeds and games, of the paper's Wilson's; dots are "
            "seeds.",
        ),
        (
            plot_distances(distances, rows_m, source),
            "figure8_distances",
            "Figure 8. How far the evaluated policies got, seeds pooled.",
        ),
    ]
    if timed := [cell for cell in pooled if cell["timing"] == "virtual"]:
        figure = plot_training_time(_by_panel(timed, lambda cell: cell), source)
        caption = "Figure 9. Modelled time of a training by phase, mean of its seeds."
        pictures.append((figure, "figure9_training_time", caption))
    return [
        style.picture(figure, run.file(f"figures/{name}.png"), caption, source)
        for figure, name, caption in pictures
    ]


def plot_gaps(run: RunDirectory, summary: Summary) -> list[Picture]:
    """Plot success in real time over the gap of the training; nothing where there are too few gaps."""
    mapped = over_gaps(summary["pooled"])
    if not mapped:
        return []
    source = f"modelled · {summary['training_games']} training games each"
    lines = [
        success_line(each.label, each.cells, [cell["gap_s"] for cell in each.cells], style.colour(number))
        for number, each in enumerate(mapped)
    ]
    title = "Success in real time over the gap of the training"
    caption = f"{title}. A point is a cell, with its 95 % interval over seeds and games; dots are seeds."
    path = run.file("figures/success_over_gap.png")
    return [style.picture(plot_success_over_gap(lines, title, source), path, caption, source)]


def success_lines(pooled: Sequence[SummaryCell]) -> list[SuccessLine]:
    """Return a line for each command, profile and variant, and the paper's own numbers for its profile."""
    lines: list[SuccessLine] = []
    others = cycle((style.GREEN, style.PURPLE, style.ORANGE, style.SKY))
    for name, panel in _by_panel(pooled, lambda cell: cell).items():
        members = list(panel.values())
        first = members[0]
        usual = (first["profile"], first["timing"], first["variant"]) == ("airsim", "virtual", "")
        colour = None if usual else next(others)  # the paper's trainings have their command's own colour
        lines.append(success_line(name, members, list(panel), colour))
        if known := [cell for cell in members if cell["paper_successes"] is not None]:
            lines.append(_papers(known))
    return lines


def success_line(
    label: str, cells: Sequence[SummaryCell], at: Sequence[float], colour: str | None = None
) -> SuccessLine:
    """Return a line through cells, each at its ClockSpeed or gap, with the intervals over seeds and games."""
    return SuccessLine(
        label,
        cells[0]["command"],
        at,
        [cell["success_ratio"] for cell in cells],
        [(cell["seeds_low"], cell["seeds_high"]) for cell in cells],
        by_seed=[
            [won * len(cell["seeds"]) / cell["games"] for won in cell["successes_by_seed"]] for cell in cells
        ],
        colour=colour,
    )


def _papers(cells: Sequence[SummaryCell]) -> SuccessLine:
    success = [Proportion(cell["paper_successes"], paper_results.GAMES) for cell in cells]
    command, clocks = cells[0]["command"], [cell["clock_speed"] for cell in cells]
    ratios, intervals = [each.ratio for each in success], [each.interval for each in success]
    return SuccessLine(
        f"{command_name(command)}, the paper's", command, clocks, ratios, intervals, dashed=True
    )


def distances_m(run: RunDirectory, rows: Sequence[RlRow], cell: SummaryCell) -> NDArray[np.float64]:
    """Return the distances north of all evaluation games of a cell, its seeds pooled."""
    arrays = [
        run.load_arrays(row)[f"{row['command']}_distance_m"]
        for row in rows
        if "training" in row and key_of(row) == key_of(cell)
    ]
    return np.concatenate(arrays)


def _by_panel(
    pooled: Iterable[SummaryCell], value: Callable[[SummaryCell], Any]
) -> dict[str, dict[float, Any]]:
    panels: dict[str, dict[float, Any]] = {}
    for cell in sorted(pooled, key=lambda cell: cell["clock_speed"]):
        panels.setdefault(panel_name(cell), {})[cell["clock_speed"]] = value(cell)
    return dict(sorted(panels.items()))


BIN_M = 2.0

Distances = Mapping[str, Mapping[float, Sequence[float]]]


def plot_distances(panels: Distances, rows_m: Sequence[float], source: str) -> Figure:
    """Plot how far policies got down the lane (the paper's Figure 8), a column per panel and a line per ClockSpeed.

    Above is the share of games that reached each distance, below the share that ended there.
    `panels[title][clock_speed]` holds the distances of games in metres; the rows of obstacles at `rows_m` are marked.
    """
    clocks = sorted({clock for panel in panels.values() for clock in panel})
    with style.project_style():
        figure = style.new_figure(1.5 + 5.2 * len(panels), 6.4, "Distance travelled", source)
        grid = figure.subplots(2, len(panels), sharex=True, sharey="row", squeeze=False, height_ratios=[3, 2])
        for (upper, lower), (title, panel) in zip(grid.T, panels.items(), strict=True):
            upper.set_title(title, loc="center")
            for clock in sorted(panel):
                _plot_panel(upper, lower, panel[clock], clock, style.colour(clocks.index(clock)))
            for axes in (upper, lower):
                for row_m in rows_m:
                    axes.axvline(row_m, color=style.GREY, linewidth=0.7, linestyle=":", zorder=0)
            upper.axvline(LENGTH_M, color=style.BLACK, linewidth=1.0, linestyle="--")
            lower.set_xlabel("distance north, m (dotted: rows of obstacles)")
        grid[0, 0].set(ylabel="share of games that got there", ylim=(0.0, 1.05))
        grid[1, 0].set_ylabel(f"share of games that ended\nin {BIN_M:g} m")
        style.shared_legend(figure, grid[0])
        return figure


def _plot_panel(upper: Axes, lower: Axes, distances_m: Sequence[float], clock: float, colour: str) -> None:
    places, share = style.survival(distances_m, LENGTH_M)
    reached = places[1:]
    label = f"{style.clock_label(clock)}, {len(reached)} games"
    upper.step(places, share, where="post", color=colour, label=label)
    counts, edges = np.histogram(reached[reached < LENGTH_M], np.arange(0.0, LENGTH_M + BIN_M, BIN_M))
    lower.stairs(counts / len(reached), edges, color=colour)


@dataclass(frozen=True)
class SuccessLine:
    """The success of one command by ClockSpeed or by gap, with its intervals and the ratio of each seed."""

    label: str
    command: str
    at: Sequence[float]
    """ClockSpeeds, or gaps in simulated seconds."""
    success: Sequence[float]
    intervals: Sequence[tuple[float, float]]
    by_seed: Sequence[Sequence[float]] = ()
    dashed: bool = False
    colour: str | None = None
    """The command's own colour unless one is given."""


def plot_success(lines: Sequence[SuccessLine], title: str, source: str) -> Figure:
    """Plot success over ClockSpeed (the paper's Table I), the lines shifted aside a little; dots are seeds."""
    clocks = sorted({clock for line in lines for clock in line.at})
    with style.project_style():
        figure = style.new_figure(8.0, 4.6, title, source)
        axes = figure.subplots()
        for number, line in enumerate(lines):
            aside = 0.06 * (number - (len(lines) - 1) / 2)
            places = [clocks.index(clock) + aside for clock in line.at]
            _plot_line(axes, line, places, [place + 0.03 for place in places])
        axes.set_xticks(range(len(clocks)), [style.clock_label(clock) for clock in clocks])
        axes.set(xlabel="ClockSpeed of the training", ylabel="success", ylim=(-0.03, 1.03))
        axes.legend(loc="best")
        return figure


def plot_success_over_gap(lines: Sequence[SuccessLine], title: str, source: str) -> Figure:
    """Plot success over the gap between two commands, linear up to .1 s and logarithmic beyond; dots are seeds.

    Only the dots of two seeds are drawn, since an interval over two spans nearly everything, and only the points of
    cells that share a gap, as all of TCSC do: their intervals would hide one another.
    """
    with style.project_style():
        figure = style.new_figure(8.0, 4.6, title, source)
        axes = figure.subplots()
        for line in lines:
            _plot_line(axes, _with_readable_intervals(line), line.at, line.at)
        axes.set_xscale("symlog", linthresh=0.1)
        axes.xaxis.set_major_formatter("{x:g}")
        axes.set(
            xlabel="gap between two commands of the training, simulated s", ylabel="success in real time"
        )
        axes.set(xlim=(-0.01, None), ylim=(-0.03, 1.03))
        axes.legend(loc="best")
        return figure


def _with_readable_intervals(line: SuccessLine) -> SuccessLine:
    seeds = [len(each) for each in line.by_seed] or [0] * len(line.at)
    shown = [
        (ratio, ratio) if trained == 2 or list(line.at).count(gap) > 1 else interval
        for gap, ratio, interval, trained in zip(line.at, line.success, line.intervals, seeds, strict=True)
    ]
    return replace(line, intervals=shown)


def _plot_line(axes: Axes, line: SuccessLine, places: Sequence[float], dots: Sequence[float]) -> None:
    """Plot a line through `places`, with its intervals, and a dot for each seed at `dots`."""
    colour = line.colour or style.COMMAND_COLOUR.get(line.command, style.GREEN)
    linestyle = "none" if len(set(places)) == 1 else ":" if line.dashed else "-"
    axes.errorbar(
        places, line.success, style.error_bars(line.success, line.intervals),
        label=line.label, color=colour, marker="o", markersize=4, capsize=3,
        linestyle=linestyle, alpha=0.5 if line.dashed else 1.0,
    )  # fmt: skip
    for place, seeds in zip(dots, line.by_seed, strict=False):
        axes.plot([place] * len(seeds), seeds, ".", color=colour, markersize=4, alpha=0.6)


SPEEDUPS = {
    "training_speedup": ("speed-up, simulation alone (right)", "o"),
    "whole_training_speedup": ("speed-up, whole training (right)", "s"),
    "paper_training_speedup": ("the paper's, simulation alone", "x"),
    "paper_whole_training_speedup": ("the paper's, whole training", "+"),
}


def plot_training_time(panels: Mapping[str, Mapping[float, SummaryCell]], source: str) -> Figure:
    """Plot the time of a training, the mean of its seeds, by phase (the paper's Figure 9), a panel per command.

    `panels[title][clock_speed]` is an entry of the summary's `pooled`. Phases are stacked bars, with rendering as part
    of the paper's simulation; speed-ups over real time are points on an axis of their own.
    """
    phase_s = {title: [_phases(cell) for cell in panel.values()] for title, panel in panels.items()}
    with style.project_style():
        figure = style.new_figure(2.0 + 5.0 * len(panels), 4.6, "Time of the training by phase", source)
        row = figure.subplots(1, len(panels), squeeze=False)[0]
        unit = unit_of([each for panel in phase_s.values() for each in panel])
        shared: list[Axes] = []
        for axes, (title, panel) in zip(row, panels.items(), strict=True):
            axes.set_title(title, loc="center")
            places = plot_stacked(axes, phase_s[title], unit)
            axes.set_xticks(places, [style.clock_label(clock) for clock in panel])
            axes.set(xlabel="ClockSpeed", ylabel=f"{unit} of the training", xlim=(-0.6, len(panel) - 0.4))
            shared += [axes, _plot_speedups(axes, list(panel.values()))]
        style.shared_legend(figure, shared)
        return figure


def _phases(cell: SummaryCell) -> dict[str, float]:
    mean_s = {phase: spent / len(cell["seeds"]) for phase, spent in cell["phase_s"].items()}
    return {
        "simulation (with rendering)": mean_s["simulation"] + mean_s["rendering"],
        "image processing": mean_s["image_processing"],
        "inference": mean_s["inference"],
        "learning": mean_s["learning"],
    }


def _plot_speedups(axes: Axes, cells: Sequence[SummaryCell]) -> Axes:
    speed = axes.twinx()
    for name, (label, marker) in SPEEDUPS.items():
        values = np.array([cell[name] for cell in cells], float)
        if np.isfinite(values).any():
            speed.plot(np.arange(len(cells)), values, marker, color=style.BLACK, label=label, markersize=6)
    speed.set(ylabel="effective speed-up")
    speed.set_ylim(bottom=0.0)
    speed.grid(visible=False)
    return speed
