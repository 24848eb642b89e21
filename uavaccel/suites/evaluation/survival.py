"""How many games got how far down the lane (the paper's Figure 8, section IV-D)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from uavaccel.draw import style
from uavaccel.envs.simulators import EXACT, flown_by
from uavaccel.metrics.intervals import Proportion
from uavaccel.records import RunDirectory
from uavaccel.sim.lane.layout import LENGTH_M
from uavaccel.suites.disturbed import disturbed_words
from uavaccel.suites.evaluation.summary import how_flown
from uavaccel.suites.report import listed

COMPARISON = "figures/figure8_survival_compared.png"


def draw_evaluations(runs: Sequence[RunDirectory], path: Path) -> Path:
    """Figure 8 with a line for each evaluation; returns `path`."""
    distances = {_name(run, runs): [row["distance_m"] for row in run.rows()] for run in runs}
    return style.save(plot_survival(distances, evaluations_source(runs)), path)


def evaluations_source(runs: Sequence[RunDirectory]) -> str:
    """The line below it."""
    timings = {how_flown(run.config() | {"timing": run.config()["task"]["timing"]}) for run in runs}
    games = sorted({len(run.rows()) for run in runs})
    seeds = sorted({run.config()["seed"] for run in runs})
    told = [
        f"{' and '.join(sorted(timings))} · {listed(games)} games each · seed {listed(seeds)}",
        *disturbed_words([row for run in runs for row in run.rows()]),
    ]
    return " · ".join(told)


def _name(run: RunDirectory, runs: Sequence[RunDirectory]) -> str:
    name = _agent_and_simulator(run)
    alike = [other for other in runs if _agent_and_simulator(other) == name]
    return name if len(alike) == 1 else f"{name} ({run.path})"  # folders may share their last name


def _agent_and_simulator(run: RunDirectory) -> str:
    config = run.config()
    by = flown_by(config.get("simulator", EXACT), config.get("device", ""))
    return ", ".join([str(config["agent"]), *filter(None, [by])])


def plot_survival(distances_m: Mapping[str, Sequence[float]], source: str) -> Figure:
    """The share of games that reached each distance, a line per evaluation in its 95 % Wilson interval.

    Distances in metres, by its name.
    """
    with style.project_style():
        figure = style.new_figure(8.0, 4.6, "Distance travelled", source)
        axes = figure.subplots()
        for name, values in distances_m.items():
            reached = np.sort(np.minimum(np.asarray(values, float), LENGTH_M))
            share = 1.0 - np.arange(len(reached) + 1) / len(reached)
            places = np.concatenate([[0.0], reached])
            (line,) = axes.step(places, share, where="post", label=name)
            ends = [
                Proportion(len(reached) - gone, len(reached)).interval for gone in range(len(reached) + 1)
            ]
            low, high = zip(*ends, strict=True)
            axes.fill_between(places, low, high, step="post", color=line.get_color(), alpha=0.15, linewidth=0)
        axes.axvline(LENGTH_M, color=style.BLACK, linewidth=1.2, linestyle="--", label="end of the lane")
        axes.set_xlabel("distance north, m")
        axes.set_ylabel("share of games that got there")
        axes.set_ylim(0.0, 1.05)
        axes.legend(loc="lower left")
        return figure
