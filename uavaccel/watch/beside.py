"""A page beside a command: its process, which the command starts, and the line that says where it is."""

from __future__ import annotations

import json
import os
import re
import shlex
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from select import select
from typing import IO

from uavaccel.errors import UserError
from uavaccel.processes.child import Process, Watch, end_within, start_python
from uavaccel.processes.cleanup import remove_orphaned_files
from uavaccel.watch.server import check_viser, free_port
from uavaccel.wire.page_protocol import PAGE

LOOPBACK = "127.0.0.1"
PORT = 8080
SCRATCH = "uavaccel-watch-"  # and the id of the process whose folder it is
FIRST_SPECTATOR_S = 30.0  # for so long a flight waits for its first spectator
START_S, END_S = 60.0, 3.0


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
    with tempfile.TemporaryDirectory(prefix=f"{SCRATCH}{os.getpid()}-", ignore_cleanup_errors=True) as folder:
        socket = Path(folder, "page")
        options = {
            "host": address.host,
            "port": address.port,
            "socket": str(socket),
            "title": f"`uavaccel {shlex.join(sys.argv[1:]).replace('`', '')}`",
            "parent": os.getpid(),
        }
        command = ("-m", "uavaccel.watch.live", json.dumps(options))
        with start_python(*command, stdout=subprocess.PIPE, own_session=False) as process:
            assert process.stdout is not None
            try:
                port = _port_of(process.stdout)
                with _missed(process):
                    _greet(address.host, port, waits)
                    if waits and _within(process.stdout, FIRST_SPECTATOR_S):
                        process.stdout.readline()
                    os.environ[PAGE] = str(socket)
                    yield
            finally:
                os.environ.pop(PAGE, None)
                process.terminate()
                end_within(process, END_S)


@contextmanager
def _missed(process: Process) -> Iterator[None]:
    """Say so where the page's process goes before the flight does, except at Ctrl-C, which both receive."""

    def tell() -> None:
        if process.poll() != -signal.SIGINT:
            print(f"warning: {watch.lost}; the flight goes on, unwatched", flush=True)

    watch = Watch(process, "the page's process", tell)
    try:
        yield
    finally:
        watch.end()


def _within(stream: IO[bytes], seconds: float) -> bool:
    return bool(select([stream], [], [], seconds)[0])


def _port_of(stream: IO[bytes]) -> int:
    line = stream.readline() if _within(stream, START_S) else b""
    if not line:
        raise UserError("--watch: the page could not be opened; see above")
    return int(json.loads(line)["port"])


def _greet(host: str, port: int, waits: bool) -> None:
    begins = f"the flight begins when it is opened, or in {FIRST_SPECTATOR_S:g} s" if waits else "Ctrl-C ends"
    print(f"watch at http://{host}:{port}; {begins}", flush=True)
