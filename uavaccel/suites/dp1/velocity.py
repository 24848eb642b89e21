"""Velocity over simulated time, a panel per flight, with the commands' ends (the paper's Figure 2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from uavaccel.draw import style
from uavaccel.draw.document import Picture
from uavaccel.metrics.trajectory import command_gaps_s
from uavaccel.suites.dp1.cases import Dp1Row
from uavaccel.suites.report import Arrays, LoadArrays
from uavaccel.suites.source_line import source_line

_AXIS_NAMES = ("north", "east", "down")
_END: style.LineStyle = {"color": style.BLACK, "linestyle": (0, (4, 3)), "linewidth": 0.9}
_GAP_COLOUR = "#D0D0D0"
_VISIBLE_M_S = 0.05  # a component that never gets faster is left out


@dataclass(frozen=True)
class VelocityPanel:
    """One flight: samples (n,), velocities (n, 3) NED, and its commands' starts and ends (c,)."""

    title: str
    time_s: np.ndarray
    velocity_m_s: np.ndarray
    command_start_s: np.ndarray
    command_end_s: np.ndarray


def velocity_figure(rows: Sequence[Dp1Row], load_arrays: LoadArrays, path: Path) -> Picture:
    """Figure 2 from the games of role "figure2": two steps forward and one back, slowest ClockSpeed on top."""
    flown = [row for row in rows if row["role"] == "figure2" and row.get("error") is None]
    flown.sort(key=lambda row: row["clock_speed"])
    source = source_line(flown)
    panels = [_velocity_panel(row, load_arrays(row)) for row in flown]
    style.save(plot_velocity(panels, source, "Two steps forward, one back"), path)
    return Picture(
        path,
        "Figure 2. Velocity over simulated time, two steps forward and one back, in real time and at the "
        "run's highest ClockSpeed. Dashed: a command ends. Grey: no command runs, the drone flies on while "
        f"the client reacts. Source: {source}.",
    )


def _velocity_panel(row: Dp1Row, arrays: Arrays) -> VelocityPanel:
    start_s, end_s = arrays["command_start_s"], arrays["command_end_s"]
    gap_ms = float(np.mean(command_gaps_s(start_s, end_s))) * 1e3
    return VelocityPanel(
        f"{style.command_at_clock(row)}: {gap_ms:.1f} ms between commands",
        arrays["time_s"],
        arrays["linear_velocity_m_s"],
        start_s,
        end_s,
    )


def plot_velocity(panels: Sequence[VelocityPanel], source: str, title: str) -> Figure:
    """The panels one above the other on one time axis.

    A dashed line is the end of a command, grey the time in which no command ran: latency times ClockSpeed.
    """
    with style.project_style():
        rows = max(len(panels), 1)
        figure = style.new_figure(8.0, 1.2 + 2.1 * rows, title, source)
        all_axes = list(figure.subplots(rows, 1, sharex=True, sharey=True, squeeze=False)[:, 0])
        if not panels:
            style.note(all_axes[0], "no flight recorded")
        for axes, panel in zip(all_axes, panels, strict=False):
            _draw_panel(axes, panel, _components(panels))
        if panels:
            _label(figure, all_axes)
        return figure


def _components(panels: Sequence[VelocityPanel]) -> list[int]:
    fastest = np.max([np.abs(panel.velocity_m_s).max(axis=0) for panel in panels], axis=0)
    return [axis for axis in range(3) if fastest[axis] > _VISIBLE_M_S] or [0]


def _draw_panel(axes: Axes, panel: VelocityPanel, components: Sequence[int]) -> None:
    axes.set_title(panel.title)
    for start, end in zip(panel.command_end_s[:-1], panel.command_start_s[1:], strict=True):
        axes.axvspan(start, end, color=_GAP_COLOUR, linewidth=0)
    for end in panel.command_end_s:
        axes.axvline(end, **_END)
    for axis in components:
        axes.plot(panel.time_s, panel.velocity_m_s[:, axis], label=_AXIS_NAMES[axis], color=style.CYCLE[axis])


def _label(figure: Figure, all_axes: Sequence[Axes]) -> None:
    for axes in all_axes:
        axes.set_ylabel("velocity, m/s")
    all_axes[-1].set_xlabel("simulated time, s")
    handles, _ = all_axes[0].get_legend_handles_labels()
    handles += [
        Line2D([], [], label="command ends", **_END),
        Patch(color=_GAP_COLOUR, label="no command runs"),
    ]
    figure.legend(handles=handles, ncols=len(handles), loc="outside upper right")
