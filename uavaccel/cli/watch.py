"""`uavaccel watch`: flights in the browser."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from uavaccel.errors import UsageError
from uavaccel.suites.dp1.flights import SCENE
from uavaccel.watch.page import Page
from uavaccel.watch.replay import recorded_track
from uavaccel.watch.server import open_server
from uavaccel.watch.square import fly_side_by_side
from uavaccel.watch.track import Track

TITLE = (
    "One square under both commands. Before each command the client thinks for {think:g} ms. "
    "Under **ADSC** the drone flies on meanwhile (vermilion); under **TCSC** the clock stands."
)


@dataclass(frozen=True)
class WatchRequest:
    """What was asked for on the command line: a game of `run`, or the square at `clock_speed`."""

    run: Path | None
    case: str | None
    clock_speed: float
    think_s: float
    seed: int
    host: str
    port: int


def watch(request: WatchRequest) -> None:
    """Open the page and say where; until Ctrl-C. Raises UserError for a run without such a game."""
    tracks, title = _tracks(request)
    server = open_server(request.host, request.port)
    try:
        fly_at = None if request.run is not None else (lambda speed: _square(request, speed))
        page = Page(server, tracks, SCENE, title, fly_at=fly_at)
        print(f"watch at http://{request.host}:{server.get_port()}; Ctrl-C ends", flush=True)
        page.run()
    finally:
        server.stop()


def _tracks(request: WatchRequest) -> tuple[list[Track], str]:
    """What is to be seen, and in words what it is."""
    if request.run is not None:
        return [recorded_track(request.run, request.case)], f"A game of `{request.run}`, from its samples."
    if request.case is not None:
        raise UsageError("--case needs a run directory")
    return _square(request, request.clock_speed), TITLE.format(think=1000 * request.think_s)


def _square(request: WatchRequest, clock_speed: float) -> list[Track]:
    return fly_side_by_side(clock_speed, request.think_s, rounds=1, seed=request.seed)
