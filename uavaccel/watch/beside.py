"""The pages of commands: of `uavaccel watch`, and one beside a command that flies, in a process that this starts.

    python -m uavaccel.watch.beside '{"host": "127.0.0.1", "port": 8080, "socket": PATH, "title": "...", "parent": 1}'

prints one line of JSON, {"port": ...}, when the page can be opened, and {"opened": true} once a browser has opened it.
This module loads the page itself, and viser, which serves it, only where it is shown.

Every website that the spectator opens could send requests here too. So the server answers those alone that name this
machine (`Host`: a website's own name may lead here), and that a page of its own has made (`Origin`). A browser that no
longer reads is dropped; one that reads slowly gets the latest state instead of all of them.
"""

from __future__ import annotations

import errno
import io
import json
import logging
import os
import re
import shlex
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, redirect_stdout, suppress
from functools import partial
from http import HTTPStatus
from ipaddress import ip_address
from pathlib import Path
from select import select
from threading import Event
from typing import IO, TYPE_CHECKING, Any
from urllib.parse import urlsplit

from uavaccel.errors import UsageError, UserError
from uavaccel.processes.lifetime import Watch, end_with_parent, end_within, remove_orphaned_files, start_python
from uavaccel.wire.broadcast import PAGE

if TYPE_CHECKING:
    from viser import ViserServer
    from websockets import Headers

LOOPBACK = "127.0.0.1"
PORT = 8080
SCRATCH = "uavaccel-watch-"  # and the id of the process whose folder it is
FIRST_SPECTATOR_S = 30.0  # for so long a flight waits for its first spectator
START_S, END_S = 60.0, 3.0
UNREAD_MS = 10_000  # for so long a browser may leave what was sent unread
BRAND = (0, 114, 178)
NICENESS = 5  # the flight goes first
SQUARE = (
    "ADSC and TCSC fly one square. Before each command the client thinks for {think:g} ms. "
    "Under **ADSC** the drone flies on meanwhile; under **TCSC** the simulation is paused."
)


@contextmanager
def page_beside(waits: bool = True, port: int = PORT, host: str = LOOPBACK) -> Iterator[None]:
    """Show what is flown in the `with` block, in this process and in those it starts, at the first free of the ports.

    With `waits` it begins once a browser has opened the page, or after FIRST_SPECTATOR_S. Raises UserError without one.
    """
    free_port(host, port)
    remove_orphaned_files(Path(tempfile.gettempdir()), re.compile(rf"{SCRATCH}(\d+)-"))

    def tell() -> None:
        if process.poll() != -signal.SIGINT:  # at Ctrl-C, which both receive, it has every reason to end
            print(f"warning: {watch.lost}; the flight goes on, unwatched", flush=True)

    prefix, title = f"{SCRATCH}{os.getpid()}-", f"`uavaccel {shlex.join(sys.argv[1:]).replace('`', '')}`"
    with ExitStack() as ends:
        folder = ends.enter_context(tempfile.TemporaryDirectory(prefix=prefix, ignore_cleanup_errors=True))
        path = str(Path(folder, "page"))
        options = {"host": host, "port": port, "socket": path, "title": title, "parent": os.getpid()}
        command = ("-m", "uavaccel.watch.beside", json.dumps(options))
        process = ends.enter_context(start_python(*command, stdout=subprocess.PIPE, own_session=False))
        assert process.stdout is not None
        for end in (lambda: end_within(process, END_S), process.terminate, lambda: os.environ.pop(PAGE, None)):
            ends.callback(end)  # the last first
        if not (line := _line_within(process.stdout, START_S)):
            raise UserError("--watch: the page could not be opened; see above")
        watch = Watch(process, "the page's process", tell)
        ends.callback(watch.end)
        begins = f"the flight begins when it is opened, or in {FIRST_SPECTATOR_S:g} s" if waits else "Ctrl-C ends"
        print(f"watch at http://{host}:{json.loads(line)['port']}; {begins}", flush=True)
        if waits:
            _line_within(process.stdout, FIRST_SPECTATOR_S)
        os.environ[PAGE] = path
        yield


def _line_within(stream: IO[bytes], seconds: float) -> bytes:
    return stream.readline() if select([stream], [], [], seconds)[0] else b""


def main() -> None:
    options = json.loads(sys.argv[1])
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # it ends at Ctrl-C, which releases a flight that it holds
    folder = Path(options["socket"]).parent  # the parent's, and for this alone
    end_with_parent(options["parent"], lambda: shutil.rmtree(folder, ignore_errors=True))
    os.nice(NICENESS)
    from uavaccel.watch.page import Page, head_of
    from uavaccel.watch.sources import Live

    def tell(**message: object) -> None:
        with suppress(OSError):  # the parent no longer reads
            print(json.dumps(message), flush=True)

    source = Live(Path(options["socket"]))
    server = open_server(options["host"], options["port"], head_of(options["title"]))
    told = Event()  # a tab of an earlier page may come back before the port is told
    page = Page(server, source, options["title"], lambda: tell(opened=told.wait()))
    tell(port=server.get_port())
    told.set()
    page.run()


