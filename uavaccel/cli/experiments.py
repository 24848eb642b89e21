"""The commands that fly and report experiments: run, train, evaluate. They import what they need when run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from uavaccel.cli.options import given_options, option, requests, shipped
from uavaccel.cli.terminal import console, show_table, working
from uavaccel.errors import UsageError, UserError
from uavaccel.resources import experiments
from uavaccel.suites.keys import KEYS

if TYPE_CHECKING:
    from uavaccel.records import RunDirectory
    from uavaccel.suites.session import Plan, RunRequest

GRIDS = ("clock_speed", "command", "t_move_s", "rounds")


@requests(*KEYS, several=GRIDS)
def run(
    request: RunRequest,
    context: typer.Context,
    names: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="EXPERIMENT",
            help="One that ships (--list), or its YAML file; none with --resume. With --report: run directories.",
            autocompletion=shipped,
        ),
    ] = None,
    listed: Annotated[bool, option(None, "List the experiments that ship; fly nothing.", "--list")] = False,
    report: Annotated[
        bool, option(None, "Compute metrics and figures of finished runs again; fly nothing.", "--report")
    ] = False,
) -> None:
    """Fly an experiment, measure it and draw its figures.

    With one --clock, dp1 and dp2 fly a quick run: on the machine's clock (--timing wall), and dp1 with 3 games of each
    cell and 3 real-time games to compare them with, unless options say otherwise. The whole experiment at one
    ClockSpeed is --set clock_speed=[50].
    """
    names = names or []
    if listed:
        for name, about in experiments().items():
            console.print(f"{name:20}  {about}")
    elif report:
        if others := [name for name in given_options(context) if name not in ("names", "--report", "--trust")]:
            raise UsageError(f"--report: flies nothing; beside run directories it takes --trust alone, not {others[0]}")
        report_runs(list(map(Path, names)), request.trust)
    elif len(names) > 1:
        raise UsageError(f"run: flies one experiment, not {len(names)}: {', '.join(names)}")
    else:
        run_experiment(replace(request, experiment=next(iter(names), None)))


@requests("games", "clock_speed", "command", "timing", "profile", "seed", "seeds", games="Episodes (games) to train")
def train(
    request: RunRequest,
    experiment: Annotated[
        str | None,
        typer.Argument(
            metavar="TRAINING",
            help="A YAML file, a task as my_task.py, or what ships, as train_gpu; default: train.",
            autocompletion=shipped,
        ),
    ] = None,
) -> None:
    """Train a policy, by default in the obstacle lane."""
    experiment = experiment or (None if request.resume else "train")
    run_experiment(replace(request, experiment=experiment, suite="train"))


@requests("games", "clock_speed", "command", "timing", "profile", "seed", games="Episodes (games) to fly, one a lane")
def evaluate(
    request: RunRequest,
    agent: Annotated[
        str | None,
        typer.Argument(
            metavar="AGENT",
            help="A training's run directory or policy, model.zip, FILE.onnx, file.py:function, straight, "
            "offset:METRES, or an evaluation's YAML file; default: the bundled policy.",
        ),
    ] = None,
    against: Annotated[Path | None, option("RUN_DIR", "Another evaluation on the same lanes, to compare with.")] = None,
    films: Annotated[
        bool | None, option(None, "Film the best and the worst episode; default: films, with --resume as it began.")
    ] = None,
    sweep: Annotated[
        list[str] | None,
        option("NAME=V,V,...", "Change one condition at a time, as in wind=0,3,6; repeat for several."),
    ] = None,
) -> None:
    """Fly a policy in games it has not seen: success ratio, films."""
    from uavaccel.suites.registry import is_yaml

    experiment = None if agent is None and request.resume else "evaluate"
    if agent is not None and is_yaml(agent):
        if sweep:
            raise UsageError(f"--sweep: takes an agent, not {agent}: a sweep's own YAML file says `suite: sweep`")
        experiment, agent = agent, None
    request = replace(request, experiment=experiment, suite="evaluate", options={**request.options, "agent": agent})
    if sweep:
        sweep_agent(request, sweep, against)
    else:
        evaluate_agent(request, against, films)


def report_runs(run_dirs: Sequence[Path], trust: bool = False) -> None:
    """Report runs again, and draw several of a suite side by side, in the first one's folder. Raises UserError."""
    from uavaccel.own_code import errors_named, files_of, trusting
    from uavaccel.records import RunDirectory
    from uavaccel.suites.registry import suite_of

    if not run_dirs:
        raise UsageError("--report: name a run directory, or several")
    by_suite: dict[str, list[RunDirectory]] = {}
    with trusting(trust):
        for run_dir in run_dirs:
            run = RunDirectory(run_dir)
            report_run(run)
            by_suite.setdefault(str(run.config()["suite"]), []).append(run)
        for runs in by_suite.values():
            suite = suite_of(runs[0])
            with errors_named(files_of(type(suite))):
                for path in suite.compare(runs) if len(runs) > 1 else ():
                    console.print(str(path))


