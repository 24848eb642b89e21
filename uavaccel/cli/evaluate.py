"""`uavaccel evaluate`: a run of the suite `evaluate`, with films of its best and its worst game, and a comparison."""

from __future__ import annotations

from pathlib import Path

from uavaccel.cli.run import RunRequest, configure, console, run_experiment
from uavaccel.draw.film import write_contact_sheet, write_video
from uavaccel.errors import UserError
from uavaccel.records import RunDirectory
from uavaccel.sim.gl import describe_renderer
from uavaccel.suites.evaluation.film import best_first
from uavaccel.suites.evaluation.suite import Evaluation
from uavaccel.suites.evaluation.summary import compare
from uavaccel.suites.runner import check_jobs


def evaluate_agent(request: RunRequest, against: Path | None, films: bool) -> None:
    """Evaluate, compare with another evaluation of the same lanes, film. Raises UserError with one clear line."""
    other = None if against is None else RunDirectory(against)
    if not request.dry_run:
        _check_first(request, other, films)
    run = run_experiment(request)
    if run is None:
        return
    if other is not None:
        console.print(compare(run.rows(), other), markup=False)
    if films:
        film_extremes(run)


def _check_first(request: RunRequest, other: RunDirectory | None, films: bool) -> None:
    """Raises UserError for a comparison without a lane in common, and where films are wanted and nothing can draw."""
    suite, config = configure(request)
    check_jobs(suite, config, request.jobs)
    if other is not None:
        theirs = {row["lane"] for row in other.rows() if row.get("suite") == suite.name}
        if not theirs & {case.lane for case in suite.cases(config)}:
            raise UserError(f"--against {other.path}: is no evaluation of the same lanes")
    if films:
        try:
            describe_renderer()
        except UserError as error:
            raise UserError(f"{error}; or add --no-films") from error


def film_extremes(run: RunDirectory) -> None:
    """The best game and the worst as films and contact sheets."""
    order = best_first(run.rows())
    for name, row in {"best": order[0], "worst": order[-1]}.items():
        _, film = Evaluation().film(run, row["case"])
        for path in (
            write_video(film, run.file(f"films/{name}.mp4")),
            write_contact_sheet(film, run.file(f"films/{name}.png")),
        ):
            console.print(str(path), markup=False)
