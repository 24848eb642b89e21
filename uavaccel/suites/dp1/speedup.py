"""Effective speed-up over ClockSpeed: a panel per command, a line per T_move, the ideal dashed (paper's Figure 6)."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from uavaccel.draw import style
from uavaccel.draw.document import Picture
from uavaccel.suites.dp1.scores import CellScores, rows_of
from uavaccel.suites.report import Summary, SummaryCell
from uavaccel.suites.source_line import source_line

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


def speedup_figure(scores: Sequence[CellScores], summary: Summary, path: Path) -> Picture:
    """Figure 6 from the cells with most rounds."""
    rounds = max((cell["rounds"] for cell in summary["cells"]), default=0)
    curves: dict[tuple[str, float], list[SummaryCell]] = defaultdict(list)
    for cell in summary["cells"]:
        if cell["rounds"] == rounds and cell["effective_speedup"] is not None:
            curves[cell["command"], cell["t_move_s"]].append(cell)
    source = source_line(rows_of([score for score in scores if score.cell.key.rounds == rounds]))
    drawn = [_curve(*key, cells) for key, cells in sorted(curves.items())]
    style.save(plot_speedup(drawn, source, rounds), path)
    return Picture(
        path,
        f"Figure 6. Effective speed-up of games of {style.rounds_label(rounds)}: mean wall time of ADSC at 1x over the "
        f"cell's, with 95 % bootstrap intervals over games. Dashed: the ideal. Source: {source}.",
    )


def _curve(command: str, t_move_s: float, cells: Sequence[SummaryCell]) -> SpeedupCurve:
    cells = sorted(cells, key=lambda cell: cell["clock_speed"])
    speedup = [cell["effective_speedup"] for cell in cells]
    interval = [cell["effective_speedup_interval"] or [cell["effective_speedup"]] * 2 for cell in cells]
    low, high = np.array(interval, dtype=float).T
    clocks = np.array([cell["clock_speed"] for cell in cells])
    return SpeedupCurve(command, t_move_s, clocks, np.array(speedup), low, high)


def plot_speedup(curves: Sequence[SpeedupCurve], source: str, rounds: int) -> Figure:
    """The curves of the games of `rounds` rounds; speed-ups on a logarithmic axis, so that 1 to 10x can be read."""
    commands = sorted({curve.command for curve in curves})
    with style.project_style():
        title = f"Effective speed-up over ADSC at 1x, {style.rounds_label(rounds)}"
        figure = style.new_figure(2.0 + 3.6 * max(len(commands), 1), 4.2, title, source)
        panels = figure.subplots(1, max(len(commands), 1), sharex=True, sharey=True, squeeze=False)[0]
        if not curves:
            style.note(panels[0], "no speed-up without ADSC games at 1x")
            return figure
        t_moves = sorted({curve.t_move_s for curve in curves})
        clocks = np.unique(np.concatenate([curve.clock_speed for curve in curves]))
        for axes, command in zip(panels, commands, strict=True):
            _draw_panel(axes, [curve for curve in curves if curve.command == command], t_moves, clocks)
            axes.set_title(style.command_name(command))
        panels[0].set(ylabel="effective speed-up", yscale="log")
        _set_speedup_ticks(panels[0])
        panels[0].legend(loc="upper left")
        return figure


def _set_speedup_ticks(axes: Axes) -> None:
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter("{x:g}x")
    axes.yaxis.set_minor_formatter(NullFormatter())


def _draw_panel(
    axes: Axes, curves: Sequence[SpeedupCurve], t_moves: Sequence[float], clocks: np.ndarray
) -> None:
    """ClockSpeeds at equal distances: what is lost at the highest is to be seen."""
    axes.plot(clocks, color=style.BLACK, linestyle="--", linewidth=1.1, label="ideal")
    for curve in curves:
        place = t_moves.index(curve.t_move_s)
        axes.errorbar(
            np.searchsorted(clocks, curve.clock_speed),
            curve.speedup,
            yerr=np.clip([curve.speedup - curve.low, curve.high - curve.speedup], 0, None),
            color=style.CYCLE[place % len(style.CYCLE)],
            marker=_MARKERS[place % len(_MARKERS)],
            markersize=4.5,
            capsize=2,
            label=f"T_move {curve.t_move_s:g} s",
        )
    axes.set_xticks(range(len(clocks)), [style.clock_label(clock) for clock in clocks])
    axes.set_xlabel("ClockSpeed")
