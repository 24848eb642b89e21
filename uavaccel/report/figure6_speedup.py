"""Figure 6: effective speed-up over ClockSpeed, a panel a command, a line a T_move, the ideal dashed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from uavaccel.report import style

_MARKERS = "osD^v<>"


@dataclass(frozen=True)
class SpeedupCurve:
    """Effective speed-ups of one command and T_move, with intervals low to high; arrays (ClockSpeeds,)."""

    command: str
    t_move_s: float
    clock_speed: np.ndarray
    speedup: np.ndarray
    low: np.ndarray
    high: np.ndarray


def draw_speedup(curves: Sequence[SpeedupCurve], path: Path, source: str, rounds: int) -> Path:
    """Draw the curves of the games of `rounds` rounds on logarithmic axes; returns `path`."""
    commands = sorted({curve.command for curve in curves})
    with style.look():
        title = f"Effective speed-up over ADSC at 1x, {rounds} rounds"
        figure = style.new_figure(2.0 + 3.6 * max(len(commands), 1), 4.2, title, source)
        panels = figure.subplots(1, max(len(commands), 1), sharex=True, sharey=True, squeeze=False)[0]
        if not curves:
            style.note(panels[0], "no speed-up without ADSC games at 1x")
            return style.save(figure, path)
        t_moves = sorted({curve.t_move_s for curve in curves})
        clocks = np.unique(np.concatenate([curve.clock_speed for curve in curves]))
        for axes, command in zip(panels, commands, strict=True):
            _draw_panel(axes, [curve for curve in curves if curve.command == command], t_moves, clocks)
            axes.set_title(style.command_name(command))
        panels[0].set_ylabel("effective speed-up")
        panels[0].legend(loc="upper left")
        return style.save(figure, path)


def _draw_panel(
    axes: Axes, curves: Sequence[SpeedupCurve], t_moves: Sequence[float], clocks: np.ndarray
) -> None:
    ends = np.array([min(clocks.min(), 1.0), max(clocks.max(), 1.0)])
    axes.plot(ends, ends, color=style.BLACK, linestyle="--", linewidth=1.1, label="ideal")
    for curve in curves:
        place = t_moves.index(curve.t_move_s)
        axes.errorbar(
            curve.clock_speed,
            curve.speedup,
            yerr=np.clip([curve.speedup - curve.low, curve.high - curve.speedup], 0, None),
            color=style.CYCLE[place % len(style.CYCLE)],
            marker=_MARKERS[place % len(_MARKERS)],
            markersize=4.5,
            capsize=2,
            label=f"T_move {curve.t_move_s:g} s",
        )
    axes.set(xscale="log", yscale="log", xlabel="ClockSpeed")
    _number_ticks(axes, clocks)


def _number_ticks(axes: Axes, clocks: np.ndarray) -> None:
    """Plain numbers instead of powers of ten, and a tick for every ClockSpeed flown."""
    plain = FuncFormatter(lambda value, _: f"{value:g}")
    axes.xaxis.set_major_locator(FixedLocator(clocks.tolist()))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter(plain)
    axes.yaxis.set_major_locator(FixedLocator([0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000]))
    axes.yaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_major_formatter(plain)
