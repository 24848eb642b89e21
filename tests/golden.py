"""Reports as text, held against recordings that people have read: tests/data/recorded, written anew with RECORD=1.

A recording has the page without its provenance, summary.json, and each figure by its artists: where what is drawn, in
which colour, what it is called. Numbers have five digits, so that another machine's last bits do not count.
"""

from __future__ import annotations

import difflib
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.collections import Collection, LineCollection, PathCollection
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.text import Annotation

from uavaccel.suites.report import Report

RECORDINGS = Path(__file__).parent / "data/recorded"
SHOWN = 8  # numbers of a longer list that are written out


def assert_as_recorded(name: str, text: str) -> None:
    """Hold a text against the recording of that name."""
    file = RECORDINGS / f"{name}.txt"
    if os.environ.get("RECORD"):
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, encoding="utf-8")
    recorded = file.read_text(encoding="utf-8")
    changes = difflib.unified_diff(recorded.splitlines(), text.splitlines(), "recorded", "now", lineterm="", n=0)
    assert recorded == text, "\n".join(["RECORD=1 pytest writes it anew; read the change:", *changes])


def assert_numbers_as_recorded(name: str, rows: Mapping[str, Sequence[float]]) -> None:
    """Hold numbers against the recording of that name to half a percent, since processors round differently."""
    file = RECORDINGS / f"{name}.txt"
    if os.environ.get("RECORD"):
        lines = (f"{label}: {' '.join(f'{number:.5g}' for number in numbers)}\n" for label, numbers in rows.items())
        file.write_text("".join(lines), encoding="utf-8")
    recorded = dict(line.rsplit(": ", 1) for line in file.read_text(encoding="utf-8").splitlines())
    assert list(rows) == list(recorded)
    for label, numbers in rows.items():
        then = np.array(recorded[label].split(), float)
        np.testing.assert_allclose(numbers, then, rtol=5e-3, atol=2e-3, err_msg=label)


def report_text(report: Report, figures: Mapping[str, Figure]) -> str:
    """A report that has been written, as text; `figures` are those of `record_figures`."""
    page = (report.run.path / "report.md").read_text(encoding="utf-8").partition("\n## Provenance")[0]
    page = page.replace(str(report.run.path.parent), "RUNS")
    return "\n".join([page, "## summary.json\n", *_tree(report.summary), *figures_text(figures)]) + "\n"


def figures_text(figures: Mapping[str, Figure]) -> Iterator[str]:
    """Lines that describe figures."""
    for name, figure in figures.items():
        size_in = " x ".join(map(_number, figure.get_size_inches()))
        yield f"\n## {name}, {size_in} in: {figure.get_suptitle()} | {figure.get_supxlabel()}"
        for axes in figure.axes:
            yield from _axes(axes)
        yield from (f"legend: {_legend(legend)}" for legend in figure.legends)


def _axes(axes: Any) -> Iterator[str]:
    yield f"axes {axes.get_title('left') or axes.get_title()!r}"
    for which in "xyz" if hasattr(axes, "get_zlim") else "xy":
        axis, (low, high) = getattr(axes, f"{which}axis"), getattr(axes, f"get_{which}lim")()
        ticks = [text for label in axis.get_ticklabels() if (text := label.get_text())]
        yield f"  {which} {axis.get_label_text()!r} {axis.get_scale()} {_number(low)} to {_number(high)} {ticks}"
    for artist in axes.get_children():
        is_frame = artist in (axes.patch, axes.title, axes._left_title, *axes.spines.values())
        if not is_frame and (told := _artist(artist)):
            label = str(artist.get_label())
            yield f"  {told}" + (f" {label!r}" if label and not label.startswith("_") else "")
    if names := [str(each.get_label()) for each in axes.containers if not str(each.get_label()).startswith("_")]:
        yield f"  named: {names}"
    if axes.get_legend():
        yield f"  legend: {_legend(axes.get_legend())}"


