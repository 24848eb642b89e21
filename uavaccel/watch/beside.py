"""The pages of commands: of `uavaccel watch`, and one beside a command that flies, in a process that this starts.

    python -m uavaccel.watch.beside '{"host": "127.0.0.1", "port": 8080, "socket": PATH, "title": "...", "parent": 1}'

prints one line of JSON, {"port": ...}, when the page can be opened, and {"opened": true} once a browser has opened it.
This module loads the page itself only where it is shown.
"""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from select import select
from typing import IO, TYPE_CHECKING

from uavaccel.errors import UsageError, UserError
from uavaccel.processes.child import Watch, end_within, start_python
from uavaccel.processes.lifetime import end_with_parent, remove_orphaned_files
from uavaccel.watch.server import check_viser, free_port, open_server
from uavaccel.wire.page_protocol import PAGE

if TYPE_CHECKING:
    from uavaccel.watch.replay import Track

LOOPBACK = "127.0.0.1"
PORT = 8080
SCRATCH = "uavaccel-watch-"  # and the id of the process whose folder it is
FIRST_SPECTATOR_S = 30.0  # for so long a flight waits for its first spectator
START_S, END_S = 60.0, 3.0
NICENESS = 5  # the flight goes first
SQUARE = (
    "One square under both commands. Before each command the client thinks for {think:g} ms. "
    "Under **ADSC** the drone flies on meanwhile (vermilion); under **TCSC** the simulation is paused."
)


@dataclass(frozen=True)
class PageAddress:
    """Where the page is; of ports the first that is free from `port` on."""

    host: str = LOOPBACK
    port: int = PORT


@contextmanager
def page_beside(address: PageAddress | None, waits: bool = True) -> Iterator[None]:
    """Show what is flown in the `with` block, in this process and in those it starts; nothing without an address.

    With `waits` the block begins when a browser has opened the page, or after FIRST_SPECTATOR_S. Raises UserError if
    the page cannot be opened.
    """
    if address is None:
        yield
        return
    check_viser()
    free_port(address.host, address.port)
    remove_orphaned_files(Path(tempfile.gettempdir()), re.compile(rf"{SCRATCH}(\d+)-"))

    def tell() -> None:
        if process.poll() != -signal.SIGINT:  # at Ctrl-C, which both receive, it has every reason to end
            print(f"warning: {watch.lost}; the flight goes on, unwatched", flush=True)

    with tempfile.TemporaryDirectory(prefix=f"{SCRATCH}{os.getpid()}-", ignore_cleanup_errors=True) as folder:
        options = {
            "host": address.host,
            "port": address.port,
            "socket": str(Path(folder, "page")),
            "title": f"`uavaccel {shlex.join(sys.argv[1:]).replace('`', '')}`",
            "parent": os.getpid(),
        }
        command = ("-m", "uavaccel.watch.beside", json.dumps(options))
        with start_python(*command, stdout=subprocess.PIPE, own_session=False) as process:
            assert process.stdout is not None
            try:
                if not (line := _line_within(process.stdout, START_S)):
                    raise UserError("--watch: the page could not be opened; see above")
                watch = Watch(process, "the page's process", tell)
                try:
                    wait = (
                        f"the flight begins when it is opened, or in {FIRST_SPECTATOR_S:g} s"
                        if waits
                        else "Ctrl-C ends"
                    )
                    print(f"watch at http://{address.host}:{json.loads(line)['port']}; {wait}", flush=True)
                    if waits:
                        _line_within(process.stdout, FIRST_SPECTATOR_S)
                    os.environ[PAGE] = str(Path(folder, "page"))
                    yield
                finally:
                    watch.end()
            finally:
                os.environ.pop(PAGE, None)
                process.terminate()
                end_within(process, END_S)


def _line_within(stream: IO[bytes], seconds: float) -> bytes:
    return stream.readline() if select([stream], [], [], seconds)[0] else b""


def main() -> None:
    """Open the page that argv[1] says, until the parent ends."""
    options = json.loads(sys.argv[1])
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # it ends at Ctrl-C, which releases a flight that it holds
    folder = Path(options["socket"]).parent  # the parent's, and for this alone
    end_with_parent(options["parent"], lambda: shutil.rmtree(folder, ignore_errors=True))
    os.nice(NICENESS)
    from uavaccel.watch.page import Page
    from uavaccel.watch.sources import Live

    def tell(message: dict[str, object]) -> None:
        with suppress(OSError):  # the parent no longer reads
            print(json.dumps(message), flush=True)

    source = Live(Path(options["socket"]))
    server = open_server(options["host"], options["port"])
    page = Page(server, source, options["title"], lambda: tell({"opened": True}))
    tell({"port": server.get_port()})
    page.run()


def show(
    run: Path | None, case: str | None, game: int | None, square: tuple[float, float, int], host: str, port: int
) -> None:
    """Open the page of a run's game, or of a square, and say where it is; until Ctrl-C.

    `square` are its ClockSpeed, the wall seconds that the client thinks, and the seed of its latencies; the spectator
    chooses other ClockSpeeds. Raises UserError for a run without such a game.
    """
    check_viser()
    from uavaccel.watch.page import Page
    from uavaccel.watch.replay import fly_side_by_side, recorded
    from uavaccel.watch.sources import Replay

    clock_speed, think_s, seed = square

    def fly_at(clock_speed: float) -> Sequence[Track]:
        return fly_side_by_side(clock_speed, think_s, rounds=1, seed=seed)

    if run is not None:
        track = recorded(run, case, game)
        source, title = Replay([track]), track.flight.title
    elif case is not None or game is not None:
        raise UsageError("--case, --game: need a run directory")
    else:
        source, title = Replay(fly_at(clock_speed), fly_at), SQUARE.format(think=1000 * think_s)
    server = open_server(host, port)
    try:
        page = Page(server, source, title, opened=source.begin)  # whoever comes first has missed nothing
        print(f"watch at http://{host}:{server.get_port()}; Ctrl-C ends", flush=True)
        page.run()
    finally:
        server.stop()


if __name__ == "__main__":
    main()
