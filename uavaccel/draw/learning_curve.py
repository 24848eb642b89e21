"""How many games a training wins, over the wall clock: hours and seconds on one logarithmic axis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from uavaccel.draw import style
from uavaccel.draw.evaluated import Evaluated, plot_evaluated

TICKS_S = {
    "1 s": 1.0,
    "10 s": 10.0,
    "1 min": 60.0,
    "10 min": 600.0,
    "1 h": 3600.0,
    "10 h": 36_000.0,
    "100 h": 360_000.0,
}


@dataclass(frozen=True)
class LearningCurve:
    """After each game of a training: seconds of wall clock since the first command, and the success lately, 0 to 1."""

    label: str
    wall_s: Sequence[float]
    success: Sequence[float]
    evaluated: Evaluated | None = None


def draw_learning_curves(
    curves: Sequence[LearningCurve], path: Path, source: str, marks: Mapping[str, float]
) -> Path:
    """Write `plot_learning_curves` as a PNG; returns `path`."""
    return style.save(plot_learning_curves(curves, source, marks), path)


def plot_learning_curves(curves: Sequence[LearningCurve], source: str, marks: Mapping[str, float]) -> Figure:
    """A line per training, those of one label in one colour, and a vertical one at each of `marks`, seconds by name."""
    with style.project_style():
        figure = style.new_figure(8.0, 4.2, "Success over the wall clock", source)
        axes = figure.subplots()
        labels = list(dict.fromkeys(curve.label for curve in curves))
        for number, curve in enumerate(curves):
            first = curve.label not in [other.label for other in curves[:number]]
            colour = style.CYCLE[labels.index(curve.label) % len(style.CYCLE)]
            axes.plot(curve.wall_s, curve.success, color=colour, label=curve.label if first else None)
            if curve.evaluated is not None:
                plot_evaluated(axes, [curve.evaluated], colour)
        for name, wall_s in marks.items():
            axes.axvline(wall_s, color=style.BLACK, linewidth=1.2, linestyle="--")
            axes.text(0.93 * wall_s, 0.5, name, rotation=90, ha="right", va="center")
        axes.set_xscale("log")
        longest_s = max([*marks.values(), *(curve.wall_s[-1] for curve in curves)])
        axes.set_xlim(1.0, 2.0 * longest_s)
        ticks = {name: wall_s for name, wall_s in TICKS_S.items() if wall_s <= 2.0 * longest_s}
        axes.set_xticks(list(ticks.values()), list(ticks))
        axes.xaxis.set_minor_locator(NullLocator())
        axes.set(xlabel="wall clock since the first command", ylabel="games won, of the last 100")
        axes.set_ylim(0.0, 1.0)
        axes.yaxis.set_major_formatter("{x:.0%}")
        figure.legend(loc="outside upper right")
        return figure
