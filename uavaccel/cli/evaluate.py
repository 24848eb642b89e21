"""`uavaccel evaluate`: an agent on evaluation lanes; success with its interval, Figure 8, films, paired comparison."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from uavaccel.cli.shared import check_jobs, given, resumable, time_stamp
from uavaccel.clock import calendar_time
from uavaccel.config import apply_overrides, validate
from uavaccel.draw.film import write_contact_sheet, write_video
from uavaccel.errors import UserError
from uavaccel.manifest import describe_run
from uavaccel.metrics.intervals import mcnemar_exact
from uavaccel.metrics.speedup import timing_provenance
from uavaccel.records import RunDirectory
from uavaccel.suites.evaluation.film import best_first, film_lane
from uavaccel.suites.evaluation.flights import EvaluateConfig, evaluate
from uavaccel.suites.evaluation.report import report_evaluations

console = Console(highlight=False, soft_wrap=True)


@dataclass(frozen=True)
class Request:
    """What was asked for; None where nothing was said. `task` are keys of the task."""

    agent: str
    games: int | None
    seed: int | None
    task: dict[str, Any]
    jobs: int
    overrides: Sequence[str]
    out: Path | None
    resume: bool
    against: Path | None
    films: bool


def evaluate_agent(request: Request) -> None:
    """Evaluate, print the success ratio, write figure and films. Raises UserError with one clear line."""
    config = configure(request)
    check_jobs(request.jobs, config.task.timing)
    out = request.out or Path("runs") / f"evaluate-{time_stamp()}"
    manifest = describe_run(sys.argv, config.seed, calendar_time())
    run = RunDirectory.create(out, config, manifest, request.resume)
    with resumable(out):
        summary = evaluate(config, run, request.jobs, lambda row: _show(row, config.games, run))
    console.print(
        f"{summary['successes']} of {summary['games']} lanes ({summary['success_ratio']:.1%}, 95 % Wilson interval "
        f"{summary['wilson_low']:.1%} to {summary['wilson_high']:.1%}), {timing_provenance(config.task.timing)}, "
        f"{config.task.command} at {config.task.clock_speed:g}x, {summary['simulated_s_per_wall_s']:.4g} simulated "
        f"seconds a wall second, seed {config.seed}"
    )
    rows = run.rows()
    if request.against is not None:
        console.print(compare(rows, RunDirectory(request.against)))
    console.print(str(report_evaluations([run])))
    if request.films:
        _film(config, run, rows)


def configure(request: Request) -> EvaluateConfig:
    """Options, then --set, over the defaults: 300 evaluation lanes at 1x in `virtual`. Raises UserError."""
    task = {"split": "evaluation", "timing": "virtual", **given(request.task)}
    mapping = {"agent": request.agent, "task": task, **given({"games": request.games, "seed": request.seed})}
    return validate(EvaluateConfig, apply_overrides(mapping, request.overrides), "evaluate")


def compare(rows: Sequence[dict[str, Any]], other: RunDirectory) -> str:
    """McNemar's test on the lanes that both evaluations flew, in words. Raises UserError without such lanes."""
    theirs = {row["lane"]: row["is_success"] for row in other.rows() if row.get("suite") == "evaluate"}
    paired = [(row["is_success"], theirs[row["lane"]]) for row in rows if row["lane"] in theirs]
    if not paired:
        raise UserError(f"{other.path}: is no evaluation of the same lanes")
    first, second = np.array(paired).T
    test = mcnemar_exact(first, second)
    return (
        f"against {other.path} on the same {len(paired)} lanes: {int(first.sum())} v {int(second.sum())} successes, "
        f"exact McNemar p = {test.p_value:.3g}"
    )


def _show(row: dict[str, Any], games: int, run: RunDirectory) -> None:
    done = len(run.done_cases())
    if done % max(games // 10, 1) == 0:
        console.print(f"{done}/{games} lanes")


def _film(config: EvaluateConfig, run: RunDirectory, rows: Sequence[dict[str, Any]]) -> None:
    """The best game and the worst as films and contact sheets."""
    order = best_first(rows)
    for name, row in {"best": order[0], "worst": order[-1]}.items():
        film = film_lane(config, int(row["lane"]))
        console.print(str(write_video(film, run.file(f"films/{name}.mp4"))))
        console.print(str(write_contact_sheet(film, run.file(f"films/{name}.png"))))
