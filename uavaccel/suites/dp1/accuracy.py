"""Boxes of STLC over the number of rounds, a row per command and a column per ClockSpeed (the paper's Figure 5)."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from uavaccel.draw import style
from uavaccel.draw.document import Picture
from uavaccel.suites.dp1.scores import CellScores, rows_of
from uavaccel.suites.source_line import source_line

SIMILAR_STLC = 1.8  # the paper's line: above it trajectories look alike (section III-C2a)

AccuracyBoxes = Mapping[tuple[str, float, int], Sequence[float]]


def accuracy_figure(scores: Sequence[CellScores], path: Path) -> Picture:
    """Figure 5 from all games, T_moves pooled."""
    boxes: dict[tuple[str, float, int], list[float]] = defaultdict(list)
    for score in scores:
        key = score.cell.key
        known = score.stlc[np.isfinite(score.stlc)]
        boxes[key.command, key.clock_speed, key.rounds] += known.tolist()
    source = source_line(rows_of(scores))
    style.save(plot_accuracy(boxes, source), path)
    return Picture(
        path,
        "Figure 5. STLC against the real-time ADSC games; one value a game, its mean over the references, "
        "T_moves pooled; line: 1.8. Replicas whose flights are identical make a box of zero width, drawn as "
        f"it is. Source: {source}.",
    )


def plot_accuracy(boxes: AccuracyBoxes, source: str) -> Figure:
    """STLC boxes of `boxes[command, clock_speed, rounds]`, one value per game.

    Identical games give a box of zero width, drawn as the thick line it is.
    """
    commands = sorted({command for command, _, _ in boxes})
    clocks = sorted({clock for _, clock, _ in boxes})
    rounds = sorted({n for _, _, n in boxes})
    with style.project_style():
        width_in = 2.0 + 1.9 * max(len(clocks), 2)
        figure = style.new_figure(
            width_in, 1.2 + 2.3 * max(len(commands), 1), "Accuracy of the trajectories: STLC", source
        )
        grid = figure.subplots(
            max(len(commands), 1), max(len(clocks), 1), sharex=True, sharey=True, squeeze=False
        )
        if not boxes:
            style.note(grid[0, 0], "no games to compare")
            return figure
        for (row, column), axes in np.ndenumerate(grid):
            cell = {n: boxes.get((commands[row], clocks[column], n), ()) for n in rounds}
            _draw_boxes(axes, cell, style.COMMAND_COLOUR.get(commands[row], style.GREEN))
        _label(grid, commands, clocks, _lowest(boxes))
        return figure


def _draw_boxes(axes: Axes, cell: Mapping[int, Sequence[float]], colour: str) -> None:
    axes.axhline(SIMILAR_STLC, color="#C00000", linewidth=1.0, zorder=1)
    places = range(len(cell))
    drawn = [(place, values) for place, values in zip(places, cell.values(), strict=True) if len(values)]
    if drawn:
        axes.boxplot(
            [list(values) for _, values in drawn],
            positions=[place for place, _ in drawn],
            widths=0.62,
            patch_artist=True,
            manage_ticks=False,
            boxprops={"facecolor": colour, "edgecolor": colour, "alpha": 0.45, "linewidth": 1.0},
            medianprops={"color": colour, "linewidth": 2.4, "solid_capstyle": "butt"},
            whiskerprops={"color": colour},
            capprops={"color": colour},
            flierprops={"marker": ".", "markersize": 3, "markeredgecolor": colour},
        )
    else:
        axes.text(0.5, 0.15, "no games to compare", transform=axes.transAxes, ha="center", color=style.GREY)
    axes.set_xticks(list(places), [str(n) for n in cell])
    axes.set_xlim(-0.6, len(cell) - 0.4)
    axes.grid(axis="x", visible=False)


def _lowest(boxes: AccuracyBoxes) -> float:
    return min((min(values) for values in boxes.values() if len(values)), default=SIMILAR_STLC)


def _label(grid: np.ndarray, commands: Sequence[str], clocks: Sequence[float], lowest: float) -> None:
    for axes, clock in zip(grid[0], clocks, strict=True):
        axes.set_title(style.clock_label(clock), loc="center")
    for axes, command in zip(grid[:, 0], commands, strict=True):
        axes.set_ylabel(f"{style.command_name(command)}\nSTLC")
        axes.set_ylim(min(1.7, lowest - 0.05), 2.04)
    for axes in grid[-1]:
        axes.set_xlabel("rounds")
