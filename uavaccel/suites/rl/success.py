"""Success of policies over the ClockSpeed of their training (the paper's Table I as a picture), or over its gap."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from uavaccel.draw import style


@dataclass(frozen=True)
class SuccessLine:
    """One command's success by ClockSpeed or by gap, and the ratios of each seed."""

    label: str
    command: str
    at: Sequence[float]
    """ClockSpeeds, or gaps in simulated seconds."""
    success: Sequence[float]
    intervals: Sequence[tuple[float, float]]
    by_seed: Sequence[Sequence[float]] = ()
    dashed: bool = False
    colour: str | None = None
    """The command's own unless one is given."""


def plot_success(lines: Sequence[SuccessLine], title: str, source: str) -> Figure:
    """A line per command over the ClockSpeeds, side by side where they would hide each other; a dot per seed."""
    clocks = sorted({clock for line in lines for clock in line.at})
    with style.project_style():
        figure = style.new_figure(8.0, 4.6, title, source)
        axes = figure.subplots()
        for number, line in enumerate(lines):
            aside = 0.06 * (number - (len(lines) - 1) / 2)
            places = [clocks.index(clock) + aside for clock in line.at]
            _draw(axes, line, places, [place + 0.03 for place in places])
        axes.set_xticks(range(len(clocks)), [style.clock_label(clock) for clock in clocks])
        axes.set(xlabel="ClockSpeed of the training", ylabel="success", ylim=(-0.03, 1.03))
        axes.legend(loc="best")
        return figure


def plot_success_over_gap(lines: Sequence[SuccessLine], title: str, source: str) -> Figure:
    """The same over the gaps between two commands, linear up to .1 s and logarithmic from there; dots are seeds."""
    with style.project_style():
        figure = style.new_figure(8.0, 4.6, title, source)
        axes = figure.subplots()
        for line in lines:
            _draw(axes, line, line.at, line.at)
        axes.set_xscale("symlog", linthresh=0.1)
        axes.xaxis.set_major_formatter("{x:g}")
        axes.set(
            xlabel="gap between two commands of the training, simulated s", ylabel="success in real time"
        )
        axes.set(xlim=(-0.01, None), ylim=(-0.03, 1.03))
        axes.legend(loc="best")
        return figure


def _draw(axes: Axes, line: SuccessLine, places: Sequence[float], dots: Sequence[float]) -> None:
    """A line through `places`, with its intervals, and a dot for each seed at `dots`."""
    colour = line.colour or style.COMMAND_COLOUR.get(line.command, style.GREEN)
    axes.errorbar(
        places, line.success, style.bars(line.success, line.intervals),
        label=line.label, color=colour, marker="o", markersize=4, capsize=3,
        linestyle=":" if line.dashed else "-", alpha=0.5 if line.dashed else 1.0,
    )  # fmt: skip
    for place, seeds in zip(dots, line.by_seed, strict=False):
        axes.plot([place] * len(seeds), seeds, ".", color=colour, markersize=4, alpha=0.6)
