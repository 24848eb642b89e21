"""Up to three flights in three dimensions (the paper's Figure 3: a trajectory, its best and its worst replica)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from uavaccel.draw import style
from uavaccel.draw.document import Picture
from uavaccel.suites.dp1.cases import Dp1Row
from uavaccel.suites.dp1.scores import CellScores
from uavaccel.suites.report import LoadArrays
from uavaccel.suites.source_line import source_line

_COLOURS = (style.BLUE, style.GREEN, style.VERMILION)
_LEAST_SPAN_M = 0.2
_LEAST_HEIGHT_SPAN_M = 0.5  # millimetres of altitude are not to look like a climb


@dataclass(frozen=True)
class TrajectoryLine:
    """One flight, `position_m` (n, 3) NED, and what the legend says of it."""

    label: str
    position_m: np.ndarray


FIGURE3_ROUNDS = 4  # enough laps to drift, few enough to tell them apart


def trajectory_figure(scores: Sequence[CellScores], load_arrays: LoadArrays, path: Path) -> Picture:
    """Figure 3 from the fastest ADSC cell of the longest T_move: best and worst replica by STLC."""
    score = _fastest_cell(scores, FIGURE3_ROUNDS)
    flights = [] if score is None else _compared_flights(score)
    lines = [TrajectoryLine(label, load_arrays(row)["position_m"]) for row, label in flights]
    source = source_line([row for row, _ in flights])
    title = "Trajectories" if score is None else f"Trajectories, {_path_label(score)}"
    style.save(plot_trajectories(lines, source, title), path)
    return Picture(
        path,
        "Figure 3. A real-time trajectory, and the best and the worst replica of the fastest cell by STLC. "
        f"Height is up, −z of the NED frame. Source: {source}.",
    )


def _fastest_cell(scores: Sequence[CellScores], rounds: int) -> CellScores | None:
    """The fastest cell with games, ADSC before TCSC, of the longest T_move and rounds nearest `rounds`."""
    flown = [score for score in scores if score.cell.rows]
    if not flown:
        return None

    def preference(score: CellScores) -> tuple[bool, bool, float, float, int]:
        key = score.cell.key
        accelerated = key.clock_speed > 1
        return accelerated, key.command == "adsc", key.clock_speed, key.t_move_s, -abs(key.rounds - rounds)

    return max(flown, key=preference)


def _compared_flights(score: CellScores) -> list[tuple[Dp1Row, str]]:
    """A reference, then the replicas of highest and lowest STLC, each with its label."""
    cell = score.cell
    flights = [(row, f"{style.command_at_clock(row)}: reference") for row in cell.reference_rows[:1]]
    if cell.is_reference:
        return flights
    best_first = np.argsort(-np.nan_to_num(score.stlc), kind="stable").tolist()
    if score.distinct_games == 1:
        ranks = {0: f"all {len(cell.rows)} identical" if len(cell.rows) > 1 else "one game"}
    else:
        ranks = {best_first[0]: "best", best_first[-1]: "worst"}
    return flights + [
        (cell.rows[i], f"{style.command_at_clock(cell.rows[i])}, {rank}: {_stlc_text(score.stlc[i])}")
        for i, rank in ranks.items()
    ]


def _stlc_text(stlc: float) -> str:
    return f"STLC {stlc:.3f}" if np.isfinite(stlc) else "STLC unknown"


def _path_label(score: CellScores) -> str:
    key = score.cell.key
    return f"{style.rounds_label(key.rounds)}, T_move {key.t_move_s:g} s"


def plot_trajectories(lines: Sequence[TrajectoryLine], source: str, title: str) -> Figure:
    """Up to three flights from above and the side, height upwards."""
    with style.project_style():
        figure = style.new_figure(7.2, 6.0, title, source)
        axes = figure.add_subplot(projection="3d")
        for line, colour in zip(lines, _COLOURS, strict=False):
            north, east, down = line.position_m.T
            axes.plot(north, east, -down, color=colour, label=line.label, linewidth=1.2)
        _scale(axes, lines)
        if lines:
            axes.legend(loc="upper left", bbox_to_anchor=(-0.05, 0.98))
        return figure


def _scale(axes: style.Axes3D, lines: Sequence[TrajectoryLine]) -> None:
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
    """Two to six round numbers, none next to the corner, where two axes would write over each other."""
    ticks = MaxNLocator(6, steps=(1, 2, 5, 10)).tick_values(low, high)
    return [float(tick) for tick in ticks if low + 0.08 * (high - low) <= tick <= high]
