"""What tests read off figures: the numbers that are drawn, by artist."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch

from tests.conftest import write_no_picture
from uavaccel.draw import style

Points = list[tuple[float, float]]


def record_figures(monkeypatch: pytest.MonkeyPatch) -> dict[str, Figure]:
    """The figures that are saved from here on, by their file's stem; in place of a PNG a few bytes are written."""
    figures: dict[str, Figure] = {}

    def save(figure: Figure, path: Path) -> Path:
        figures[path.stem] = figure
        return write_no_picture(path)

    monkeypatch.setattr(style, "save", save)
    return figures


def headline(figure: Any) -> tuple[str, str]:
    """The figure's title and what stands below it."""
    return figure.get_suptitle(), figure.get_supxlabel()


def points(line: Any) -> Points:
    """The points of a line, or of one with intervals, as (x, y)."""
    line = getattr(line, "lines", [line])[0]
    return list(zip(*(np.asarray(line.get_data(), float).round(12).tolist()), strict=True))


def labelled(axes: Any) -> dict[str, Any]:
    """What the legend names, by its label."""
    handles, labels = axes.get_legend_handles_labels()
    return dict(zip(labels, handles, strict=True))


def boxes(axes: Any) -> dict[float, dict[str, Any]]:
    """Boxplots by place: lower and upper quartile, median, whiskers' ends and colour."""
    found: dict[float, dict[str, Any]] = {}
    for patch in (patch for patch in axes.patches if isinstance(patch, PathPatch)):
        x, y = np.asarray(patch.get_path().vertices).round(12).T
        place = float(x.min() + x.max()) / 2
        found[round(place, 9)] = {"box": (y.min(), y.max()), "colour": to_hex(patch.get_facecolor())}
    for line in axes.lines[1:]:  # the first is the line across
        x, y = np.asarray(line.get_xdata(), float), np.asarray(line.get_ydata(), float)
        if not x.size:
            continue
        box = found[round(float(x[0] + x[-1]) / 2, 9)]
        if line.get_marker() == ".":
            box["outliers"] = y.tolist()
        elif x[0] == x[-1]:
            box.setdefault("whiskers", []).append(float(y[1]))
        elif line.get_linewidth() > 2:
            box["median"] = float(y[0])
    return found


def texts(axes: Any) -> list[str]:
    """Everything written inside the axes."""
    return [text.get_text() for text in axes.texts]
