"""The commands that fly experiments: run, train, evaluate.

Each calls a plain function, which it imports when it runs.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from uavaccel.cli.completion import experiments
from uavaccel.cli.options import (
    Clock,
    Commands,
    DryRun,
    Engine,
    Jobs,
    OneClock,
    OneCommand,
    Out,
    Overrides,
    Profile,
    Resume,
    Seed,
    Timing,
    Trust,
    Watch,
    WatchAt,
)


def run(
    experiment: Annotated[
        str | None,
        typer.Argument(
            help="dp1, dp2, train, evaluate, rl, paper, or an experiment's YAML file; --resume needs none.",
            autocompletion=experiments,
        ),
    ] = None,
    clock: Clock = None,
    command: Commands = None,
    t_move: Annotated[
        list[float] | None, typer.Option("--t-move", help="Seconds; repeat for several.")
    ] = None,
    rounds: Annotated[list[int] | None, typer.Option(help="Rounds of the path; repeat for several.")] = None,
    games: Annotated[int | None, typer.Option(help="Games per cell.")] = None,
    timing: Timing = None,
    profile: Profile = None,
    seed: Seed = None,
    seeds: Annotated[int | None, typer.Option(help="For rl: trainings per cell.")] = None,
    with_run: Annotated[
        str | None, typer.Option("--with", help="For paper: a run of rl, which decides what needs training.")
    ] = None,
    jobs: Jobs = 1,
    engine: Engine = "loky",
    out: Out = None,
    resume: Resume = False,
    trust: Trust = False,
    dry_run: DryRun = False,
    overrides: Overrides = None,
    watch: Watch = False,
    watch_at: WatchAt = None,
) -> None:
    """Fly an experiment, measure it and draw its figures."""
    from uavaccel.cli.run import RunRequest, run_experiment
    from uavaccel.watch.beside import parse_address

    options = {
        "clock_speed": clock,
        "command": command,
        "t_move_s": t_move,
        "rounds": rounds,
        "games": games,
        "timing": timing,
        "profile": profile,
        "seed": seed,
        "seeds": seeds,
        "with_run": with_run,
    }
    page = parse_address(watch, watch_at)
    request = RunRequest(
        experiment, options, overrides or [], jobs, out, resume, dry_run, engine=engine, page=page, trust=trust
    )
    run_experiment(request)


def train(
    experiment: Annotated[
        str | None, typer.Argument(help="An experiment's YAML file; --resume needs none.")
    ] = None,
    clock: OneClock = None,
    command: OneCommand = None,
    timing: Timing = None,
    profile: Profile = None,
    games: Annotated[int | None, typer.Option(help="Games to learn from.")] = None,
    seed: Seed = None,
    out: Out = None,
    resume: Resume = False,
    trust: Trust = False,
    dry_run: DryRun = False,
    overrides: Overrides = None,
    watch: Watch = False,
    watch_at: WatchAt = None,
) -> None:
    """Train a policy in the obstacle lane: `run` on a training's YAML file."""
    from uavaccel.cli.run import RunRequest, run_experiment
    from uavaccel.watch.beside import parse_address

    options = _task_options(clock, command, timing, profile) | {"games": games, "seed": seed}
    named = experiment or (None if resume else "train")
    page = parse_address(watch, watch_at)
    request = RunRequest(
        named, options, overrides or [], 1, out, resume, dry_run, "train", page=page, trust=trust
    )
    run_experiment(request)


def evaluate(
    agent: Annotated[
        str | None,
        typer.Argument(
            help="A training's run directory, a policy's folder, straight or offset:METRES; by default what ships."
        ),
    ] = None,
    games: Annotated[int | None, typer.Option(help="Number of evaluation lanes; by default 300.")] = None,
    clock: OneClock = None,
    command: OneCommand = None,
    timing: Timing = None,
    profile: Profile = None,
    seed: Seed = None,
    jobs: Jobs = 1,
    engine: Engine = "loky",
    against: Annotated[
        Path | None, typer.Option(help="Another evaluation to compare with, on the same lanes.")
    ] = None,
    films: Annotated[bool, typer.Option(help="Film the best and the worst game.")] = True,
    sweep: Annotated[
        list[str] | None,
        typer.Option(help="NAME=VALUE,VALUE,... flown one at a time, as in wind=0,3,6; repeatable."),
    ] = None,
    out: Out = None,
    resume: Resume = False,
    trust: Trust = False,
    dry_run: DryRun = False,
    overrides: Overrides = None,
    watch: Watch = False,
    watch_at: WatchAt = None,
) -> None:
    """Fly an agent on lanes that no training has seen, as `run evaluate`: success ratio, Figure 8, films."""
    from uavaccel.cli.evaluate import evaluate_agent, sweep_agent
    from uavaccel.cli.run import RunRequest
    from uavaccel.watch.beside import parse_address

    options = _task_options(clock, command, timing, profile) | {"games": games, "seed": seed, "agent": agent}
    named = None if agent is None and resume else "evaluate"
    page = parse_address(watch, watch_at)
    request = RunRequest(
        named, options, overrides or [], jobs, out, resume, dry_run, "evaluate", engine, page, trust
    )
    if sweep:
        sweep_agent(request, sweep, against)
    else:
        evaluate_agent(request, against, films)


def _task_options(
    clock: float | None, command: str | None, timing: str | None, profile: str | None
) -> dict[str, object]:
    return {"clock_speed": clock, "command": command, "timing": timing, "profile": profile}
