"""A page of a finished flight, or of a square that is flown now under both commands: `uavaccel watch`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from uavaccel.errors import UsageError
from uavaccel.sim.lane.layout import LaneLayout
from uavaccel.watch.page import Page
from uavaccel.watch.server import check_viser, open_server
from uavaccel.watch.square import fly_side_by_side
from uavaccel.watch.track import Track

SCENE = "blocks"  # of the square
TITLE = (
    "One square under both commands. Before each command the client thinks for {think:g} ms. "
    "Under **ADSC** the drone flies on meanwhile (vermilion); under **TCSC** the simulation is paused."
)


def show(
    run: Path | None, case: str | None, game: int | None, square: tuple[float, float, int], host: str, port: int
) -> None:
    """Open the page of a run's game, or of a square, and say where it is; until Ctrl-C.

    `square` are its ClockSpeed, the wall seconds that the client thinks, and the seed of its latencies; the spectator
    chooses other ClockSpeeds. Raises UserError for a run without such a game.
    """
    shown: tuple[Sequence[Track], str, str, LaneLayout | None, Callable[[float], list[Track]] | None]
    check_viser()
    if run is not None:
        from uavaccel.watch.replay import recorded  # loads what learns

        replay = recorded(run, case, game)
        shown = [replay.track], replay.scene, replay.title, replay.lane, None
    elif case is not None or game is not None:
        raise UsageError("--case, --game: need a run directory")
    else:
        clock_speed, think_s, seed = square

        def fly_at(clock_speed: float) -> list[Track]:
            return fly_side_by_side(clock_speed, think_s, rounds=1, seed=seed)

        shown = fly_at(clock_speed), SCENE, TITLE.format(think=1000 * think_s), None, fly_at
    server = open_server(host, port)
    try:
        page = Page(server, *shown)
        print(f"watch at http://{host}:{server.get_port()}; Ctrl-C ends", flush=True)
        page.run()
    finally:
        server.stop()
