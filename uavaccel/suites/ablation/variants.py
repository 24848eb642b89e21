"""Accuracy and speed-up over the variants of an ablation: a curve per command and ClockSpeed."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from uavaccel.draw import style
from uavaccel.suites.report import SummaryCell

SIMILAR_STLC = 1.8
_LINES = {"adsc": "-", "tcsc": "--"}


@dataclass(frozen=True)
class VariantCurve:
    """One command and ClockSpeed: the variants' places, numbers or names, and their values, arrays (variants,)."""

    command: str
    clock_speed: float
    places: Sequence[float | str]
    stlc: np.ndarray
    position_rmse_m: np.ndarray
    speedup: np.ndarray


def curves(entries: Sequence[SummaryCell], times_clock_speed: bool) -> list[VariantCurve]:
    """A curve a command and ClockSpeed; a value without anything to compare with is NaN."""
    grouped: dict[tuple[str, float], list[SummaryCell]] = defaultdict(list)
    for entry in entries:
        grouped[entry["command"], entry["clock_speed"]].append(entry)
    return [
        VariantCurve(
            command,
            clock_speed,
            [_place(entry["variant"], clock_speed if times_clock_speed else 1.0) for entry in own],
            np.array([(entry["stlc_quartiles"] or [np.nan] * 3)[1] for entry in own], float),
            np.array([entry["position_rmse_m_median"] for entry in own], float),
            np.array([entry["effective_speedup"] for entry in own], float),
        )
        for (command, clock_speed), own in sorted(grouped.items())
    ]


def _place(name: str, factor: float) -> float | str:
    try:
        return float(name) * factor
    except ValueError:
        return name


def plot_variants(curves: Sequence[VariantCurve], axis: str, title: str, source: str) -> Figure:
    """Three panels: STLC, position error and speed-up; places that are numbers on a logarithmic axis."""
    with style.project_style():
        figure = style.new_figure(12, 4.2, title, source)
        panels = figure.subplots(1, 3)
        clocks = sorted({curve.clock_speed for curve in curves})
        for axes, name, label in zip(
            panels,
            ("stlc", "position_rmse_m", "speedup"),
            ("STLC, median", "position error, m (RMSE, median)", "effective speed-up"),
            strict=True,
        ):
            for curve in curves:
                colour = style.CYCLE[clocks.index(curve.clock_speed) % len(style.CYCLE)]
                text = f"{style.command_name(curve.command)} {style.clock_label(curve.clock_speed)}"
                axes.plot(
                    _places(curves, curve), getattr(curve, name), _LINES.get(curve.command, ":"),
                    marker="o", markersize=4, color=colour, label=text,
                )  # fmt: skip
            axes.set(ylabel=label, xlabel=axis)
            _set_axis(axes, curves)
        panels[0].axhline(SIMILAR_STLC, color="#C00000", linewidth=1.0, zorder=1)
        panels[2].set_yscale("log")
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside right center", fontsize=7.5)
        return figure


def _numeric(curves: Sequence[VariantCurve]) -> bool:
    return all(isinstance(place, float) for curve in curves for place in curve.places)


def _names(curves: Sequence[VariantCurve]) -> list[str]:
    return list(dict.fromkeys(str(place) for curve in curves for place in curve.places))


def _places(curves: Sequence[VariantCurve], curve: VariantCurve) -> list[float]:
    if _numeric(curves):
        return [float(place) for place in curve.places]
    names = _names(curves)
    return [float(names.index(str(place))) for place in curve.places]


def _set_axis(axes: Axes, curves: Sequence[VariantCurve]) -> None:
    if not _numeric(curves):
        names = _names(curves)
        axes.set_xticks(range(len(names)), names, rotation=20, ha="right")
        return
    above = [float(place) for curve in curves for place in curve.places if float(place) > 0]
    if above and max(above) / min(above) > 20:
        axes.set_xscale("symlog", linthresh=min(above))
