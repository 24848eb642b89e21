"""The style that all figures share: colour-blind-safe, drawn without a display, the same bytes every time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeAlias

import matplotlib as mpl
import numpy as np
from cycler import cycler
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from uavaccel.files import Plain, replacing
from uavaccel.metrics.intervals import Proportion

# Okabe and Ito's palette, which the common colour-vision deficiencies keep apart.
BLUE, ORANGE, GREEN, VERMILION = "#0072B2", "#E69F00", "#009E73", "#D55E00"
PURPLE, SKY, BLACK, GREY = "#CC79A7", "#56B4E9", "#000000", "#7F7F7F"
CYCLE = (BLUE, ORANGE, GREEN, VERMILION, PURPLE, SKY)
COMMAND_COLOUR = {"adsc": VERMILION, "tcsc": BLUE}

Axes3D: TypeAlias = Any  # of mpl_toolkits, which has no types
LineStyle = dict[str, Any]  # keywords of matplotlib's for a line

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
    """The project's matplotlib settings, while one figure is made or saved."""
    with mpl.rc_context(_SETTINGS):
        yield


def new_figure(width_in: float, height_in: float, title: str, source: str) -> Figure:
    """A figure with a title on top and, below, the line that says where its numbers come from."""
    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title, x=0.01, ha="left", fontsize=11.5, fontweight="bold")
    figure.supxlabel(source, x=0.01, ha="left", fontsize=8, color="#555555")
    return figure


def note(axes: Axes, text: str) -> None:
    """Written in the middle of axes that have nothing to show."""
    axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", va="center", color=GREY)
    axes.set(xticks=[], yticks=[])


def save(figure: Figure, path: Path) -> Path:
    """Write a PNG without dates or versions, so that equal figures are equal files; returns `path`."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with project_style(), replacing(path) as file:
        figure.savefig(file, format="png", metadata={"Software": None})
    return path


def command_name(command: str) -> str:
    """A command as it is written in the figures and tables: ADSC, TCSC."""
    return command.upper()


def rounds_label(rounds: int) -> str:
    """1 round, 24 rounds."""
    return f"{rounds} round" if rounds == 1 else f"{rounds} rounds"


def clock_label(clock_speed: float) -> str:
    """A ClockSpeed as it is written in the figures and tables: 1x, 1.5x, 100x."""
    return f"{clock_speed:g}x"


def command_at_clock(game: Mapping[str, Plain]) -> str:
    """Command and ClockSpeed of a row or a task: TCSC at 5x."""
    return f"{command_name(game['command'])} at {clock_label(game['clock_speed'])}"


def error_bars(success: Sequence[Proportion]) -> NDArray[np.float64]:
    """How far their intervals reach below and above the ratios, (2, n), as matplotlib's errorbar takes it."""
    return bars([each.ratio for each in success], [each.interval for each in success])


def bars(values: Sequence[float], intervals: Sequence[tuple[float, float]]) -> NDArray[np.float64]:
    """The same of any values (n,) with the ends of their intervals."""
    value, ends = np.array(values), np.array(intervals)
    return np.maximum([value - ends[:, 0], ends[:, 1] - value], 0.0)
