"""The commands that fly and report experiments: run, train, evaluate, report. They import what they need when run."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from uavaccel.cli.options import Trust, experiments, requests
from uavaccel.cli.terminal import console, show_table, working
from uavaccel.errors import UsageError, UserError
from uavaccel.suites.keys import KEYS

if TYPE_CHECKING:
    from uavaccel.records import RunDirectory
    from uavaccel.suites.session import Plan, RunRequest

GRIDS = ("clock_speed", "command", "t_move_s", "rounds")


@requests(*KEYS, several=GRIDS)
def run(
    request: RunRequest,
    experiment: Annotated[
        str | None,
        typer.Argument(
            help="dp1, dp2, train, evaluate, rl, paper, or an experiment's YAML file; --resume needs none.",
            autocompletion=experiments,
        ),
    ] = None,
) -> None:
    """Fly an experiment, measure it and draw its figures."""
    run_experiment(replace(request, experiment=experiment))


@requests("games", "clock_speed", "command", "timing", "profile", "seed", jobs=False)
def train(
    request: RunRequest,
    experiment: Annotated[str | None, typer.Argument(help="An experiment's YAML file; --resume needs none.")] = None,
) -> None:
    """Train a policy in the obstacle lane: `run` on a training's YAML file."""
    experiment = experiment or (None if request.resume else "train")
    run_experiment(replace(request, experiment=experiment, suite="train"))


@requests("games", "clock_speed", "command", "timing", "profile", "seed")
def evaluate(
    request: RunRequest,
    agent: Annotated[
        str | None,
        typer.Argument(
            help="A training's run directory, a policy's folder, straight or offset:METRES; by default what ships."
        ),
    ] = None,
    against: Annotated[Path | None, typer.Option(help="Another evaluation to compare with, on the same lanes.")] = None,
    films: Annotated[bool, typer.Option(help="Film the best and the worst game.")] = True,
    sweep: Annotated[
        list[str] | None, typer.Option(help="NAME=VALUE,VALUE,... flown one at a time, as in wind=0,3,6; repeatable.")
    ] = None,
) -> None:
    """Fly an agent on lanes that no training has seen, as `run evaluate`: success ratio, Figure 8, films."""
    experiment = None if agent is None and request.resume else "evaluate"
    request = replace(request, experiment=experiment, suite="evaluate", options={**request.options, "agent": agent})
    if sweep:
        sweep_agent(request, sweep, against)
    else:
        evaluate_agent(request, against, films)


def report(run_dirs: Annotated[list[Path], typer.Argument(help="Run directories.")], trust: Trust = False) -> None:
    """Compute the metrics and draw the figures of finished runs again; fly nothing.

    Several trainings, or several evaluations, are also drawn side by side, in the first one's folder.
    """
    from uavaccel.records import RunDirectory
    from uavaccel.suites.own_code import trusting
    from uavaccel.suites.registry import suite_of

    by_suite: dict[str, list[RunDirectory]] = {}
    with trusting(trust):
        for run_dir in run_dirs:
            run = RunDirectory(run_dir)
            report_run(run)
            by_suite.setdefault(str(run.config()["suite"]), []).append(run)
        for runs in by_suite.values():
            for path in suite_of(runs[0]).compare(runs) if len(runs) > 1 else ():
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
    from uavaccel.suites.session import planned, resumable

    with planned(request) as plan:
        if check is not None and not request.dry_run:
            check(plan)
        page = _page(plan)
        for line in plan.lines():
            console.print(line)
        if request.dry_run:
            return None
        with resumable(plan.out):
            run = plan.begin(console.print)
            with page(), Progress(plan.cases, plan.request.jobs, run.rows(), plan.suite.status, console) as progress:
                plan.fly(run, progress.flown)
            try:
                if flown is not None:
                    flown(run)
            finally:
                report_run(run)
        return run


def _page(plan: Plan) -> Callable[[], AbstractContextManager[object]]:
    """Return what opens the page that shows the flights, where it was asked for.

    Raises UsageError where nothing flies in a scene of this machine, UserError without a free port.
    """
    if not plan.request.watch:
        return nullcontext
    from uavaccel.envs.simulators import KERNELS
    from uavaccel.suites.engines import LOKY
    from uavaccel.watch.beside import PageAddress, free_port, page_beside

    if getattr(plan.config, "simulator", None) == KERNELS:
        raise UsageError("--watch: the kernels fly numbers, without a scene to look at: --set simulator=mujoco")
    if plan.request.engine != LOKY:
        raise UsageError(f"--watch: sees flights of this machine only, none of a cluster: --engine {LOKY}")
    free_port(PageAddress.host, PageAddress.port)
    return partial(page_beside, PageAddress())


def report_run(run: RunDirectory) -> None:
    """Write a run's report, and print its result and the paths of its figures."""
    from uavaccel.suites.registry import suite_of

    report = suite_of(run).report(run)
    with working("the report"):
        summary = report.write()
    for line in filter(None, (report.headline(), report.pace())):
        console.print(line)
    if table := report.overview():
        show_table(table)
    cells = summary.get("cells", ())
    if lost := [cell["lost_wall_s"] for cell in cells if cell.get("lost_wall_s")]:
        console.print(
            f"warning: the machine did not keep up: {sum(lost):.3f} s of wall time lost "
            f"in {len(lost)} of {len(cells)} cells"
        )
    for path in sorted((run.path / "figures").glob("*.png")):
        console.print(str(path))
    console.print(f"report: {run.path / 'report.html'}")


def evaluate_agent(request: RunRequest, against: Path | None, films: bool) -> None:
    """Evaluate an agent, film, and compare it with another evaluation of the same lanes. Raises UserError."""
    from uavaccel.suites.evaluate import against as compared
    from uavaccel.suites.registry import open_run

    other = None if against is None else open_run(against)

    def check(plan: Plan) -> None:
        if other is not None:
            theirs = {row["lane"] for row in other.rows() if row.get("suite") == plan.suite.name}
            if not theirs & {case.lane for case in plan.cases}:  # type: ignore[attr-defined]
                raise UserError(f"--against {other.path}: is no evaluation of the same lanes")

    run = run_experiment(request, check, film_extremes if films else None)
    if run is not None and other is not None:
        console.print(compared(run, other))


def film_extremes(run: RunDirectory) -> None:
    """Write films and contact sheets of the best game and the worst, which the report shows, where there is OpenGL."""
    from uavaccel.cli.results import film_of_game, write_film
    from uavaccel.envs.simulators import EXACT
    from uavaccel.sim.camera.gl import describe_renderer
    from uavaccel.suites.evaluate import Evaluation

    try:
        describe_renderer()
    except UserError as error:
        console.print(f"without films: {error}")
        return
    order = sorted(run.rows(), key=Evaluation().interest)
    if run.config().get("simulator", EXACT) != EXACT:
        console.print("films: both games once more in the exact simulator, where they may end otherwise")
    for name, row in {"best": order[0], "worst": order[-1]}.items():
        with working(f"{name} game, flown again"):
            _, film = film_of_game(run, row["case"])
        write_film(film, run.file(f"films/{name}.mp4"), run.file(f"films/{name}.png"))


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
