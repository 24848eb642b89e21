"""`uavaccel view`: writes a game of a run, or of a policy, as a film and a contact sheet."""

from __future__ import annotations

import re
from pathlib import Path

from uavaccel.cli.terminal import console, working
from uavaccel.config import validate
from uavaccel.draw.film import Film, write_contact_sheet, write_video
from uavaccel.errors import UserError
from uavaccel.files import inside
from uavaccel.records import RunDirectory
from uavaccel.rl.agents import DEFAULT, policy_folder
from uavaccel.rl.policy import MANIFEST
from uavaccel.sim.camera.gl import describe_renderer
from uavaccel.suites.flight import film_of
from uavaccel.suites.registry import open_run, suite_of
from uavaccel.suites.suite import choose_row


def view_game(source: str, case: str | None, out: Path | None) -> None:
    """Write CASE.mp4 and CASE.png into `out`, by default the folder view/ of the run, and print their paths.

    `source` is a run directory that keeps images or can fly its games again, or a policy: "default", its folder, a
    training's run directory. Without `case`: the run's most interesting game, a policy's first evaluation lane.
    Raises UserError if there is no such game.
    """
    describe_renderer()  # where nothing can draw, this says so
    folder = Path("runs") if source == DEFAULT else Path(source)
    with working("the game", console):
        if (policy_folder(source) / MANIFEST).is_file():
            name, film = _film_of_policy(source, case or "lane-000000")
        else:
            name, film = film_of_game(open_run(source), case)
    movie, sheet = (
        inside(out, f"{name}.{kind}") if out else inside(folder, f"view/{name}.{kind}") for kind in ("mp4", "png")
    )
    write_film(film, movie, sheet)


def film_of_game(run: RunDirectory, case: str | None) -> tuple[str, Film]:
    """Return a game's name and film, by default of the most interesting. Raises UserError where there are no images."""
    suite = suite_of(run)
    report = suite.report(run)
    row = choose_row(suite, report, case)
    flight = suite.flight(report, row)
    if not len(flight.images):
        raise UserError(f"{run.path}: a run of {suite.name} keeps no images to show")
    return str(row["case"]), film_of(flight)


def _film_of_policy(policy: str, case: str) -> tuple[str, Film]:
    from uavaccel.suites.evaluate import EvaluateConfig, completed
    from uavaccel.suites.evaluate_again import flight_of_agent

    lane = re.fullmatch(r"lane-(\d+)", case)
    if not lane:
        raise UserError(f"--case {case}: must be an evaluation lane, as lane-000007")
    mapping = completed({"agent": policy, "task": {"timing": "lockstep"}})
    config = validate(EvaluateConfig, mapping, "view")
    config.task.wire_lane(int(lane[1]))  # refuses one that there is not
    return case, film_of(flight_of_agent(config, int(lane[1])))


def write_film(film: Film, movie: Path, sheet: Path) -> None:
    """Write a film, with a bar of its frames on a terminal, and its contact sheet, and print their paths."""
    with working(movie.name, console, len(film)) as written:
        console.print(str(write_video(film, movie, written=written)))
    console.print(str(write_contact_sheet(film, sheet)))