def run_experiment(
    request: RunRequest,
    check: Callable[[Plan], object] | None = None,
    flown: Callable[[RunDirectory], object] | None = None,
) -> RunDirectory | None:
    """Fly and report an experiment; return the run, or None for a dry run. Raises UserError with one line.

    `check` looks at the plan before anything flies, `flown` at the run before its report.
    """
    from uavaccel.cli.terminal import Progress
    from uavaccel.clock import MonotonicClock
    from uavaccel.draw.page import in_words
    from uavaccel.suites.session import planned, resumable
    from uavaccel.units import NS_PER_S

    clock = MonotonicClock()
    begun_ns = clock.now_ns()
    with planned(request) as plan:
        if check is not None and not request.dry_run:
            check(plan)
        page = _page(plan)
        for line in plan.lines():
            console.print(line)
        if request.dry_run:
            return None
        with resumable(plan):
            run = plan.begin(console.print)
            with page(), Progress(plan.suite, plan.cases, plan.request.jobs, run.rows(), console) as progress:
                plan.fly(run, progress.flown)
            try:
                if flown is not None:
                    flown(run)
            finally:
                report_run(run)
            took_s = (clock.now_ns() - begun_ns) / NS_PER_S
            console.print(f"{in_words(took_s)} in all, from this start to the report")
        return run


def _page(plan: Plan) -> Callable[[], AbstractContextManager[object]]:
    """Return what opens the page that shows the flights, where it was asked for.

    Raises UsageError where nothing flies in a scene of this machine, UserError without a free port.
    """
    if not plan.request.watch:
        return nullcontext
    from uavaccel.envs.simulators import KERNELS
    from uavaccel.processes.workers import LOKY
    from uavaccel.watch.beside import LOOPBACK, PORT, free_port, page_beside

    if getattr(plan.config, "simulator", None) == KERNELS:
        raise UsageError("--watch: the kernels fly numbers, without a scene to look at: --set simulator=mujoco")
    if plan.request.engine != LOKY:
        raise UsageError(f"--watch: sees flights of this machine only, none of a cluster: --engine {LOKY}")
    free_port(LOOPBACK, PORT)
    return page_beside


def report_run(run: RunDirectory) -> None:
    """Write a run's report, and print its result and the paths of its figures."""
    from uavaccel.own_code import errors_named, files_of
    from uavaccel.suites.registry import suite_of

    suite = suite_of(run)
    with working("the report"), errors_named(files_of(type(suite))):
        report = suite.report(run)
        summary, said, table = report.write(), report.headline(), report.overview()
    for line in filter(None, (said, report.pace())):
        console.print(line)
    if table:
        show_table(table)
    cells = summary.get("cells", ())
    if lost := [cell["lost_wall_s"] for cell in cells if cell.get("lost_wall_s")]:
        share = f"{sum(lost):.3f} s of wall time lost in {len(lost)} of {len(cells)} cells"
        console.print(f"warning: the machine did not keep up: {share}")
    for path in sorted((run.path / "figures").glob("*.png")):
        console.print(str(path))
    console.print(f"report: {run.path / 'report.html'}")


def evaluate_agent(request: RunRequest, against: Path | None, films: bool | None) -> None:
    """Evaluate an agent, film, and compare it with another evaluation of the same lanes. Raises UserError.

    Without a word on films there are some, unless a run that is resumed was begun with --no-films.
    """
    from uavaccel.records import RunDirectory
    from uavaccel.suites.evaluate import against as compared
    from uavaccel.suites.evaluate import outcomes_of
    from uavaccel.suites.registry import open_run

    other = None if against is None else open_run(against)

    def check(plan: Plan) -> None:
        if other is not None:
            outcomes_of(other, plan.config.model_dump(mode="json"), {case.id for case in plan.cases})

    if films is None and request.resume and request.out is not None and (request.out / "manifest.json").is_file():
        films = "--no-films" not in RunDirectory(request.out).manifest().get("command_line", ())
    run = run_experiment(request, check, None if films is False else film_extremes)
    if run is not None and other is not None:
        console.print(compared(run, other))


def film_extremes(run: RunDirectory) -> None:
    """Write films and contact sheets of the best game and the worst, for the report, where films can be made."""
    from uavaccel.draw.style import check_films
    from uavaccel.envs.simulators import EXACT
    from uavaccel.suites.evaluate import Evaluation
    from uavaccel.suites.flight import film_game

    try:
        check_films()
    except UserError as error:
        console.print(f"without films: {error}")
        return
    order = sorted(run.rows(), key=Evaluation().interest)
    if run.config().get("simulator", EXACT) != EXACT:
        console.print("films: both games once more in the exact simulator, where they may end otherwise")
    for number, (name, row) in enumerate({"best": order[0], "worst": order[-1]}.items(), start=1):
        console.print(f"film {number} of 2, before the report: {row['case']}, the {name} game, flown again")
        for path in film_game(run.path, row["case"], None, run.file(f"films/{name}.mp4"), working):
            console.print(str(path))


def sweep_agent(request: RunRequest, sweep: list[str], against: Path | None) -> None:
    """Evaluate an agent under one changed condition after another. Raises UserError."""
    from uavaccel.suites.grid import parse_sweep
    from uavaccel.suites.session import as_sweep

    if against is not None:
        raise UsageError("--against: compares two evaluations; a sweep compares each condition with the training's")
    conditions = [parse_sweep(text) for text in sweep]
    if len({name for name, _ in conditions}) < len(conditions):
        raise UsageError("--sweep: names a condition twice; give all its values at once, as in wind=0,3,6")
    run_experiment(as_sweep(request, dict(conditions)))
