"""Success over latency and ClockSpeed, a map per command: what a policy stands."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from uavaccel.draw import style
from uavaccel.metrics.intervals import Proportion

COLOURS = "cividis"  # which the common colour-vision deficiencies keep apart


SuccessMap = Mapping[tuple[float, float], Proportion]  # by latency scale and ClockSpeed


def plot_success_maps(maps: Mapping[str, SuccessMap], fitted: float, title: str, source: str) -> Figure:
    """A panel per name; colour and text are the success, below it its interval; the row `fitted` is framed."""
    scales = sorted({scale for panel in maps.values() for scale, _ in panel})
    clocks = sorted({clock for panel in maps.values() for _, clock in panel})
    with style.project_style():
        figure = style.new_figure(
            1.6 + 0.95 * len(clocks) * len(maps), 1.8 + 0.62 * len(scales), title, source
        )
        row = figure.subplots(1, len(maps), sharey=True, squeeze=False)[0]
        for axes, (name, panel) in zip(row, maps.items(), strict=True):
            ratios = np.array(
                [[panel[s, k].ratio if (s, k) in panel else np.nan for k in clocks] for s in scales]
            )
            image = axes.imshow(ratios, COLOURS, aspect="auto", origin="lower", vmin=0.0, vmax=1.0)
            _write(axes, panel, scales, clocks)
            axes.set_title(name, loc="center")
            axes.set_xticks(range(len(clocks)), [style.clock_label(clock) for clock in clocks])
            axes.set_yticks(range(len(scales)), [f"×{scale:g}" for scale in scales])
            axes.set_xlabel("ClockSpeed")
            axes.grid(visible=False)
            if fitted in scales:
                axes.add_patch(_frame(scales.index(fitted), len(clocks)))
        row[0].set_ylabel("latency, times the fitted one")
        figure.colorbar(image, ax=list(row), label="success", fraction=0.04)
        return figure


def _write(axes: Axes, panel: SuccessMap, scales: Sequence[float], clocks: Sequence[float]) -> None:
    for (scale, clock), success in panel.items():
        place = clocks.index(clock), scales.index(scale)
        colour = "white" if success.ratio < 0.5 else "black"
        axes.annotate(
            f"{success.ratio:.0%}", place, ha="center", va="bottom", color=colour, fontweight="bold"
        )
        interval = "–".join(f"{100 * end:.0f}" for end in success.interval)
        axes.annotate(
            interval,
            place,
            (0, -2),
            textcoords="offset points",
            ha="center",
            va="top",
            color=colour,
            fontsize=7,
        )


def _frame(row: int, columns: int) -> Rectangle:
    return Rectangle((-0.5, row - 0.5), columns, 1.0, fill=False, edgecolor=style.VERMILION, linewidth=2.0)