def show(
    run: str | Path | None, case: str | None, game: int | None, square: tuple[float, float, int], host: str, port: int
) -> None:
    """Open the page of a run's game, or of a square, and say where it is; until Ctrl-C.

    `square` are its ClockSpeed, the wall seconds that the client thinks, and the seed of its latencies; the spectator
    chooses other ClockSpeeds. Raises UserError for a run without such a game.
    """
    from uavaccel.watch.page import Page, head_of
    from uavaccel.watch.replay import fly_side_by_side, recorded
    from uavaccel.watch.sources import Replay

    clock_speed, think_s, seed = square
    fly_at = partial(fly_side_by_side, think_s=think_s, rounds=1, seed=seed)
    if run is not None:
        track = recorded(run, case, game)
        source, title = Replay([track]), track.flight.title
    elif case is not None or game is not None:
        raise UsageError("--case, --game: need a run directory")
    else:
        source, title = Replay(fly_at(clock_speed), fly_at), SQUARE.format(think=1000 * think_s)
    server = open_server(host, port, head_of(title))
    try:
        page = Page(server, source, title, opened=source.begin)  # whoever comes first has missed nothing
        with suppress(KeyboardInterrupt):  # it runs until then
            print(f"watch at http://{host}:{server.get_port()}; Ctrl-C ends", flush=True)
            page.run()
    finally:
        server.stop()


def free_port(host: str, port: int) -> int:
    """Return the first free port from `port` on; without one, and for a foreign address, viser would wait for ever.

    Raises UserError where the address is not one of this machine, or all these ports are taken.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    for free in range(port, 1 << 16):
        try:
            socket.create_server((host, free), family=family).close()
            return free
        except OSError as error:
            if error.errno not in (errno.EADDRINUSE, errno.EACCES):
                reason = (error.strerror or str(error)).partition(" (while")[0]
                raise UserError(f"the page cannot be opened at {host}:{port}: {reason}") from None
    raise UserError(f"the page cannot be opened at {host}: no port is free from {port} on")


def open_server(host: str, port: int, head: str) -> ViserServer:
    """Open a page, without a word, at the first free port from `port` on; its HTML has `head` in place of a title.

    Raises UserError as `free_port` does.
    """
    port = free_port(host, port)
    import viser

    with redirect_stdout(io.StringIO()), _guarded(host, head):  # it greets, even where it is asked to be silent
        server = viser.ViserServer(host=host, port=port, label="uavaccel watch", verbose=False)
    server.gui.configure_theme(show_logo=False, show_share_button=False, brand_color=BRAND)
    server.gui.main_panel.dock_right()
    server.gui.set_panel_label("uavaccel watch")
    return server


def is_ours(headers: Headers, host: str) -> bool:
    """Return whether a request may be answered: it names this machine, and no other page has made it.

    This machine has its own names, `host`, and any number, which no website can have.
    """
    named, origins = headers.get_all("Host"), {origin.lower() for origin in headers.get_all("Origin")}
    if len(named) != 1 or not origins <= {f"{scheme}://{named[0].lower()}" for scheme in ("http", "https")}:
        return False
    own = socket.gethostname().lower()
    try:
        name = urlsplit(f"//{named[0]}").hostname or ""
        if name not in {"localhost", host.lower(), own, f"{own}.local"}:
            ip_address(name)
    except ValueError:
        return False
    return True


@contextmanager
def _guarded(host: str, head: str) -> Iterator[None]:
    """Guard the server that viser opens in the `with` block, and give its HTML a head: it has options for neither.

    Raises UserError where viser serves in another way.
    """
    import websockets.asyncio.server as servers

    serve, guards = servers.serve, []
    logging.getLogger("websockets.server").setLevel(logging.CRITICAL)  # what is no request is no traceback here

    def guarded(*arguments: Any, process_request: Any, **options: Any) -> Any:
        def answer(connection: Any, request: Any) -> Any:
            if not is_ours(request.headers, host):
                return connection.respond(HTTPStatus.FORBIDDEN, "Open the page at its own address.\n")
            if (unread := getattr(socket, "TCP_USER_TIMEOUT", None)) is not None:
                connection.transport.get_extra_info("socket").setsockopt(socket.IPPROTO_TCP, unread, UNREAD_MS)
            request.headers.pop("Accept-Encoding", None)  # its HTML is compressed within
            response = process_request(connection, request)
            if response is not None and response.headers.get("Content-Type", "").startswith("text/html"):
                response.body = re.sub(rb"<title>[^<]*</title>", lambda _: head.encode(), response.body, count=1)
                del response.headers["Content-Length"]  # set anew it would be there twice
                response.headers["Content-Length"] = str(len(response.body))
            return response

        guards.append(answer)
        return serve(*arguments, process_request=answer, **options)

    setattr(servers, "serve", guarded)  # noqa: B010  a function, to a type checker a class
    try:
        yield
    finally:
        setattr(servers, "serve", serve)  # noqa: B010
    if not guards:
        raise UserError("watch: this version of viser cannot be guarded against other websites; take an older one")


if __name__ == "__main__":
    main()