def _artist(artist: Any) -> str:
    if isinstance(artist, Line2D):
        data: Any = artist.get_data_3d() if hasattr(artist, "get_data_3d") else artist.get_data()
        look = f"{to_hex(artist.get_color())} {artist.get_linestyle()} {artist.get_marker()} {artist.get_drawstyle()}"
        alpha = "" if artist.get_alpha() is None else f" {artist.get_alpha():.3g}"
        width = (
            f" {artist.get_linewidth():g} wide" if artist.get_linestyle() != "None" else f" {artist.get_markersize():g}"
        )
        return f"line {look}{width}{alpha}: {' | '.join(map(numbers, data))}" if len(data[0]) else ""
    if isinstance(artist, Annotation):
        colour = to_hex(artist.get_color())
        return f"note {artist.get_text()!r} {colour} {numbers(artist.xy)} from {numbers(artist.xyann)}"
    if hasattr(artist, "get_text"):
        return f"text {artist.get_text()!r} {numbers(artist.get_position())}" if artist.get_text() else ""
    if isinstance(artist, Collection):
        return _collection(artist)
    if isinstance(artist, Patch):
        corners = artist.get_patch_transform().transform(artist.get_path().vertices)
        look = to_hex(artist.get_facecolor()) if artist.get_fill() else f"around {to_hex(artist.get_edgecolor())}"
        return f"patch {look}: {numbers(corners)}"
    return f"image {numbers(artist.get_array())}" if hasattr(artist, "get_array") else ""


def _collection(artist: Any) -> str:
    colours = [to_hex(colour) for colour in [*artist.get_facecolor()[:1], *artist.get_edgecolor()[:1]]]
    if isinstance(artist, LineCollection):
        return f"bars {colours}: {numbers(artist.get_segments())}"
    if isinstance(artist, PathCollection):
        return f"points {colours}: {numbers(artist.get_offsets())} of size {numbers(artist.get_sizes())}"
    values = [] if artist.get_array() is None else artist.get_array()
    return f"area {colours}: {numbers([path.vertices for path in artist.get_paths()][:1])} {numbers(values)}"


def _legend(legend: Any) -> str:
    entries = zip(legend.get_texts(), legend.legend_handles, strict=True)
    return f"{legend.get_title().get_text()} {[f'{text.get_text()} {_colour(handle)}' for text, handle in entries]}"


def _colour(artist: Any) -> str:
    if isinstance(artist, Line2D):
        return f"{to_hex(artist.get_color())} {artist.get_linestyle()}"
    return to_hex([*np.reshape(artist.get_facecolor(), (-1, 4)), *np.reshape(artist.get_edgecolor(), (-1, 4))][0])


def numbers(values: Any) -> str:
    """A list of any shape; of a long one its first, last, number and sum."""
    if any(np.shape(value) for value in values) and len({np.shape(value) for value in values}) > 1:
        return " ".join(map(numbers, values))
    flat = np.asarray(values, float).ravel()
    if len(flat) <= SHOWN:
        return " ".join(map(_number, flat))
    weights = np.arange(1, len(flat) + 1)  # an order that changes is another sum
    known = np.nan_to_num(flat)
    shown = " ".join(map(_number, [*flat[: SHOWN // 2], *flat[-2:]]))
    return f"{shown} of {len(flat)}, {_number(float(known @ weights / weights.sum()))}"


def _number(value: float) -> str:
    return f"{value:.5g}" if not abs(value) < 5e-7 else "0"


def _tree(summary: Mapping[str, Any]) -> Iterator[str]:
    """Plain data, a line for each key, and for each entry of a list of mappings."""
    for key, value in summary.items():
        entries = value if _is_list(value) and any(isinstance(each, Mapping) for each in value) else [value]
        for entry in entries:
            yield f"{key}: {plain(entry)}"


def _is_list(value: Any) -> bool:
    return isinstance(value, Sequence) and not isinstance(value, str)


def plain(value: Any) -> str:
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{key} {plain(each)}' for key, each in value.items())}}}"
    if isinstance(value, bool | np.bool_ | str) or value is None:
        return str(value)
    if _is_list(value):
        return f"[{', '.join(map(plain, value))}]"
    return _number(float(value)) if isinstance(value, int | float | np.number) else str(value)
