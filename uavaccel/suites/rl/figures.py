"""The figures of the RL experiment, out of its summary and the lanes' outcomes."""

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
from uavaccel.suites.report import Row, Summary, SummaryCell, listed
from uavaccel.suites.rl.distances import plot_distances
from uavaccel.suites.rl.gaps import over_gaps
from uavaccel.suites.rl.success import SuccessLine, plot_success, plot_success_over_gap
from uavaccel.suites.rl.training_time import TrainingTime, plot_training_time

TABLE_I, FIGURE_8, FIGURE_9, GAPS = (
    "figures/table1_success.png",
    "figures/figure8_distances.png",
    "figures/figure9_training_time.png",
    "figures/success_over_gap.png",
)


def panel_name(cell: SummaryCell) -> str:
    """TCSC, airsim; where it says more, its clock and variant."""
    clock = "" if cell["timing"] == "virtual" else f" {cell['timing']}"
    variant = f", {cell['variant'].replace('_', ' ')}" if cell["variant"] else ""
    return f"{command_name(cell['command'])}, {cell['profile']}{clock}{variant}"


def is_papers(cell: SummaryCell) -> bool:
    """Whether the paper has trained so: under AirSim, and nothing else changed."""
    return cell["profile"] == "airsim" and cell["timing"] == "virtual" and not cell["variant"]


def draw_figures(run: RunDirectory, summary: Summary, rows: Sequence[Row]) -> list[Picture]:
    """Table I, Figure 8 and Figure 9 as pictures with their captions."""
    pooled = summary["pooled"]
    seeds = listed(sorted({seed for cell in pooled for seed in cell["seeds"]}))
    source = f"modelled · {summary['training_games']} training games each · seed {seeds}"
    table = style.save(plot_success(success_lines(pooled), "Success by training", source), run.file(TABLE_I))
    distances = _by_panel(pooled, lambda cell: distances_m(run, rows, cell))
    rows_m = np.unique(draw_layout(0, Difficulty()).x_m).tolist()
    figure8 = style.save(plot_distances(distances, rows_m, source), run.file(FIGURE_8))
    pictures = [
        Picture(
            table,
            "Table I as a picture: bars are 95 % intervals over seeds and games, of the paper's Wilson's; dots are "
            f"seeds. Source: {source}.",
        ),
        Picture(figure8, f"Figure 8. How far the evaluated policies got, seeds pooled. Source: {source}."),
    ]
    timed = [cell for cell in pooled if cell["timing"] == "virtual"]
    if timed:
        times = {name: list(panel.values()) for name, panel in _by_panel(timed, training_time).items()}
        figure9 = style.save(plot_training_time(times, source), run.file(FIGURE_9))
        pictures.append(
            Picture(
                figure9,
                f"Figure 9. Modelled time of a training by phase, mean of its seeds. Source: {source}.",
            )
        )
    return pictures


def draw_gaps(run: RunDirectory, summary: Summary) -> list[Picture]:
    """Success in real time over the gap of the training; nothing where too few gaps were trained with."""
    mapped = over_gaps(summary["pooled"])
    if not mapped:
        return []
    source = f"modelled · {summary['training_games']} training games each"
    colours = cycle(style.CYCLE)
    lines = [
        success_line(each.label, each.cells, [cell["gap_s"] for cell in each.cells], next(colours))
        for each in mapped
    ]
    title = "Success in real time over the gap of the training"
    path = style.save(plot_success_over_gap(lines, title, source), run.file(GAPS))
    said = "A point is a cell, with its 95 % interval over seeds and games; dots are seeds."
    return [Picture(path, f"{title}. {said} Source: {source}.")]


def success_lines(pooled: Sequence[SummaryCell]) -> list[SuccessLine]:
    """A line for each command, profile and variant; beside the paper's profile the paper's own numbers."""
    lines: list[SuccessLine] = []
    others = cycle((style.GREEN, style.PURPLE, style.ORANGE, style.SKY))
    for name, panel in _by_panel(pooled, lambda cell: cell).items():
        members = list(panel.values())
        colour = None if is_papers(members[0]) else next(others)
        lines.append(success_line(name, members, list(panel), colour))
        known = [cell for cell in members if cell["paper_successes"] is not None]
        if known:
            lines.append(_papers(known))
    return lines


def success_line(
    label: str, cells: Sequence[SummaryCell], at: Sequence[float], colour: str | None = None
) -> SuccessLine:
    """Cells with the intervals over seeds and games, each at its ClockSpeed or gap."""
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


def distances_m(run: RunDirectory, rows: Sequence[Row], cell: SummaryCell) -> NDArray[np.float64]:
    """Metres north in all evaluation games of a cell, its seeds together."""
    keys = ("variant", "profile", "timing", "command", "clock_speed")
    arrays = [
        run.load_arrays(row)[f"{row['command']}_distance_m"]
        for row in rows
        if "training" in row and all(row[key] == cell[key] for key in keys)
    ]
    return np.concatenate(arrays)


def training_time(cell: SummaryCell) -> TrainingTime:
    """Of one training: the mean of the seeds; rendering is part of the paper's simulation."""
    mean_s = {phase: spent / len(cell["seeds"]) for phase, spent in cell["phase_s"].items()}
    phases = {
        "simulation (with rendering)": mean_s["simulation"] + mean_s["rendering"],
        "image processing": mean_s["image_processing"],
        "inference": mean_s["inference"],
        "learning": mean_s["learning"],
    }
    return TrainingTime(
        cell["clock_speed"],
        phases,
        cell["training_speedup"],
        cell["whole_training_speedup"],
        cell["paper_training_speedup"],
        cell["paper_whole_training_speedup"],
    )


def _by_panel(
    pooled: Iterable[SummaryCell], value: Callable[[SummaryCell], Any]
) -> dict[str, dict[float, Any]]:
    panels: dict[str, dict[float, Any]] = {}
    for cell in sorted(pooled, key=lambda cell: cell["clock_speed"]):
        panels.setdefault(panel_name(cell), {})[cell["clock_speed"]] = value(cell)
    return dict(sorted(panels.items()))
