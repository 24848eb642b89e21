"""Success of policies over the ClockSpeed of their training (the paper's Table I as a picture)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from uavaccel.draw import style


@dataclass(frozen=True)
class SuccessLine:
    """One command's success by ClockSpeed, and the ratios of each seed."""

    label: str
    command: str
    clock_speed: Sequence[float]
    success: Sequence[float]
    intervals: Sequence[tuple[float, float]]
    by_seed: Sequence[Sequence[float]] = ()
    dashed: bool = False
    colour: str | None = None
    """The command's own unless one is given."""


def plot_success(lines: Sequence[SuccessLine], title: str, source: str) -> Figure:
    """A line per command over the ClockSpeeds, side by side where they would hide each other; a dot per seed."""
    clocks = sorted({clock for line in lines for clock in line.clock_speed})
    with style.project_style():
        figure = style.new_figure(8.0, 4.6, title, source)
        axes = figure.subplots()
        for number, line in enumerate(lines):
            aside = 0.06 * (number - (len(lines) - 1) / 2)
            places = np.array([clocks.index(clock) for clock in line.clock_speed]) + aside
            colour = line.colour or style.COMMAND_COLOUR.get(line.command, style.GREEN)
            axes.errorbar(
                places, line.success, style.bars(line.success, line.intervals),
                label=line.label, color=colour, marker="o", markersize=4, capsize=3,
                linestyle=":" if line.dashed else "-", alpha=0.5 if line.dashed else 1.0,
            )  # fmt: skip
            for place, seeds in zip(places, line.by_seed, strict=False):
                axes.plot([place + 0.03] * len(seeds), seeds, ".", color=colour, markersize=4, alpha=0.6)
        axes.set_xticks(range(len(clocks)), [style.clock_label(clock) for clock in clocks])
        axes.set(xlabel="ClockSpeed of the training", ylabel="success", ylim=(-0.03, 1.03))
        axes.legend(loc="best")
        return figure
