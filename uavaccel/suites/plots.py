"""Plots that several suites draw: grids of panels, boxes, points with intervals, stacked bars, survival."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from itertools import product
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from uavaccel.draw import style
from uavaccel.draw.labels import clock_label
from uavaccel.draw.page import Table, unknown
from uavaccel.metrics.intervals import Proportion

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Form: TypeAlias = str | Callable[[Any], str]
"""How a value is written: a format such as "{:.2f}", or a function."""
Span: TypeAlias = tuple[str, Form]
"""A column of a table of spans: the entries' key, and how its values are written."""
UNITS_S = {"hours": 3600.0, "minutes": 60.0, "seconds": 1.0}


def panels(
    rows: int, columns: int, title: str, source: str, size_in: tuple[float, float], empty: str = "", **options: Any
) -> tuple[Figure, NDArray[Any]]:
    """Return a figure and its axes (rows, columns); where either is 0, those of one panel that says that it is `empty`.

    `size_in` is the width and height of a panel in inches; `options` are those of `Figure.subplots`.
    """
    shape = max(rows, 1), max(columns, 1)
    figure = style.new_figure(1.6 + size_in[0] * shape[1], 1.2 + size_in[1] * shape[0], title, source)
    grid = figure.subplots(*shape, squeeze=False, **options)
    if not rows * columns:
        style.note(grid[0, 0], empty)
    return figure, grid


def facets(
    table: pd.DataFrame, by: tuple[str | None, str | None], *labels: Any
) -> tuple[Figure, list[tuple[Axes, tuple[Any, Any], pd.DataFrame]]]:
    """Return a figure with a row of panels for each value of one column and a column of them for each of another.

    With it are the panels: axes, which have the same scales, the two values, and their part of the table. `labels` are
    the further arguments of `panels`: title, source, size and the note of an empty figure.
    """
    values = [sorted(table[name].unique()) if name else [None] for name in by]
    figure, grid = panels(len(values[0]), len(values[1]), *labels, sharex=True, sharey=True)
    parts = []
    for axes, pair in zip(grid.flat, product(*values), strict=False):
        wanted = {name: value for name, value in zip(by, pair, strict=True) if name}
        parts.append((axes, pair, table[(table[list(wanted)] == pd.Series(wanted)).all(axis=1)]))
    return figure, parts


def boxes(axes: Axes, values: Mapping[Any, Sequence[float]], colour: str, empty: str) -> None:
    """Draw a box for each entry that has values, its label below; equal values make a box of zero width."""
    drawn = {place: value for place, value in enumerate(values.values()) if len(value)}
    if drawn:
        line = {"color": colour}
        axes.boxplot(
            list(drawn.values()),
            positions=list(drawn),
            widths=0.62,
            patch_artist=True,
            manage_ticks=False,
            boxprops={"facecolor": colour, "edgecolor": colour, "alpha": 0.45, "linewidth": 1.0},
            medianprops={**line, "linewidth": 2.4, "solid_capstyle": "butt"},
            whiskerprops=line,
            capprops=line,
            flierprops={"marker": ".", "markersize": 3, "markeredgecolor": colour},
        )
    else:
        axes.text(0.5, 0.15, empty, transform=axes.transAxes, ha="center", color=style.GREY)
    axes.set_xticks(range(len(values)), [str(label) for label in values])
    axes.set_xlim(-0.6, len(values) - 0.4)
    axes.grid(axis="x", visible=False)


def points(axes: Axes, x: ArrayLike, y: Sequence[float], intervals: Sequence[Any], **line: Any) -> None:
    """Plot a line through points (n,) with their intervals, (low, high) or None where there is none."""
    ends = [(at, at) if interval is None else tuple(interval) for at, interval in zip(y, intervals, strict=True)]
    drawn = {"marker": "o", "markersize": 4.5, "capsize": 2, **line}
    axes.errorbar(x, y, yerr=style.error_bars(list(y), ends), **drawn)


def clock_axis(axes: Axes, clocks: Sequence[float]) -> None:
    """Label places 0, 1, ... with ClockSpeeds, which are at equal distances so that the highest can be told apart."""
    axes.set_xticks(range(len(clocks)), [clock_label(clock) for clock in clocks])
    axes.set_xlabel("ClockSpeed")


def factor_axis(axes: Axes) -> None:
    """Make the vertical axis logarithmic, labelled 1x, 2x, 5x, 10x."""
    from matplotlib.ticker import LogLocator, NullFormatter

    axes.set_yscale("log")
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter("{x:g}x")
    axes.yaxis.set_minor_formatter(NullFormatter())


def survival_band(axes: Axes, distances_m: ArrayLike, length_m: float, **line: Any) -> None:
    """Plot the share of games (n,) that got beyond each distance, in its 95 % Wilson interval."""
    places, share = style.survival(distances_m, length_m)
    games = len(places) - 1
    (drawn,) = axes.step(places, share, where="post", **line)
    low, high = zip(*(Proportion(left, games).interval for left in range(games, -1, -1)), strict=True)
    axes.fill_between(places, low, high, step="post", color=drawn.get_color(), alpha=0.15, linewidth=0)


def time_unit(longest_s: float) -> str:
    """Return the largest unit of time in which the longest of several times is 1 or more."""
    return next((unit for unit, unit_s in UNITS_S.items() if longest_s >= unit_s), "seconds")


def phases(axes: Axes, phase_s: pd.DataFrame, unit: str, speeds: Mapping[str, tuple[pd.Series, str]]) -> Axes:
    """Draw a bar for each line of a table, its columns, in seconds, stacked, and speeds as points on axes of their own.

    `unit` is that of the bars; `speeds` have values, where they are known, and a marker by label. Returns their axes.
    """
    below, places = np.zeros(len(phase_s)), range(len(phase_s))
    for phase, colour in zip(phase_s, style.CYCLE, strict=False):
        spent = phase_s[phase].to_numpy() / UNITS_S[unit]
        axes.bar(places, spent, 0.55, below, color=colour, label=str(phase).replace("_", " "))
        below += spent
    axes.set_xticks(places, [str(label) for label in phase_s.index])
    axes.set_xlim(-0.6, len(phase_s) - 0.4)
    speed = axes.twinx()
    for label, (values, marker) in speeds.items():
        if values.notna().any():
            speed.plot(places, values.astype(float), marker, color=style.BLACK, label=label, markersize=6)
    speed.set_ylim(bottom=0.0)
    speed.grid(visible=False)
    return speed


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
