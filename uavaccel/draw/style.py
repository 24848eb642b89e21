"""The style shared by all figures: colour-blind-safe, rendered without a display, reproducible to the byte."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeAlias

import matplotlib as mpl
import numpy as np
from cycler import cycler
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from uavaccel.draw.document import Picture
from uavaccel.draw.labels import clock_label as clock_label
from uavaccel.draw.labels import command_at_clock as command_at_clock
from uavaccel.draw.labels import command_name as command_name
from uavaccel.draw.labels import rounds_label as rounds_label
from uavaccel.files import replacing

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
    "axes.prop_cycle": cycler(color=CYCLE),
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
    with mpl.rc_context(_SETTINGS):
        yield


def new_figure(width_in: float, height_in: float, title: str, source: str) -> Figure:
    """Make a figure with a title on top and, at the bottom, the line that says where its numbers come from."""
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
    for each in axes:
        lines, labels = each.get_legend_handles_labels()
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
