"""`uavaccel watch`: flights in the browser."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from uavaccel.cli.checks import check_host
from uavaccel.errors import UsageError
from uavaccel.suites.own_code import told
from uavaccel.watch.page import Page
from uavaccel.watch.server import check_viser, open_server
from uavaccel.watch.square import fly_side_by_side
from uavaccel.watch.track import Track

if TYPE_CHECKING:
    from viser import ViserServer

TITLE = (
    "One square under both commands. Before each command the client thinks for {think:g} ms. "
    "Under **ADSC** the drone flies on meanwhile (vermilion); under **TCSC** the simulation is paused."
)


@dataclass(frozen=True)
class WatchRequest:
    """What was asked for on the command line: a game of `run`, or the square at `clock_speed`."""

    run: Path | None
    case: str | None
    game: int | None
    clock_speed: float
    think_s: float
    seed: int
    host: str
    port: int
    trust: bool = False


def watch(request: WatchRequest) -> None:
    """Open the page and say where; until Ctrl-C. Raises UserError for a run without such a game."""
    check_viser()
    check_host(request.host)
    show = _of_run(request) if request.run is not None else _of_square(request)
    server = open_server(request.host, request.port)
    try:
        page = show(server)
        print(f"watch at http://{request.host}:{server.get_port()}; Ctrl-C ends", flush=True)
        page.run()
    finally:
        server.stop()


def _of_run(request: WatchRequest) -> Callable[[ViserServer], Page]:
    """The page of a finished flight."""
    from uavaccel.watch.replay import recorded  # loads what learns

    assert request.run is not None
    with told(request.trust):
        replay = recorded(request.run, request.case, request.game)
    return lambda server: Page(server, [replay.track], replay.scene, replay.title, replay.lane)


def _of_square(request: WatchRequest) -> Callable[[ViserServer], Page]:
    """The page of a square that is flown now, and again at every ClockSpeed that the spectator chooses."""
    if request.case is not None or request.game is not None:
        raise UsageError("--case, --game: need a run directory")

    def fly_at(clock_speed: float) -> list[Track]:
        return fly_side_by_side(clock_speed, request.think_s, rounds=1, seed=request.seed)

    tracks, title = fly_at(request.clock_speed), TITLE.format(think=1000 * request.think_s)
    return lambda server: Page(server, tracks, "blocks", title, fly_at=fly_at)
