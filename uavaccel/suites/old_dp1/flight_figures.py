"""DP1's figures of single flights: velocity over time (the paper's Figure 2) and trajectories (Figure 3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from uavaccel.draw import style
from uavaccel.draw.document import Picture
from uavaccel.metrics.trajectory import command_gaps_s
from uavaccel.suites.old_dp1.flights import Dp1Row
from uavaccel.suites.old_dp1.scores import CellScores
from uavaccel.suites.old_report import Arrays, LoadArrays
from uavaccel.suites.provenance import source_line

_AXIS_NAMES = ("north", "east", "down")
_END: style.LineStyle = {"color": style.BLACK, "linestyle": (0, (4, 3)), "linewidth": 0.9}
_GAP_COLOUR = "#D0D0D0"
_VISIBLE_M_S = 0.05  # a component that never gets faster is left out

FIGURE3_ROUNDS = 4  # enough laps to drift, few enough to tell them apart
_LINES: tuple[style.LineStyle, ...] = (
    {"color": style.BLUE},
    {"color": style.GREEN},
    {"color": style.VERMILION},
    {"color": style.BLACK, "linestyle": (0, (2, 4))},  # where TCSC flies as the reference does, both are seen
)
_LEAST_SPAN_M = 0.2
_LEAST_HEIGHT_SPAN_M = 0.5  # millimetres of altitude are not to look like a climb


@dataclass(frozen=True)
class VelocityPanel:
    """A flight: sample times (n,), NED velocities (n, 3), and the start and end times of its commands (c,)."""

    title: str
    time_s: np.ndarray
    velocity_m_s: np.ndarray
    command_start_s: np.ndarray
    command_end_s: np.ndarray


def velocity_figure(rows: Sequence[Dp1Row], load_arrays: LoadArrays, path: Path) -> Picture:
    """Draw Figure 2 from the games of role "figure2": two steps forward and one back, slowest ClockSpeed on top."""
    games = [row for row in rows if row["role"] == "figure2" and row.get("error") is None]
    games.sort(key=lambda row: row["clock_speed"])
    source = source_line(games)
    panels = [_velocity_panel(row, load_arrays(row)) for row in games]
    caption = (
        "Figure 2. Velocity over simulated time, two steps forward and one back, in real time and at the run's highest "
        "ClockSpeed. Dashed: a command ends. Grey: no command runs, the drone flies on while the client reacts."
    )
    return style.picture(plot_velocity(panels, source, "Two steps forward, one back"), path, caption, source)


def _velocity_panel(row: Dp1Row, arrays: Arrays) -> VelocityPanel:
    start_s, end_s = arrays["command_start_s"], arrays["command_end_s"]
    gap_ms = float(np.mean(command_gaps_s(start_s, end_s))) * 1e3
    title = f"{style.command_at_clock(row)}: {gap_ms:.1f} ms between commands"
    return VelocityPanel(title, arrays["time_s"], arrays["linear_velocity_m_s"], start_s, end_s)


def plot_velocity(panels: Sequence[VelocityPanel], source: str, title: str) -> Figure:
    """Plot velocities, a panel per flight, one above the other on a common time axis.

    A dashed line is the end of a command; grey is the time without a command: latency times ClockSpeed.
    """
    with style.project_style():
        rows = max(len(panels), 1)
        figure = style.new_figure(8.0, 1.2 + 2.1 * rows, title, source)
        all_axes = list(figure.subplots(rows, 1, sharex=True, sharey=True, squeeze=False)[:, 0])
        if not panels:
            style.note(all_axes[0], "no flight recorded")
            return figure
        fastest = np.max([np.abs(panel.velocity_m_s).max(axis=0) for panel in panels], axis=0)
        components = [axis for axis in range(3) if fastest[axis] > _VISIBLE_M_S] or [0]
        for axes, panel in zip(all_axes, panels, strict=True):
            _plot_velocity_panel(axes, panel, components)
        all_axes[-1].set_xlabel("simulated time, s")
        handles, _ = all_axes[0].get_legend_handles_labels()
        handles.append(Line2D([], [], label="command ends", **_END))
        handles.append(Patch(color=_GAP_COLOUR, label="no command runs"))
        figure.legend(handles=handles, ncols=len(handles), loc="outside upper right")
        return figure


def _plot_velocity_panel(axes: Axes, panel: VelocityPanel, components: Sequence[int]) -> None:
    axes.set(ylabel="velocity, m/s")
    axes.set_title(panel.title)
    for start, end in zip(panel.command_end_s[:-1], panel.command_start_s[1:], strict=True):
        axes.axvspan(start, end, color=_GAP_COLOUR, linewidth=0)
    for end in panel.command_end_s:
        axes.axvline(end, **_END)
    for axis in components:
        axes.plot(panel.time_s, panel.velocity_m_s[:, axis], label=_AXIS_NAMES[axis], color=style.CYCLE[axis])


@dataclass(frozen=True)
class TrajectoryLine:
    """A flight, `position_m` (n, 3) NED, and its label in the legend."""

    label: str
    position_m: np.ndarray


def trajectory_figure(scores: Sequence[CellScores], load_arrays: LoadArrays, path: Path) -> Picture:
    """Draw Figure 3: best and worst replica by STLC of the fastest ADSC cell of the longest T_move, and one of TCSC."""
    score = _fastest_cell(scores, FIGURE3_ROUNDS)
    flights = [] if score is None else _compared_flights(score)
    if score is not None and score.cell.key.command == "adsc":
        flights += _of_tcsc(scores, score)
    lines = [TrajectoryLine(label, load_arrays(row)["position_m"]) for row, label in flights]
    source = source_line([row for row, _ in flights])
    title = "Trajectories"
    if score is not None:
        key = score.cell.key
        title += f", {style.rounds_label(key.rounds)}, T_move {key.t_move_s:g} s"
    caption = (
        "Figure 3. A real-time trajectory, and the best and the worst replica of the fastest cell by STLC, and the "
        "least accurate of TCSC's fastest cell, dotted. Height is up, −z of the NED frame."
    )
    return style.picture(plot_trajectories(lines, source, title), path, caption, source)


def _fastest_cell(scores: Sequence[CellScores], rounds: int) -> CellScores | None:
    """Return the fastest cell with games, ADSC before TCSC, of the longest T_move and rounds nearest `rounds`."""

    def preference(score: CellScores) -> tuple[bool, bool, float, float, int]:
        key = score.cell.key
        accelerated = key.clock_speed > 1
        return accelerated, key.command == "adsc", key.clock_speed, key.t_move_s, -abs(key.rounds - rounds)

    return max((score for score in scores if score.cell.rows), key=preference, default=None)


def _compared_flights(score: CellScores) -> list[tuple[Dp1Row, str]]:
    """Return a reference, then the replicas of highest and lowest STLC, each with its label."""
    cell = score.cell
    flights = [(row, f"{style.command_at_clock(row)}: reference") for row in cell.reference_rows[:1]]
    if cell.is_reference:
        return flights
    best_first = np.argsort(-np.nan_to_num(score.stlc), kind="stable").tolist()
    if score.distinct_games == 1:
        ranks = {0: f"all {len(cell.rows)} identical" if len(cell.rows) > 1 else "one game"}
    else:
        ranks = {best_first[0]: "best", best_first[-1]: "worst"}
    for i, rank in ranks.items():
        stlc = f"STLC {score.stlc[i]:.3f}" if np.isfinite(score.stlc[i]) else "STLC unknown"
        flights.append((cell.rows[i], f"{style.command_at_clock(cell.rows[i])}, {rank}: {stlc}"))
    return flights


def _of_tcsc(scores: Sequence[CellScores], beside: CellScores) -> list[tuple[Dp1Row, str]]:
    """Return the replica of lowest STLC of the fastest TCSC cell that flew the same path, if there is one."""
    wanted = "tcsc", beside.cell.key.t_move_s, beside.cell.key.rounds
    keyed = [(score, score.cell.key) for score in scores]
    own = [score for score, key in keyed if (key.command, key.t_move_s, key.rounds) == wanted]
    fastest = _fastest_cell(own, beside.cell.key.rounds)
    return [] if fastest is None else _compared_flights(fastest)[-1:]


def plot_trajectories(lines: Sequence[TrajectoryLine], source: str, title: str) -> Figure:
    """Plot up to four flights in three dimensions, height upwards."""
    with style.project_style():
        figure = style.new_figure(7.2, 6.0, title, source)
        axes = figure.add_subplot(projection="3d")
        for line, drawn in zip(lines, _LINES, strict=False):
            north, east, down = line.position_m.T
            axes.plot(north, east, -down, **drawn, label=line.label, linewidth=1.2)
        _scale_axes(axes, lines)
        if lines:
            axes.legend(loc="upper left", bbox_to_anchor=(-0.05, 0.98))
        return figure


def _scale_axes(axes: style.Axes3D, lines: Sequence[TrajectoryLine]) -> None:
    axes.set(xlabel="north x, m", ylabel="east y, m", zlabel="height −z, m")
    axes.view_init(elev=38, azim=-125)
    if not lines:
        return
    points = np.concatenate([line.position_m for line in lines])
    low, high = points.min(axis=0), points.max(axis=0)
    half_m = max(float(np.max((high - low)[:2])), _LEAST_SPAN_M) / 2 * 1.05  # north and east to one scale
    north, east, down = (low + high) / 2
    half_height_m = max(high[2] - low[2], _LEAST_HEIGHT_SPAN_M) / 2
    axes.set_xlim(north - half_m, north + half_m)
    axes.set_ylim(east - half_m, east + half_m)
    axes.set_zlim(-down - half_height_m, -down + half_height_m)
    axes.set_box_aspect((1, 1, 0.45))
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_ticks(_ticks(*axis.get_view_interval()))


def _ticks(low: float, high: float) -> list[float]:
    """Return two to six round numbers, none next to a corner, where the labels of two axes would overlap."""
    ticks = MaxNLocator(6, steps=(1, 2, 5, 10)).tick_values(low, high)
    return [float(tick) for tick in ticks if low + 0.08 * (high - low) <= tick <= high]
