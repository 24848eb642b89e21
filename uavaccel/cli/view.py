"""`uavaccel view`: writes a game of a run, or of a policy, as a film and a contact sheet, or as events."""

from __future__ import annotations

import re
from pathlib import Path

from uavaccel.cli.progress import working
from uavaccel.cli.terminal import console
from uavaccel.config import validate
from uavaccel.draw.film import Film, write_contact_sheet, write_video
from uavaccel.errors import UserError
from uavaccel.files import inside
from uavaccel.rl.agents import DEFAULT, policy_folder
from uavaccel.rl.policy import MANIFEST
from uavaccel.sim.camera.gl import describe_renderer
from uavaccel.sim.camera.view import HEIGHT, WIDTH
from uavaccel.suites.evaluation.config import EvaluateConfig, completed
from uavaccel.suites.evaluation.film import best_first, film_lane, lane_events
from uavaccel.suites.evaluation.flights import lane_case
from uavaccel.suites.experiment import resolve
from uavaccel.suites.registry import open_run, suite_of
from uavaccel.suites.suite import choose_row
from uavaccel.vision.event_files import check_format, write_events


def view_game(source: str, case: str | None, out: Path | None) -> None:
    """Write CASE.mp4 and CASE.png into `out`, by default the folder view/ of the run, and print their paths.

    `source` is a run directory that keeps images or can fly its games again, or a policy: "default", its folder, a
    training's run directory. Without `case`: the run's most interesting game, a policy's first evaluation lane.
    Raises UserError if there is no such game.
    """
    describe_renderer()  # where nothing can draw, this says so
    if (policy_folder(source) / MANIFEST).is_file():
        folder = Path("runs") if source == DEFAULT else Path(source)
        with working("the game", console):
            name, film = _fly_policy(source, case or lane_case(0))
    else:
        run = open_run(source)
        with working("the game", console):
            folder, (name, film) = run.path, suite_of(run).film(run, case)
    movie, sheet = (
        inside(out, f"{name}.{kind}") if out else inside(folder, f"view/{name}.{kind}") for kind in ("mp4", "png")
    )
    console.print(str(film_with_bar(film, movie)))
    console.print(str(write_contact_sheet(film, sheet)))


def film_with_bar(film: Film, path: Path) -> Path:
    """Write a film as `write_video` does, with a bar of its frames on a terminal."""
    with working(path.name, console, len(film)) as written:
        return write_video(film, path, written=written)


def view_events(source: str, case: str | None, events: Path, rate_hz: float) -> None:
    """Write the events of a game, as `view_game` takes it, into the file `events` (.h5 or .npz); print their number.

    Raises UserError for another kind of file, if there is no such game, or if `source` is not flown by a policy.
    """
    check_format(events)
    if (policy_folder(source) / MANIFEST).is_file():
        config, lane = _policy_game(source, case or lane_case(0))
    else:
        run = open_run(source)
        if run.config().get("suite") != "evaluate":
            raise UserError(f"--events: {source} must be a policy or a run of evaluate")
        row = choose_row(run, case, best_first(run.rows()))
        config, lane = validate(EvaluateConfig, run.config(), str(run.path)), int(row["lane"])
    seen = lane_events(config, lane, rate_hz)
    write_events(events, seen, HEIGHT, WIDTH)
    console.print(f"{events}: {len(seen)} events of lane {lane} at {rate_hz:g} frames/s")


def _fly_policy(policy: str, case: str) -> tuple[str, Film]:
    config, lane = _policy_game(policy, case)
    return case, film_lane(config, lane)


def _policy_game(policy: str, case: str) -> tuple[EvaluateConfig, int]:
    lane = re.fullmatch(r"lane-(\d+)", case)
    if not lane:
        raise UserError(f"--case {case}: must be an evaluation lane, as lane-000007")
    mapping = completed({"agent": policy, "task": {"timing": "lockstep"}})
    config = resolve(EvaluateConfig, mapping, "view")
    config.task.wire_lane(int(lane[1]))  # refuses one that there is not
    return config, int(lane[1])
