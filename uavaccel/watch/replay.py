"""Finished flights as tracks: a game of a run, or what `uavaccel fly --out` has kept."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from uavaccel.draw.labels import clock_label
from uavaccel.errors import UsageError, UserError
from uavaccel.fly.trajectory import FILE_NAME as FLIGHT
from uavaccel.sim.lane.layout import LaneLayout
from uavaccel.suites.flight import Flight
from uavaccel.suites.registry import open_run, suite_of
from uavaccel.suites.suite import choose_row
from uavaccel.units import NS_PER_S
from uavaccel.watch.script_flight import script_track
from uavaccel.watch.track import Track, track_of


@dataclass(frozen=True)
class Replay:
    """A finished flight, where it was flown, and in words what it is."""

    track: Track
    title: str
    scene: str = "blocks"
    lane: LaneLayout | None = None


def recorded(folder: Path, case: str | None = None, game: int | None = None) -> Replay:
    """Return a game of the run in `folder` by its name or its place in rows.jsonl, or the flight of a script in it.

    By default the game is the most interesting. Raises UserError if there is none, or nothing recorded of it.
    """
    if case is not None and game is not None:
        raise UsageError("--case, --game: name the game by one of them")
    if (folder / FLIGHT).is_file():
        if case is not None or game is not None:
            raise UsageError(f"{folder}: is the flight of one script: without --case and --game")
        track, scene = script_track(folder)
        return Replay(track, f"The flight in `{folder}`.", scene)
    if not (folder / "config.yaml").is_file():
        raise UserError(_nothing_in(folder))
    run = open_run(folder)
    suite = suite_of(run)
    report = suite.report(run)
    row = choose_row(suite, report, case, game)
    flight = suite.flight(report, row, pictures=False)
    title = f"Game `{row['case']}` of `{run.path}`: {flight.title}."
    return Replay(track_of_flight(flight), title, flight.scene, flight.lane)


def _nothing_in(folder: Path) -> str:
    flights = sorted(file.parent.name for file in folder.glob(f"*/{FLIGHT}"))
    if flights:
        return f"{folder}: has several flights: name one of them, as in {folder / flights[0]}"
    return (
        f"{folder}: holds neither a run nor a flight: `uavaccel run` and `evaluate` keep runs, `uavaccel fly` keeps "
        "a flight with --out FOLDER"
    )


def track_of_flight(flight: Flight) -> Track:
    """Return the track of a flight, as if the client's clock had run with the simulation's."""
    commands = flight.commands
    arrays = {
        "time_s": flight.time_ns / NS_PER_S,
        "position_m": flight.position_m,
        "orientation_wxyz": flight.orientation_wxyz,
        "command_start_s": commands.start_ns / NS_PER_S,
        "command_end_s": commands.end_ns / NS_PER_S,
    }
    velocities = [(north, east, down) for north, east, down in commands.velocity_m_s.tolist()]
    return track_of(f"flight at {clock_label(flight.clock_speed)}", flight.clock_speed, arrays, velocities)
