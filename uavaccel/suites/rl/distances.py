"""How far policies got down the lane, with the rows of obstacles that stopped them (the paper's Figure 8)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from uavaccel.draw import style
from uavaccel.sim.lane.layout import LENGTH_M

BIN_M = 2.0

Distances = Mapping[str, Mapping[float, Sequence[float]]]


def plot_distances(panels: Distances, rows_m: Sequence[float], source: str) -> Figure:
    """A column per panel: the share of games that got so far, and below where they ended; a line per ClockSpeed.

    `panels[title][clock_speed]` holds the distances of games in metres; `rows_m` are marked.
    """
    clocks = sorted({clock for panel in panels.values() for clock in panel})
    with style.project_style():
        figure = style.new_figure(1.5 + 5.2 * len(panels), 6.4, "Distance travelled", source)
        grid = figure.subplots(2, len(panels), sharex=True, sharey="row", squeeze=False, height_ratios=[3, 2])
        for (upper, lower), (title, panel) in zip(grid.T, panels.items(), strict=True):
            upper.set_title(title, loc="center")
            for clock in sorted(panel):
                colour = style.CYCLE[clocks.index(clock) % len(style.CYCLE)]
                _draw(upper, lower, np.minimum(np.asarray(panel[clock], float), LENGTH_M), clock, colour)
            for axes in (upper, lower):
                for row_m in rows_m:
                    axes.axvline(row_m, color=style.GREY, linewidth=0.7, linestyle=":", zorder=0)
            upper.axvline(LENGTH_M, color=style.BLACK, linewidth=1.0, linestyle="--")
            lower.set_xlabel("distance north, m (dotted: rows of obstacles)")
        grid[0, 0].set(ylabel="share of games that got there", ylim=(0.0, 1.05))
        grid[1, 0].set_ylabel(f"share of games that ended\nin {BIN_M:g} m")
        handles: dict[str, Artist] = {}
        for axes in grid[0]:
            lines, names = axes.get_legend_handles_labels()
            handles |= dict(zip(names, lines, strict=True))
        figure.legend(list(handles.values()), list(handles), loc="outside right upper")
        return figure


def _draw(upper: Axes, lower: Axes, distances_m: np.ndarray, clock: float, colour: str) -> None:
    reached = np.sort(distances_m)
    share = 1.0 - np.arange(len(reached) + 1) / len(reached)
    label = f"{style.clock_label(clock)}, {len(reached)} games"
    upper.step(np.concatenate([[0.0], reached]), share, where="post", color=colour, label=label)
    ended = reached[reached < LENGTH_M]
    counts, edges = np.histogram(ended, np.arange(0.0, LENGTH_M + BIN_M, BIN_M))
    lower.stairs(counts / len(reached), edges, color=colour)
