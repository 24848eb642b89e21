"""DP1's figures of all cells: STLC over rounds (the paper's Figure 5), speed-up over ClockSpeed (Figure 6)."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from uavaccel.draw import style
from uavaccel.draw.document import Picture
from uavaccel.suites.old_dp1.scores import CellScores, rows_of
from uavaccel.suites.old_report import Summary, SummaryCell
from uavaccel.suites.provenance import source_line

SIMILAR_STLC = 1.8  # above it trajectories look alike (paper, section III-C2a)
NO_GAMES = "no games to compare"

AccuracyBoxes = Mapping[tuple[str, float, int], Sequence[float]]


def accuracy_figure(scores: Sequence[CellScores], path: Path) -> Picture:
    """Draw Figure 5 from all games, T_moves pooled."""
    boxes: dict[tuple[str, float, int], list[float]] = defaultdict(list)
    for score in scores:
        key = score.cell.key
        boxes[key.command, key.clock_speed, key.rounds] += score.stlc[np.isfinite(score.stlc)].tolist()
    source = source_line(rows_of(scores))
    caption = (
        "Figure 5. STLC against the real-time ADSC games; one value a game, its mean over the references, T_moves "
        "pooled; line: 1.8. Replicas whose flights are identical make a box of zero width, drawn as it is."
    )
    return style.picture(plot_accuracy(boxes, source), path, caption, source)


def plot_accuracy(boxes: AccuracyBoxes, source: str) -> Figure:
    """Plot boxes of STLC, a row of panels per command and a column per ClockSpeed.

    `boxes[command, clock_speed, rounds]` has one value per game. Identical games give a box of zero width.
    """
    commands = sorted({command for command, _, _ in boxes})
    clocks = sorted({clock for _, clock, _ in boxes})
    rounds = sorted({n for _, _, n in boxes})
    shape = max(len(commands), 1), max(len(clocks), 1)
    with style.project_style():
        size_in = 2.0 + 1.9 * max(len(clocks), 2), 1.2 + 2.3 * shape[0]
        figure = style.new_figure(*size_in, "Accuracy of the trajectories: STLC", source)
        grid = figure.subplots(*shape, sharex=True, sharey=True, squeeze=False)
        if not boxes:
            style.note(grid[0, 0], NO_GAMES)
            return figure
        for (row, column), axes in np.ndenumerate(grid):
            cell = {n: boxes.get((commands[row], clocks[column], n), ()) for n in rounds}
            _plot_boxes(axes, cell, style.COMMAND_COLOUR.get(commands[row], style.GREEN))
        lowest = min((min(values) for values in boxes.values() if len(values)), default=SIMILAR_STLC)
        for axes, clock in zip(grid[0], clocks, strict=True):
            axes.set_title(style.clock_label(clock), loc="center")
        for axes, command in zip(grid[:, 0], commands, strict=True):
            axes.set_ylabel(f"{style.command_name(command)}\nSTLC")
            axes.set_ylim(min(1.7, lowest - 0.05), 2.04)
        for axes in grid[-1]:
            axes.set_xlabel("rounds")
        return figure


def _plot_boxes(axes: Axes, cell: Mapping[int, Sequence[float]], colour: str) -> None:
    axes.axhline(SIMILAR_STLC, color="#C00000", linewidth=1.0, zorder=1)
    places = range(len(cell))
    known = [(place, values) for place, values in zip(places, cell.values(), strict=True) if len(values)]
    if known:
        axes.boxplot(
            [list(values) for _, values in known],
            positions=[place for place, _ in known],
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
        axes.text(0.5, 0.15, NO_GAMES, transform=axes.transAxes, ha="center", color=style.GREY)
    axes.set_xticks(list(places), [str(n) for n in cell])
    axes.set_xlim(-0.6, len(cell) - 0.4)
    axes.grid(axis="x", visible=False)


def speedup_figure(scores: Sequence[CellScores], summary: Summary, path: Path) -> Picture:
    """Draw Figure 6 from the cells with the most rounds."""
    rounds = max((cell["rounds"] for cell in summary["cells"]), default=0)
    cells = [cell for cell in summary["cells"] if cell["rounds"] == rounds]
    source = source_line(rows_of([score for score in scores if score.cell.key.rounds == rounds]))
    caption = (
        f"Figure 6. Effective speed-up of games of {style.rounds_label(rounds)}: mean wall time of ADSC at 1x over the "
        "cell's, with 95 % bootstrap intervals over games. Dashed: the ideal."
    )
    return style.picture(plot_speedup(cells, source, rounds), path, caption, source)


def plot_speedup(cells: Sequence[SummaryCell], source: str, rounds: int) -> Figure:
    """Plot effective speed-ups with their intervals, a panel per command and a line per T_move, the ideal dashed.

    `cells` are a summary's cells of games of `rounds` rounds; those without a speed-up are left out. Speed-ups are on a
    logarithmic axis, so that 1 to 10x can be read.
    """
    known = [cell for cell in cells if cell["effective_speedup"] is not None]
    commands, t_moves, clocks = (
        sorted({cell[name] for cell in known}) for name in ("command", "t_move_s", "clock_speed")
    )
    with style.project_style():
        title = f"Effective speed-up over ADSC at 1x, {style.rounds_label(rounds)}"
        figure = style.new_figure(2.0 + 3.6 * max(len(commands), 1), 4.2, title, source)
        panels = figure.subplots(1, max(len(commands), 1), sharex=True, sharey=True, squeeze=False)[0]
        if not known:
            style.note(panels[0], "no speed-up without ADSC games at 1x")
            return figure
        for axes, command in zip(panels, commands, strict=True):
            _plot_speedups(axes, [cell for cell in known if cell["command"] == command], t_moves, clocks)
            axes.set_title(style.command_name(command))
        panels[0].set(ylabel="effective speed-up", yscale="log")
        panels[0].yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        panels[0].yaxis.set_major_formatter("{x:g}x")
        panels[0].yaxis.set_minor_formatter(NullFormatter())
        panels[0].legend(loc="upper left")
        return figure


def _plot_speedups(
    axes: Axes, cells: Sequence[SummaryCell], t_moves: Sequence[float], clocks: Sequence[float]
) -> None:
    """ClockSpeeds are at equal distances, so that what is lost at the highest can be seen."""
    axes.plot(np.array(clocks), color=style.BLACK, linestyle="--", linewidth=1.1, label="ideal")
    for place, t_move_s in enumerate(t_moves):
        own = sorted((cell for cell in cells if cell["t_move_s"] == t_move_s), key=lambda c: c["clock_speed"])
        if not own:
            continue
        speedups = [cell["effective_speedup"] for cell in own]
        intervals = [cell["effective_speedup_interval"] or (cell["effective_speedup"],) * 2 for cell in own]
        axes.errorbar(
            np.searchsorted(clocks, [cell["clock_speed"] for cell in own]),
            speedups,
            yerr=style.error_bars(speedups, intervals),
            color=style.colour(place),
            marker=style.MARKERS[place % len(style.MARKERS)],
            markersize=4.5,
            capsize=2,
            label=f"T_move {t_move_s:g} s",
        )
    axes.set_xticks(range(len(clocks)), [style.clock_label(clock) for clock in clocks])
    axes.set_xlabel("ClockSpeed")
