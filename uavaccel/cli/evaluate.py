"""`uavaccel evaluate`: runs the suite `evaluate`, compares it with another run, and films its best and worst game."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from uavaccel.cli.progress import working
from uavaccel.cli.run import RunRequest, configure, run_experiment
from uavaccel.cli.terminal import console
from uavaccel.config import parse_override
from uavaccel.errors import UsageError, UserError
from uavaccel.records import RunDirectory
from uavaccel.suites.grid import parse_sweep
from uavaccel.suites.registry import open_run
from uavaccel.suites.runner import check_jobs


def evaluate_agent(request: RunRequest, against: Path | None, films: bool) -> None:
    """Evaluate an agent, compare it with another evaluation of the same lanes, and film. Raises UserError."""
    other = None if against is None else open_run(against)
    if not request.dry_run:
        _check_first(request, other, films)
    run = run_experiment(request, film_extremes if films else None)
    if run is not None and other is not None:
        from uavaccel.suites.evaluate import against as compared

        console.print(compared(run, other))


def sweep_agent(request: RunRequest, sweep: Sequence[str], against: Path | None) -> None:
    """Evaluate an agent under one changed condition after another. Raises UserError."""
    if against is not None:
        raise UsageError(
            "--against: compares two evaluations; a sweep compares each condition with the training's"
        )
    parsed = [parse_sweep(text) for text in sweep]
    if len({name for name, _ in parsed}) < len(parsed):
        raise UsageError("--sweep: names a condition twice; give all its values at once, as in wind=0,3,6")
    of_sweep = {name: request.options.get(name) for name in ("agent", "games", "seed")}
    of_task = {
        f"task.{name}": value
        for name, value in request.options.items()
        if name not in of_sweep and value is not None
    }
    options = {
        **of_sweep,
        "sweep": dict(parsed),
        "evaluation": {
            "experiment": "evaluate",
            "keys": {**of_task, **dict(map(parse_override, request.overrides))},
        },
    }
    run_experiment(replace(request, experiment="sweep", options=options, overrides=(), suite=None))


def _check_first(request: RunRequest, other: RunDirectory | None, films: bool) -> None:
    """Raise UserError for a comparison without a common lane, and for films where nothing can draw."""
    suite, config = configure(request)
    check_jobs(suite, config, request.jobs, request.engine)
    if other is not None:
        theirs = {row["lane"] for row in other.rows() if row.get("suite") == suite.name}
        if not theirs & {case.lane for case in suite.cases(config)}:
            raise UserError(f"--against {other.path}: is no evaluation of the same lanes")
    if films:
        from uavaccel.sim.camera.gl import describe_renderer

        try:
            describe_renderer()
        except UserError as error:
            raise UserError(f"{error}; or add --no-films") from error


def film_extremes(run: RunDirectory) -> None:
    """Write films and contact sheets of the best game and the worst."""
    from uavaccel.cli.view import film_of_game, write_film
    from uavaccel.envs.simulators import EXACT
    from uavaccel.suites.evaluate import Evaluation

    order = sorted(run.rows(), key=Evaluation().interest)
    if run.config().get("simulator", EXACT) != EXACT:
        console.print("films: both games once more in the exact simulator, where they may end otherwise")
    for name, row in {"best": order[0], "worst": order[-1]}.items():
        with working(f"{name} game, flown again", console):
            _, film = film_of_game(run, row["case"])
        write_film(film, run.file(f"films/{name}.mp4"), run.file(f"films/{name}.png"))
