"""How many games got how far down the lane (the paper's Figure 8, section IV-D)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from uavaccel.draw import style
from uavaccel.metrics.intervals import wilson_interval
from uavaccel.sim.lane.layout import LENGTH_M


def draw_survival(distances_m: Mapping[str, Sequence[float]], path: Path, source: str) -> Path:
    """Write `plot_survival` as a PNG; returns `path`."""
    return style.save(plot_survival(distances_m, source), path)


def plot_survival(distances_m: Mapping[str, Sequence[float]], source: str) -> Figure:
    """The share of games that reached each distance, a line per evaluation in its 95 % Wilson interval.

    Distances in metres, by its name.
    """
    with style.project_style():
        figure = style.new_figure(8.0, 4.6, "Distance travelled", source)
        axes = figure.subplots()
        for name, values in distances_m.items():
            reached = np.sort(np.minimum(np.asarray(values, float), LENGTH_M))
            share = 1.0 - np.arange(len(reached) + 1) / len(reached)
            places = np.concatenate([[0.0], reached])
            (line,) = axes.step(places, share, where="post", label=name)
            ends = [wilson_interval(len(reached) - gone, len(reached)) for gone in range(len(reached) + 1)]
            low, high = zip(*ends, strict=True)
            axes.fill_between(places, low, high, step="post", color=line.get_color(), alpha=0.15, linewidth=0)
        axes.axvline(LENGTH_M, color=style.BLACK, linewidth=1.2, linestyle="--", label="end of the lane")
        axes.set_xlabel("distance north, m")
        axes.set_ylabel("share of games that got there")
        axes.set_ylim(0.0, 1.05)
        axes.legend(loc="lower left")
        return figure
