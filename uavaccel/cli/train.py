"""`uavaccel train`: configuration, run directory, progress, and the line that it ends with."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, TextColumn
from rich.progress import Progress as Bar

from uavaccel.bench.machine import check_host
from uavaccel.cli.shared import given, resumable, time_stamp
from uavaccel.clock import calendar_time
from uavaccel.config import apply_overrides, validate
from uavaccel.manifest import describe_run
from uavaccel.records import RunDirectory
from uavaccel.rl.config import TrainConfig
from uavaccel.sim.gl import describe_renderer
from uavaccel.suites.experiment import read_latency, read_mapping
from uavaccel.suites.training.flights import train
from uavaccel.suites.training.report import report_trainings

LINES = 20  # of progress where there is no terminal to redraw

console = Console(highlight=False, soft_wrap=True)


@dataclass(frozen=True)
class Request:
    """What was asked for; None where nothing was said. `task` are keys of the task."""

    experiment: str
    games: int | None
    seed: int | None
    task: dict[str, Any]
    overrides: Sequence[str]
    out: Path | None
    resume: bool


def train_policy(request: Request) -> None:
    """Train, show progress, say what came out. Raises UserError with one clear line."""
    config = configure(request)
    out = request.out or Path("runs") / f"{Path(request.experiment).stem}-{time_stamp()}"
    run = RunDirectory.create(out, config, manifest_of(config), request.resume)
    console.print(
        f"{config.games} games, {config.algorithm}, {config.environments} environment(s), into {out}"
    )
    with resumable(out), _Progress(config.games) as progress:
        summary = train(config, run, progress.show)
    console.print(
        f"{summary['successes']} of {summary['games']} training games succeeded; "
        f"weights {summary['weights_sha256'][:12]}"
    )
    console.print(str(report_trainings([run])))
    console.print(f"policy: {out / 'policy.pt'}; evaluate it with: uavaccel evaluate {out}")


def configure(request: Request) -> TrainConfig:
    """YAML, then options, then --set. A latency model may be named by its file. Raises UserError."""
    mapping, source = read_mapping(request.experiment)
    mapping |= given({"games": request.games, "seed": request.seed})
    mapping["task"] = {**(mapping.get("task") or {}), **given(request.task)}
    merged = apply_overrides(mapping, request.overrides)
    latency = merged["task"].get("latency")
    if isinstance(latency, str):
        merged["task"]["latency"] = read_latency(Path(latency))
    return validate(TrainConfig, merged, source)


def manifest_of(config: TrainConfig) -> dict[str, Any]:
    """What the run is made with, torch's threads among it."""
    renderer = None if config.task.observation == "state" else describe_renderer()
    if renderer is not None and renderer.software:
        console.print(f"renderer: {renderer.name} (software)")
    manifest = describe_run(
        sys.argv, config.seed, calendar_time(), gl_renderer=renderer.name if renderer else None
    )
    manifest["torch_threads"] = config.torch_threads
    if config.task.timing == "wall":
        manifest["host_check"] = check_host()
    return manifest


class _Progress:
    """A bar on a terminal, a few plain lines elsewhere."""

    def __init__(self, games: int) -> None:
        self._games = games
        self._printed = 0
        self._first: dict[str, Any] | None = None
        columns = (BarColumn(), TextColumn("{task.description}"))
        self._bar = Bar(*columns, console=console, disable=not console.is_terminal)
        self._task = self._bar.add_task("", total=games)

    def show(self, status: dict[str, Any]) -> None:
        """After each game."""
        text = self._text(status)
        self._bar.update(self._task, completed=status["games"], description=text)
        share = status["games"] * LINES // self._games
        if not console.is_terminal and share > self._printed:
            self._printed = share
            console.print(text)

    def _text(self, status: dict[str, Any]) -> str:
        self._first = self._first or status
        flown = status["games"] - self._first["games"] + 1
        left_s = status["wall_s"] / flown * (self._games - status["games"])
        return (
            f"{status['games']}/{self._games} games, success of the last 100: {status['success_recent']:.0%}, "
            f"{status['simulated_s'] / status['wall_s']:.0f} simulated s/s, {left_s / 60:.0f} min left"
        )

    def __enter__(self) -> _Progress:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()
