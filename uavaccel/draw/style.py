"""The look of figures, films and pages: colour-blind-safe, rendered without a display, reproducible to the byte."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from textwrap import fill
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uavaccel.files import replacing
from uavaccel.resources import require

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Axes3D: TypeAlias = Any  # mpl_toolkits ships no types
LineStyle = dict[str, Any]  # matplotlib's keywords for a line

# Okabe and Ito's palette and two of Tol's, which the common colour-vision deficiencies keep apart.
BLUE, GREEN, VERMILION, PURPLE = "#0072B2", "#009E73", "#D55E00", "#CC79A7"
OLIVE, WINE, GREY, BLACK = "#999933", "#882255", "#7F7F7F", "#000000"
COMMAND_COLOUR = {"adsc": VERMILION, "tcsc": BLUE}
"""ADSC's orange is the palette's darker one, which stands out from white 3.9 to 1; no series has either colour."""
CYCLE = (GREEN, PURPLE, OLIVE, WINE, GREY, BLACK)
MARKERS = "osD^v<>"
LIMIT: LineStyle = {"color": BLACK, "linewidth": 1.0, "linestyle": (0, (4, 3)), "zorder": 1}
"""A line to compare with: what is ideal, alike, the paper's."""
WIDTH_IN, DPI = 6.4, 200
"""Of every figure, so that its letters are of one size beside others, and can be read on a phone."""

_SETTINGS: dict[Any, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 10,
    "axes.titlesize": 10,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "xtick.labelsize": 9,
    "ytick.labelsize": 9,
    "grid.color": "#E3E3E3",
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "legend.fontsize": 9,
    "lines.linewidth": 1.6,
    "savefig.dpi": DPI,
}


@contextmanager
def project_style() -> Iterator[None]:
    """Apply the project's matplotlib settings while a figure is made or saved."""
    import matplotlib as mpl
    from cycler import cycler

    with mpl.rc_context(_SETTINGS | {"axes.prop_cycle": cycler(color=CYCLE)}):
        yield


def new_figure(height_in: float, title: str, source: str = "") -> Figure:
    """Make a figure with a title on top and, where no page says it, the `source` of its numbers at the bottom."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDTH_IN, height_in), layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title, x=0.01, ha="left", fontsize=11.5, fontweight="bold", wrap=True)
    if source:
        figure.supxlabel(source, x=0.01, ha="left", fontsize=9, color="#555555", wrap=True)
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


def colour(number: int) -> str:
    """Return the colour of the nth series of a figure; the cycle starts again where it ends."""
    return CYCLE[number % len(CYCLE)]


def marker(number: int) -> str:
    """Return the marker of the nth series of a figure, or of the nth value of a quantity."""
    return MARKERS[number % len(MARKERS)]


def shade(number: int, count: int) -> str:
    """Return the colour of the nth of `count` values of a quantity, such as a ClockSpeed, from dark to light."""
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    return to_hex(colormaps["viridis"](0.9 * number / max(count - 1, 1)))


def survival(distances_m: ArrayLike, length_m: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the distances at which games (n,) ended, after 0, sorted and cut at the lane's end, and the share of
    games that got beyond each of them, both (n + 1,).
    """
    reached = np.sort(np.minimum(np.asarray(distances_m, float), length_m))
    return np.concatenate([[0.0], reached]), 1.0 - np.arange(len(reached) + 1) / len(reached)


LETTER_IN, LINE_IN = 0.078, 0.17  # width of a letter of a legend, height of a line of its heading


def legend(figure: Figure, more: Mapping[str, LineStyle] = MappingProxyType({})) -> None:
    """Draw one legend below all axes of a figure, with an entry for each label, and `more`; no width is an area.

    Where the figure has a source, it becomes the legend's heading: at the bottom they would lie on each other.
    """
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles: dict[str, Artist] = {}
    for axes in figure.axes:
        drawn, labels = axes.get_legend_handles_labels()
        handles |= dict(zip(labels, drawn, strict=True))
    for label, look in more.items():
        area = look.get("linewidth") == 0
        handles[label] = Patch(color=look["color"], label=label) if area else Line2D([], [], label=label, **look)
    if handles:
        columns = int(WIDTH_IN / (0.5 + LETTER_IN * max(map(len, handles))))
        heading = fill(figure.get_supxlabel(), int(WIDTH_IN / LETTER_IN))
        figure.supxlabel("")
        figure.set_figheight(figure.get_figheight() + LINE_IN * (len(heading.splitlines()) + 1) * bool(heading))
        look = {"ncols": max(columns, 1), "loc": "outside lower center", "title": heading or None, "title_fontsize": 9}
        figure.legend(list(handles.values()), list(handles), **look)


