"""Success as one condition after another departs from the training's: a panel per condition."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from uavaccel.draw import style

COLUMNS = 3


@dataclass(frozen=True)
class SweptPoint:
    """A value of the condition, the success ratio under it and the ends of its interval."""

    value: str
    ratio: float
    low: float
    high: float


@dataclass(frozen=True)
class Sweep:
    """One condition, its values in order."""

    name: str
    points: Sequence[SweptPoint]


def draw_sweeps(
    sweeps: Sequence[Sweep], as_trained: float | None, title: str, path: Path, source: str
) -> Path:
    """Write `plot_sweeps` as a PNG; returns `path`."""
    return style.save(plot_sweeps(sweeps, as_trained, title, source), path)


def plot_sweeps(sweeps: Sequence[Sweep], as_trained: float | None, title: str, source: str) -> Figure:
    """A panel per condition, points with intervals; dashed the success under the conditions of the training."""
    columns = max(min(len(sweeps), COLUMNS), 1)
    rows = max(math.ceil(len(sweeps) / columns), 1)
    with style.project_style():
        figure = style.new_figure(max(2.9 * columns, 5.0), 0.9 + 2.2 * rows, title, source)
        panels = figure.subplots(rows, columns, sharey=True, squeeze=False).ravel()
        for axes, sweep in zip(panels, sweeps, strict=False):
            _plot(axes, sweep, as_trained)
        for axes in panels[len(sweeps) :]:
            axes.set_visible(False)
        for axes in panels[::columns]:
            axes.set_ylabel("success")
        return figure


def _plot(axes: Axes, sweep: Sweep, as_trained: float | None) -> None:
    places = range(len(sweep.points))
    ratios = [point.ratio for point in sweep.points]
    below = [max(point.ratio - point.low, 0.0) for point in sweep.points]
    above = [max(point.high - point.ratio, 0.0) for point in sweep.points]
    axes.errorbar(places, ratios, [below, above], color=style.BLUE, marker="o", markersize=4, capsize=3)
    if as_trained is not None:
        axes.axhline(as_trained, color=style.GREY, linestyle="--", linewidth=1.0)
    axes.set_xticks(list(places), [point.value for point in sweep.points])
    axes.set(xlabel=sweep.name, ylim=(-0.03, 1.03), xlim=(-0.5, len(sweep.points) - 0.5))
    axes.yaxis.set_major_formatter("{x:.0%}")
