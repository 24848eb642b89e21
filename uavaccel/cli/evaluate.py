"""`uavaccel evaluate`: a run of the suite `evaluate`, with films of its best and its worst game, and a comparison."""

from __future__ import annotations

from pathlib import Path

from uavaccel.cli.run import RunRequest, console, run_experiment
from uavaccel.draw.film import write_contact_sheet, write_video
from uavaccel.records import RunDirectory
from uavaccel.suites.evaluation.film import best_first
from uavaccel.suites.evaluation.suite import Evaluation
from uavaccel.suites.evaluation.summary import compare


def evaluate_agent(request: RunRequest, against: Path | None, films: bool) -> None:
    """Evaluate, compare with another evaluation of the same lanes, film. Raises UserError with one clear line."""
    other = None if against is None else RunDirectory(against)
    run = run_experiment(request)
    if run is None:
        return
    if other is not None:
        console.print(compare(run.rows(), other), markup=False)
    if films:
        film_extremes(run)


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
