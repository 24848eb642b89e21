"""Up to three flights in three dimensions (the paper's Figure 3: a trajectory, its best and its worst replica)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from uavaccel.draw import style

_COLOURS = (style.BLUE, style.GREEN, style.VERMILION)
_LEAST_SPAN_M = 0.2
_LEAST_HEIGHT_SPAN_M = 0.5  # millimetres of altitude are not to look like a climb


@dataclass(frozen=True)
class TrajectoryLine:
    """One flight, `position_m` (n, 3) NED, and what the legend says of it."""

    label: str
    position_m: np.ndarray


def draw_trajectories(lines: Sequence[TrajectoryLine], path: Path, source: str, title: str) -> Path:
    """Write `plot_trajectories` as a PNG; returns `path`."""
    return style.save(plot_trajectories(lines, source, title), path)


def plot_trajectories(lines: Sequence[TrajectoryLine], source: str, title: str) -> Figure:
    """Up to three flights from above and the side, height upwards."""
    with style.project_style():
        figure = style.new_figure(7.2, 6.0, title, source)
        axes: Any = figure.add_subplot(projection="3d")
        for line, colour in zip(lines, _COLOURS, strict=False):
            north, east, down = line.position_m.T
            axes.plot(north, east, -down, color=colour, label=line.label, linewidth=1.2)
        _scale(axes, lines)
        if lines:
            axes.legend(loc="upper left", bbox_to_anchor=(-0.05, 0.98))
        return figure


def _scale(axes: Any, lines: Sequence[TrajectoryLine]) -> None:
    axes.set(xlabel="north x, m", ylabel="east y, m", zlabel="height −z, m")
    axes.view_init(elev=38, azim=-125)
    if not lines:
        return
    points = np.concatenate([line.position_m for line in lines])
    low, high = points.min(axis=0), points.max(axis=0)
    half_m = max(float(np.max((high - low)[:2])), _LEAST_SPAN_M) / 2 * 1.05  # north and east to one scale
    north, east, down = (low + high) / 2
    half_height_m = max(high[2] - low[2], _LEAST_HEIGHT_SPAN_M) / 2
    axes.set_xlim(north - half_m, north + half_m)
    axes.set_ylim(east - half_m, east + half_m)
    axes.set_zlim(-down - half_height_m, -down + half_height_m)
    axes.set_box_aspect((1, 1, 0.45))
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_ticks(_ticks(*axis.get_view_interval()))


def _ticks(low: float, high: float) -> list[float]:
    """Two to six round numbers, none next to the corner, where two axes would write over each other."""
    ticks = MaxNLocator(6, steps=(1, 2, 5, 10)).tick_values(low, high)
    return [float(tick) for tick in ticks if low + 0.08 * (high - low) <= tick <= high]
