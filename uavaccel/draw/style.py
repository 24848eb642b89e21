"""The style shared by all figures: colour-blind-safe, rendered without a display, reproducible to the byte."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uavaccel.draw.labels import clock_label as clock_label
from uavaccel.draw.labels import command_at_clock as command_at_clock
from uavaccel.draw.labels import command_name as command_name
from uavaccel.draw.labels import rounds_label as rounds_label
from uavaccel.draw.page import Picture
from uavaccel.files import replacing

if TYPE_CHECKING:  # matplotlib is loaded by what draws
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Okabe and Ito's palette, which the common colour-vision deficiencies keep apart.
BLUE, ORANGE, GREEN, VERMILION = "#0072B2", "#E69F00", "#009E73", "#D55E00"
PURPLE, SKY, BLACK, GREY = "#CC79A7", "#56B4E9", "#000000", "#7F7F7F"
CYCLE = (BLUE, ORANGE, GREEN, VERMILION, PURPLE, SKY)
MARKERS = "osD^v<>"
COMMAND_COLOUR = {"adsc": VERMILION, "tcsc": BLUE}

Axes3D: TypeAlias = Any  # mpl_toolkits ships no types
LineStyle = dict[str, Any]  # matplotlib's keywords for a line

_SETTINGS: dict[Any, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 9,
    "axes.titlesize": 10,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#E3E3E3",
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "lines.linewidth": 1.6,
    "savefig.dpi": 150,
}


@contextmanager
def project_style() -> Iterator[None]:
    """Apply the project's matplotlib settings while a figure is made or saved."""
    import matplotlib as mpl
    from cycler import cycler

    with mpl.rc_context(_SETTINGS | {"axes.prop_cycle": cycler(color=CYCLE)}):
        yield


def new_figure(width_in: float, height_in: float, title: str, source: str) -> Figure:
    """Make a figure with a title on top and, at the bottom, the line that says where its numbers come from."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title, x=0.01, ha="left", fontsize=11.5, fontweight="bold")
    figure.supxlabel(source, x=0.01, ha="left", fontsize=8, color="#555555")
    return figure


def note(axes: Axes, text: str) -> None:
    """Write a note in the middle of axes that have no data to show."""
    axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", va="center", color=GREY)
    axes.set(xticks=[], yticks=[])


def save(figure: Figure, path: Path) -> Path:
    """Write a PNG without dates or versions, so that equal figures are equal files, and return `path`."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with project_style(), replacing(path) as file:
        figure.savefig(file, format="png", metadata={"Software": None})
    return path


def picture(figure: Figure, path: Path, caption: str, source: str) -> Picture:
    """Save a figure and return it as a block of a report, its caption followed by the source of its numbers."""
    return Picture(save(figure, path), f"{caption} Source: {source}.")


def colour(number: int) -> str:
    """Return the colour of the nth series of a figure; the cycle starts again where it ends."""
    return CYCLE[number % len(CYCLE)]


def shared_legend(figure: Figure, axes: Iterable[Axes]) -> None:
    """Draw one legend for several axes beside them, with an entry for each label."""
    handles: dict[str, Artist] = {}
    for axis in axes:
        lines, labels = axis.get_legend_handles_labels()
        handles |= dict(zip(labels, lines, strict=True))
    figure.legend(list(handles.values()), list(handles), loc="outside right upper")


def error_bars(values: Sequence[float], intervals: Sequence[tuple[float, float]]) -> NDArray[np.float64]:
    """Return the distances (2, n) of values (n,) from the ends of their intervals, as matplotlib takes them."""
    value, ends = np.array(values), np.array(intervals)
    return np.maximum([value - ends[:, 0], ends[:, 1] - value], 0.0)


def survival(distances_m: ArrayLike, length_m: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the distances at which games (n,) ended, after 0, sorted and cut at the lane's end, and the share of
    games that got beyond each of them, both (n + 1,).
    """
    reached = np.sort(np.minimum(np.asarray(distances_m, float), length_m))
    return np.concatenate([[0.0], reached]), 1.0 - np.arange(len(reached) + 1) / len(reached)


def series(number: int) -> LineStyle:
    """Return colour and marker of the nth series of a figure."""
    return {"color": colour(number), "marker": MARKERS[number % len(MARKERS)]}


def key(figure: Figure, axes: Axes, others: dict[str, LineStyle]) -> None:
    """Draw one legend above a figure: the lines of `axes`, and others by their labels; one of no width is an area."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles, _ = axes.get_legend_handles_labels()
    for label, look in others.items():
        area = look.get("linewidth") == 0
        handles.append(Patch(color=look["color"], label=label) if area else Line2D([], [], label=label, **look))
    figure.legend(handles=handles, ncols=len(handles), loc="outside upper right")


LEAST_SPAN_M, LEAST_HEIGHT_SPAN_M = 0.2, 0.5  # millimetres of altitude are not to look like a climb


def space(axes: Axes3D, flights_m: Sequence[NDArray[np.float64]]) -> None:
    """Scale axes of three dimensions to flights (n, 3) NED drawn with height upwards; north and east to one scale."""
    axes.set(xlabel="north x, m", ylabel="east y, m", zlabel="height −z, m")
    axes.view_init(elev=38, azim=-125)
    if not flights_m:
        return
    axes.legend(loc="upper left", bbox_to_anchor=(-0.05, 0.98))
    points = np.concatenate(flights_m)
    low, high = points.min(axis=0), points.max(axis=0)
    half_m = max(float(np.max((high - low)[:2])), LEAST_SPAN_M) / 2 * 1.05
    half_height_m = max(high[2] - low[2], LEAST_HEIGHT_SPAN_M) / 2
    north, east, down = (low + high) / 2
    axes.set(xlim=(north - half_m, north + half_m), ylim=(east - half_m, east + half_m))
    axes.set_zlim(-down - half_height_m, -down + half_height_m)
    axes.set_box_aspect((1, 1, 0.45))
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_ticks(_ticks(*axis.get_view_interval()))


def _ticks(low: float, high: float) -> list[float]:
    """Return two to six round numbers, none next to a corner, where the labels of two axes would overlap."""
    from matplotlib.ticker import MaxNLocator

    ticks = MaxNLocator(6, steps=(1, 2, 5, 10)).tick_values(low, high)
    return [float(tick) for tick in ticks if low + 0.08 * (high - low) <= tick <= high]
