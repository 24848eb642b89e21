"""What all figures are drawn with: grids of panels, boxes, lines with intervals, bands, stacked bars."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from uavaccel.draw import style
from uavaccel.draw.page import Table, clock_label, unknown

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Form: TypeAlias = str | Callable[[Any], str]
"""How a value is written: a format such as "{:.2f}", or a function."""
Span: TypeAlias = tuple[str, Form]
"""A column of a table of spans: the entries' key, and how its values are written."""
UNITS_S = {"hours": 3600.0, "minutes": 60.0, "seconds": 1.0}


def panels(
    count: int, title: str, height_in: float = 2.2, across: int = 3, empty: str = "", source: str = "", **options: Any
) -> tuple[Figure, list[Axes]]:
    """Return a figure with `count` axes, at most so many in a row; without any, with one that says that it is `empty`.

    `height_in` is that of a panel in inches, `options` are those of `Figure.subplots`.
    """
    columns = max(min(count, across), 1)
    rows = max(math.ceil(count / columns), 1)
    figure = style.new_figure(1.0 + height_in * rows, title, source)
    grid = list(figure.subplots(rows, columns, squeeze=False, **options).flat)
    for axes in grid[max(count, 1) :]:
        axes.remove()
    for place in range(max(count - columns, 0), count):  # the lowest of their columns
        grid[place].xaxis.set_tick_params(which="both", labelbottom=True)
    if not count:
        style.note(grid[0], empty)
    return figure, grid[:count]


def facets(
    table: pd.DataFrame, by: str, title: str, **options: Any
) -> tuple[Figure, list[tuple[Axes, Any, pd.DataFrame]]]:
    """Return a figure with a panel for each value of a column: axes of the same scales, value, part of the table.

    The `options` are those of `panels`.
    """
    parts = list(table.groupby(by, sort=False))
    figure, grid = panels(len(parts), title, **{"sharex": True, "sharey": True, **options})
    return figure, [(axes, *part) for axes, part in zip(grid, parts, strict=True)]


def label_outer(panels: Sequence[Axes]) -> None:
    """Leave the labels of an axis that panels share to the lowest of each column, or to the leftmost of each row."""
    specs: dict[Axes, Any] = {axes: axes.get_subplotspec() for axes in panels}
    places = {(spec.rowspan.start, spec.colspan.start) for spec in specs.values()}
    for axes, spec in specs.items():
        if (spec.rowspan.start + 1, spec.colspan.start) in places:
            axes.tick_params(labelbottom=False)
            axes.set_xlabel("")
        if spec.colspan.start and axes.get_shared_y_axes().joined(axes, panels[0]):
            axes.tick_params(labelleft=False)
            axes.set_ylabel("")


def boxes(axes: Axes, values: Mapping[Any, Sequence[float]], colour: str, name: str, place: float = 0.0) -> None:
    """Draw a box for each entry that has values, `place` beside its label; equal values make a box of no height."""
    drawn = {number + place: value for number, value in enumerate(values.values()) if len(value)}
    line = {"color": colour}
    axes.boxplot(
        list(drawn.values()),
        positions=list(drawn),
        widths=0.34 if place else 0.62,
        patch_artist=True,
        manage_ticks=False,
        boxprops={"facecolor": colour, "edgecolor": colour, "alpha": 0.45, "linewidth": 1.0},
        medianprops={**line, "linewidth": 2.4, "solid_capstyle": "butt"},
        whiskerprops=line,
        capprops=line,
        flierprops={"marker": ".", "markersize": 3, "markeredgecolor": colour},
    )
    axes.plot([], [], color=colour, linewidth=6, alpha=0.45, label=name)
    axes.set_xticks(range(len(values)), [str(label) for label in values])
    axes.set_xlim(-0.6, len(values) - 0.4)
    axes.grid(axis="x", visible=False)


def line(axes: Axes, x: ArrayLike, y: ArrayLike, ends: tuple[ArrayLike, ArrayLike] | None = None, **look: Any) -> None:
    """Draw a line through the known of some points (n,), with bars between the `ends`, low and high, that are known."""
    x, y = np.asarray(x, float), np.asarray(y, float)
    low, high = (np.where(np.isfinite(end), end, y) for end in np.asarray(ends or (y, y), float))
    drawn, known = {"marker": "o", "markersize": 5, "capsize": 2, **look}, np.isfinite(y)
    bars = np.maximum([(y - low)[known], (high - y)[known]], 0.0) if ends else None
    axes.errorbar(x[known], y[known], yerr=bars, **drawn)


