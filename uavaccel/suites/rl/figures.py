"""The figures of the RL experiment's report, from its summary and the outcomes of its lanes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import cycle
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavaccel.draw import style
from uavaccel.draw.document import Picture
from uavaccel.draw.style import command_name
from uavaccel.metrics.intervals import Proportion
from uavaccel.records import RunDirectory
from uavaccel.sim.lane.layout import Difficulty, draw_layout
from uavaccel.suites import paper_results
from uavaccel.suites.report import Summary, SummaryCell, listed
from uavaccel.suites.rl.cases import RlRow
from uavaccel.suites.rl.gaps import over_gaps
from uavaccel.suites.rl.plots import (
    SuccessLine,
    plot_distances,
    plot_success,
    plot_success_over_gap,
    plot_training_time,
)
from uavaccel.suites.rl.summary import key_of


def panel_name(cell: SummaryCell) -> str:
    """Return command and profile, as in "TCSC, airsim", with timing and variant where they are not the usual ones."""
    clock = "" if cell["timing"] == "virtual" else f" {cell['timing']}"
    variant = f", {cell['variant'].replace('_', ' ')}" if cell["variant"] else ""
    return f"{command_name(cell['command'])}, {cell['profile']}{clock}{variant}"


def plot_figures(run: RunDirectory, summary: Summary, rows: Sequence[RlRow]) -> list[Picture]:
    """Plot Table I, Figure 8 and, where a clock was simulated, Figure 9."""
    pooled = summary["pooled"]
    seeds = listed(sorted({seed for cell in pooled for seed in cell["seeds"]}))
    source = f"modelled · {summary['training_games']} training games each · seed {seeds}"
    distances = _by_panel(pooled, lambda cell: distances_m(run, rows, cell))
    rows_m = np.unique(draw_layout(0, Difficulty()).x_m).tolist()
    pictures = [
        style.picture(
            plot_success(success_lines(pooled), "Success by training", source),
            run.file("figures/table1_success.png"),
            "Table I as a picture: bars are 95 % intervals over seeds and games, of the paper's Wilson's; dots are "
            "seeds.",
            source,
        ),
        style.picture(
            plot_distances(distances, rows_m, source),
            run.file("figures/figure8_distances.png"),
            "Figure 8. How far the evaluated policies got, seeds pooled.",
            source,
        ),
    ]
    if timed := [cell for cell in pooled if cell["timing"] == "virtual"]:
        figure = plot_training_time(_by_panel(timed, lambda cell: cell), source)
        path = run.file("figures/figure9_training_time.png")
        caption = "Figure 9. Modelled time of a training by phase, mean of its seeds."
        pictures.append(style.picture(figure, path, caption, source))
    return pictures


def plot_gaps(run: RunDirectory, summary: Summary) -> list[Picture]:
    """Plot success in real time over the gap of the training; nothing where there are too few gaps."""
    mapped = over_gaps(summary["pooled"])
    if not mapped:
        return []
    source = f"modelled · {summary['training_games']} training games each"
    lines = [
        success_line(each.label, each.cells, [cell["gap_s"] for cell in each.cells], style.colour(number))
        for number, each in enumerate(mapped)
    ]
    title = "Success in real time over the gap of the training"
    caption = f"{title}. A point is a cell, with its 95 % interval over seeds and games; dots are seeds."
    path = run.file("figures/success_over_gap.png")
    return [style.picture(plot_success_over_gap(lines, title, source), path, caption, source)]


def success_lines(pooled: Sequence[SummaryCell]) -> list[SuccessLine]:
    """Return a line for each command, profile and variant, and the paper's own numbers for its profile."""
    lines: list[SuccessLine] = []
    others = cycle((style.GREEN, style.PURPLE, style.ORANGE, style.SKY))
    for name, panel in _by_panel(pooled, lambda cell: cell).items():
        members = list(panel.values())
        usual = (members[0]["profile"], members[0]["timing"], members[0]["variant"]) == (
            "airsim",
            "virtual",
            "",
        )
        colour = None if usual else next(others)  # the paper's trainings have their command's own colour
        lines.append(success_line(name, members, list(panel), colour))
        known = [cell for cell in members if cell["paper_successes"] is not None]
        if known:
            lines.append(_papers(known))
    return lines


def success_line(
    label: str, cells: Sequence[SummaryCell], at: Sequence[float], colour: str | None = None
) -> SuccessLine:
    """Return a line through cells, each at its ClockSpeed or gap, with the intervals over seeds and games."""
    return SuccessLine(
        label,
        cells[0]["command"],
        at,
        [cell["success_ratio"] for cell in cells],
        [(cell["seeds_low"], cell["seeds_high"]) for cell in cells],
        by_seed=[
            [won * len(cell["seeds"]) / cell["games"] for won in cell["successes_by_seed"]] for cell in cells
        ],
        colour=colour,
    )


def _papers(cells: Sequence[SummaryCell]) -> SuccessLine:
    success = [Proportion(cell["paper_successes"], paper_results.GAMES) for cell in cells]
    command, clocks = cells[0]["command"], [cell["clock_speed"] for cell in cells]
    ratios, intervals = [each.ratio for each in success], [each.interval for each in success]
    return SuccessLine(
        f"{command_name(command)}, the paper's", command, clocks, ratios, intervals, dashed=True
    )


def distances_m(run: RunDirectory, rows: Sequence[RlRow], cell: SummaryCell) -> NDArray[np.float64]:
    """Return the distances north of all evaluation games of a cell, its seeds pooled."""
    arrays = [
        run.load_arrays(row)[f"{row['command']}_distance_m"]
        for row in rows
        if "training" in row and key_of(row) == key_of(cell)
    ]
    return np.concatenate(arrays)


def _by_panel(
    pooled: Iterable[SummaryCell], value: Callable[[SummaryCell], Any]
) -> dict[str, dict[float, Any]]:
    panels: dict[str, dict[float, Any]] = {}
    for cell in sorted(pooled, key=lambda cell: cell["clock_speed"]):
        panels.setdefault(panel_name(cell), {})[cell["clock_speed"]] = value(cell)
    return dict(sorted(panels.items()))