LEAST_SPAN_M, LEAST_HEIGHT_SPAN_M = 0.2, 0.5  # millimetres of altitude are not to look like a climb


def space(axes: Axes3D, flights_m: Sequence[NDArray[np.float64]]) -> None:
    """Scale axes of three dimensions to flights (n, 3) NED drawn with height upwards; north and east to one scale."""
    axes.set(xlabel="north x, m", ylabel="east y, m", zlabel="height −z, m")
    axes.view_init(elev=38, azim=-125)
    if not flights_m:
        return
    from matplotlib.ticker import MaxNLocator

    points = np.concatenate(flights_m)
    least, most = points.min(axis=0), points.max(axis=0)
    half_m = max(float(np.max((most - least)[:2])), LEAST_SPAN_M) / 2 * 1.05
    half_height_m = max(most[2] - least[2], LEAST_HEIGHT_SPAN_M) / 2
    north, east, down = (least + most) / 2
    axes.set(xlim=(north - half_m, north + half_m), ylim=(east - half_m, east + half_m))
    axes.set_zlim(-down - half_height_m, -down + half_height_m)
    axes.set_box_aspect((1, 1, 0.45))
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):  # two to six round numbers
        low, high = axis.get_view_interval()
        ticks = MaxNLocator(6, steps=(1, 2, 5, 10)).tick_values(low, high)
        corner = low + 0.08 * (high - low)  # up to which the labels of two axes would overlap
        axis.set_ticks([float(tick) for tick in ticks if corner <= tick <= high])


Bgr = NDArray[np.uint8]  # (H, W, 3): blue, green, red, as OpenCV has them
NO_EVENT = 246
FULL_COLOUR_FROM = 3  # events per pixel


def check_films() -> None:
    """Raise UserError where no film can be made: without OpenGL, or without the extra `film`."""
    from uavaccel.sim.camera.gl import describe_renderer

    require("av", "MP4", "film")
    require("cv2", "MP4", "film", "opencv-python-headless")
    describe_renderer()


def bgr(colour: str) -> tuple[int, int, int]:
    """Return a colour such as #0072B2 as blue, green, red."""
    red, green, blue = bytes.fromhex(colour[1:])
    return blue, green, red


def dvs_picture(on: NDArray[np.integer], off: NDArray[np.integer]) -> Bgr:
    """Return event counts (H, W) as an image (H, W, 3): the more events, the deeper the colour."""
    shade = np.minimum(on, FULL_COLOUR_FROM) * (FULL_COLOUR_FROM + 1) + np.minimum(off, FULL_COLOUR_FROM)
    return np.asarray(np.take(_SHADES, shade, axis=0))


_DEPTH = np.linspace(0.0, 1.0, FULL_COLOUR_FROM + 1)[:, None]
_ON, _OFF = (_DEPTH * (np.array(bgr(colour)) - NO_EVENT) for colour in (BLUE, VERMILION))
_SHADES = np.clip((NO_EVENT + _ON[:, None] + _OFF).reshape(-1, 3), 0, 255).astype(np.uint8)
"""The colour of each pair of counts up to FULL_COLOUR_FROM, OFF varying fastest; (16, 3)."""


@dataclass(frozen=True)
class Decisions:
    """The decisions of m commands: ratings of the actions (m, actions), the action taken (m,), and the observation.

    `given` (m, planes, H, W) uint8 is the network's input, oldest plane first; None where it is no image. `rated_as`
    says what the ratings are. Sample i of the film's n was taken during command `of_sample[i]`.
    """

    ratings: NDArray[np.float64]
    taken: NDArray[np.int64]
    headings_deg: tuple[float, ...]
    of_sample: NDArray[np.int64]
    rated_as: str
    given: NDArray[np.uint8] | None = None