def beside(number: int, count: int, apart: float) -> float:
    """Return how far aside the nth of `count` lines is drawn, so that equal ones do not hide each other."""
    return apart * (number - (count - 1) / 2)


def band(
    axes: Axes, x: ArrayLike, y: ArrayLike, low: ArrayLike, high: ArrayLike, step: bool = False, **look: Any
) -> None:
    """Draw a line (n,) in the band between two others; with `step` each value holds up to the next."""
    (drawn,) = axes.plot(x, y, drawstyle="steps-post" if step else "default", **look)
    axes.fill_between(
        np.asarray(x), low, high, step="post" if step else None, color=drawn.get_color(), alpha=0.18, linewidth=0
    )


def success_map(axes: Axes, ratios: ArrayLike, **options: Any) -> None:
    """Colour a table of success (rows, columns), by colours that the common colour-vision deficiencies keep apart.

    The `options` are those of `Axes.imshow`.
    """
    axes.imshow(ratios, "cividis", aspect="auto", vmin=0.0, vmax=1.0, **options)
    axes.grid(visible=False)


def ink_on(ratio: float) -> str:
    """Return the colour of text on a cell of `success_map`."""
    return "white" if ratio < 0.5 else "black"


def clock_axis(axes: Axes, clocks: Sequence[float]) -> None:
    """Label places 0, 1, ... with ClockSpeeds, which are at equal distances so that the highest can be told apart."""
    axes.set_xticks(range(len(clocks)), [clock_label(clock) for clock in clocks])
    axes.set(xlabel="ClockSpeed", xlim=(-0.4, len(clocks) - 0.6))


def log_axis(axes: Axes, which: str, form: str = "{:g}") -> None:
    """Make an axis, x or y, logarithmic, with labels at 1, 2 and 5 of a decade, or at powers of ten on a long one."""
    from matplotlib.ticker import LogLocator, NullFormatter

    axis = getattr(axes, f"{which}axis")
    axes.set(**{f"{which}scale": "log"})
    low, high = axis.get_view_interval()
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high < 300.0 * low else (1.0,)))
    axis.set_major_formatter(lambda value, _: form.format(value))
    axis.set_minor_formatter(NullFormatter())


def time_unit(longest_s: float) -> str:
    """Return the largest unit of time in which the longest of several times is 1 or more."""
    return next((unit for unit, unit_s in UNITS_S.items() if longest_s >= unit_s), "seconds")


def phases(axes: Axes, phase_s: pd.DataFrame, unit: str, notes: Sequence[str]) -> None:
    """Draw a bar for each line of a table from the top down, its columns, in seconds, stacked, a note at its end."""
    below = np.zeros(len(phase_s))
    for phase, colour in zip(phase_s, style.CYCLE, strict=False):
        spent = phase_s[phase].to_numpy() / UNITS_S[unit]
        axes.barh(range(len(phase_s)), spent, 0.7, below, color=colour, label=str(phase).replace("_", " "))
        below += spent
    for place, (end, text) in enumerate(zip(below, notes, strict=True)):
        axes.annotate(text, (end, place), (4, 0), textcoords="offset points", va="center", fontsize=9)
    axes.set_yticks(range(len(phase_s)), [str(label) for label in phase_s.index])
    axes.set(xlabel=unit, xlim=(0.0, 1.35 * max(below.max(), 1e-9)), ylim=(len(phase_s) - 0.4, -0.6))
    axes.grid(axis="y", visible=False)


def span(values: Iterable[Any], form: Form = "{:.2f}") -> str:
    """Return the least and the greatest of the known values, as in "1.00 to 9.87"; "-" where none is known."""
    known, text = [value for value in values if not unknown(value)], form.format if isinstance(form, str) else form
    if not known:
        return "-"
    low, high = text(min(known)), text(max(known))
    return low if low == high else f"{low} to {high}"


def span_table(entries: pd.DataFrame, by: list[str], columns: Mapping[str, Span], folded: str = "") -> Table:
    """Return a table with a line for each group of entries, and in it the spans of the group's values."""
    groups = entries.groupby(by)
    spans = {header: groups[name].agg(partial(span, form=form)) for header, (name, form) in columns.items()}
    return Table(tuple(spans), pd.DataFrame(spans).to_numpy().tolist(), folded)
