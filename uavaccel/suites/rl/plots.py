"""Plots of the RL experiment: success, distance travelled, and training time by phase."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from uavaccel.draw import style
from uavaccel.sim.lane.layout import LENGTH_M
from uavaccel.suites.report import SummaryCell
from uavaccel.suites.training.phases import plot_stacked, unit_of

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
    """Plot success over the gap between two commands, linear up to .1 s and logarithmic beyond; dots are seeds."""
    with style.project_style():
        figure = style.new_figure(8.0, 4.6, title, source)
        axes = figure.subplots()
        for line in lines:
            _plot_line(axes, line, line.at, line.at)
        axes.set_xscale("symlog", linthresh=0.1)
        axes.xaxis.set_major_formatter("{x:g}")
        axes.set(
            xlabel="gap between two commands of the training, simulated s", ylabel="success in real time"
        )
        axes.set(xlim=(-0.01, None), ylim=(-0.03, 1.03))
        axes.legend(loc="best")
        return figure


def _plot_line(axes: Axes, line: SuccessLine, places: Sequence[float], dots: Sequence[float]) -> None:
    """Plot a line through `places`, with its intervals, and a dot for each seed at `dots`."""
    colour = line.colour or style.COMMAND_COLOUR.get(line.command, style.GREEN)
    axes.errorbar(
        places, line.success, style.error_bars(line.success, line.intervals),
        label=line.label, color=colour, marker="o", markersize=4, capsize=3,
        linestyle=":" if line.dashed else "-", alpha=0.5 if line.dashed else 1.0,
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
