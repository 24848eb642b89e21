"""The lanes that an evaluation lost: their paths over the obstacles, and a table of what ended them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle

from uavaccel.draw import style
from uavaccel.draw.document import Picture, Table
from uavaccel.sim.lane.layout import LENGTH_M, WIDTH_M, LaneLayout
from uavaccel.suites.evaluation.config import EvaluateConfig
from uavaccel.suites.evaluation.flights import EvaluateRow
from uavaccel.wire.image_api import lane_layout

MOST_PANELS = 9
AHEAD_M = 10.0  # of the farthest end, shown on the map


def lost_rows(rows: Sequence[EvaluateRow]) -> list[EvaluateRow]:
    """Return the rows of lanes that were not won, the shortest flight first."""
    return sorted((row for row in rows if not row["is_success"]), key=lambda row: row["distance_m"])


def ended_by(row: EvaluateRow) -> str:
    """Return what ended a lost game, in words."""
    return f"hitting {row['collision']}" if row["collision"] else "running out of commands"


def lost_table(rows: Sequence[EvaluateRow]) -> Table:
    """Return a table of lost lanes with what ended them and the option that shows them."""
    return Table.of(
        rows,
        ("lane", lambda row: str(row["lane"])),
        ("distance, m", lambda row: f"{row['distance_m']:.1f}"),
        ("ended by", ended_by),
        ("commands", lambda row: str(row["commands"])),
        ("seen with", lambda row: f"--case {row['case']}"),
        folded=f"{len(rows)} lost lanes",
    )


def plot_lost(config: EvaluateConfig, rows: Sequence[EvaluateRow], path: Path, source: str) -> Picture | None:
    """Plot the paths of the lost lanes, a panel for each of at most nine, the shortest flight on top.

    None where no path can be drawn: the kernels record none, and where a lane is drawn anew with the conditions of each
    game, its obstacles are not known afterwards.
    """
    drawn = [row for row in lost_rows(rows) if row.get("path_m")]
    if not drawn or config.task.randomise is not None:
        return None
    shown = drawn[:MOST_PANELS]
    more = f" {len(drawn) - len(shown)} more are in the table below." if len(drawn) > len(shown) else ""
    figure = _plot(shown, [lane_layout(config.task.wire_lane(row["lane"])) for row in shown], source)
    caption = f"Paths of the lost lanes, from above, by the positions at the ends of the commands.{more}"
    return style.picture(figure, path, caption, source)


def _plot(rows: Sequence[EvaluateRow], layouts: Sequence[LaneLayout], source: str) -> Figure:
    with style.project_style():
        figure = style.new_figure(8.0, 1.0 + 0.85 * len(rows), "Lost lanes", source)
        panels = figure.subplots(len(rows), 1, sharex=True, squeeze=False)[:, 0]
        for axes, row, layout in zip(panels, rows, layouts, strict=True):
            _draw_lane(axes, layout)
            north, east = zip((0.0, 0.0), *row["path_m"], strict=True)
            axes.plot(north, east, color=style.BLUE, marker=".", markersize=3)
            axes.plot(north[-1], east[-1], "x", color=style.VERMILION, markersize=8, markeredgewidth=2)
            axes.set_title(f"lane {row['lane']}: {row['distance_m']:.1f} m, {ended_by(row)}", fontsize=8.5)
            axes.set_ylim(WIDTH_M / 2, -WIDTH_M / 2)  # west is up, to the left of the flight
            axes.set_yticks([])
            axes.grid(visible=False)
        farthest_m = max(row["distance_m"] for row in rows)
        panels[-1].set_xlim(-2.0, min(max(farthest_m, 0.0) + AHEAD_M, LENGTH_M + 2.0))
        panels[-1].set_xlabel("north, m; across, the 10 m between the walls are not to that scale")
        return figure


def _draw_lane(axes: Axes, layout: LaneLayout) -> None:
    for edge in (-WIDTH_M / 2, WIDTH_M / 2):
        axes.axhline(edge, color=style.GREY, linewidth=2)
    axes.axvline(LENGTH_M, color=style.GREEN, linewidth=2)
    for x, y, half, is_round in zip(layout.x_m, layout.y_m, layout.half_width_m, layout.round, strict=True):
        shape = Circle((x, y), half) if is_round else Rectangle((x - half, y - half), 2 * half, 2 * half)
        shape.set(facecolor="#444444", linewidth=0)
        axes.add_patch(shape)
