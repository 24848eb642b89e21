"""Figure 8: how far the games of evaluations got, several side by side."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from uavaccel.draw.survival import draw_survival
from uavaccel.metrics.speedup import timing_provenance
from uavaccel.records import RunDirectory


def report_evaluations(runs: Sequence[RunDirectory]) -> Path:
    """Figure 8 with a line an evaluation, in the first one's folder."""
    distances = {_name(run, runs): [row["distance_m"] for row in run.rows()] for run in runs}
    timings = {timing_provenance(run.config()["task"]["timing"]) for run in runs}
    games = {len(rows) for rows in distances.values()}
    seeds = sorted({run.config()["seed"] for run in runs})
    source = f"{' and '.join(sorted(timings))} · {_listed(sorted(games))} games each · seed {_listed(seeds)}"
    return draw_survival(distances, runs[0].file("figures/figure8_survival.png"), source)


def _name(run: RunDirectory, runs: Sequence[RunDirectory]) -> str:
    agent = str(run.config()["agent"])
    alike = [other for other in runs if other.config()["agent"] == agent]
    return agent if len(alike) == 1 else f"{agent} ({run.path})"  # folders may share their last name


def _listed(numbers: Sequence[Any]) -> str:
    return ", ".join(str(number) for number in numbers)
