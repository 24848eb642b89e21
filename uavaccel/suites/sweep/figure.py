"""Success as one condition after another departs from the training's: a panel per condition."""

from __future__ import annotations

import math
from collections.abc import Mapping

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from uavaccel.draw import style
from uavaccel.metrics.intervals import Proportion

COLUMNS = 3


def plot_sweeps(
    sweeps: Mapping[str, Mapping[str, Proportion]], as_trained: float | None, title: str, source: str
) -> Figure:
    """A panel per condition, the success at each of its values; dashed that under the conditions of the training."""
    columns = max(min(len(sweeps), COLUMNS), 1)
    rows = max(math.ceil(len(sweeps) / columns), 1)
    with style.project_style():
        figure = style.new_figure(max(2.9 * columns, 5.0), 0.9 + 2.2 * rows, title, source)
        panels = figure.subplots(rows, columns, sharey=True, squeeze=False).ravel()
        for axes, (name, success) in zip(panels, sweeps.items(), strict=False):
            _plot(axes, success, as_trained)
            axes.set_xlabel(name)
        for axes in panels[len(sweeps) :]:
            axes.set_visible(False)
        for axes in panels[::columns]:
            axes.set_ylabel("success")
        return figure


def _plot(axes: Axes, success: Mapping[str, Proportion], as_trained: float | None) -> None:
    places, won = range(len(success)), list(success.values())
    ratios, reach = [each.ratio for each in won], style.error_bars(won)
    axes.errorbar(places, ratios, reach, color=style.BLUE, marker="o", markersize=4, capsize=3)
    if as_trained is not None:
        axes.axhline(as_trained, color=style.GREY, linestyle="--", linewidth=1.0)
    axes.set_xticks(list(places), list(success))
    axes.set(ylim=(-0.03, 1.03), xlim=(-0.5, len(success) - 0.5))
    axes.yaxis.set_major_formatter("{x:.0%}")
