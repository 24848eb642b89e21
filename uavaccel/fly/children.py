"""Processes that a script starts: in `wall` they share the flight's server; they cannot share a simulated clock.

Programs find AirSim's client through a folder of modules on PYTHONPATH; forked processes have it already.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING

from uavaccel.errors import UserError
from uavaccel.fly.modules import ModuleFinder, client_modules
from uavaccel.fly.patches import Patches
from uavaccel.fly.script import hide_frames_everywhere
from uavaccel.processes.lifetime import end_with_parent

if TYPE_CHECKING:
    from uavaccel.airsim.connection import SocketConnection

PORT = "UAVACCEL_FLY_PORT"  # the server's port for a script's programs; "" without a server
REFUSAL = (
    "a process that the script has started calls the simulation; it cannot share a simulated clock: "
    "fly the script with --timing wall"
)
_FOLDER = "client"
_MODULE = """import importlib.util, sys
if importlib.util.find_spec("uavaccel") is None:
    sys.path.append({root!r})
from uavaccel.fly.children import enter
enter(__name__)
"""

_in_child: list[Callable[[], None]] = []


@contextmanager
def client_for_children(scratch: Path | None, port: int | None) -> Iterator[None]:
    """Let Python programs that the `with` block starts find our client, which connects to the server on `port`.

    Without a port the client refuses to connect. `scratch` is a folder for the modules; without it nothing is changed.
    """
    if scratch is None:
        yield
        return
    folder = scratch / _FOLDER
    folder.mkdir(exist_ok=True)
    for name in {name.partition(".")[0] for name in client_modules()}:
        text = _MODULE.format(root=str(Path(__file__).parents[2]))
        (folder / f"{name}.py").write_text(text, encoding="utf-8")
    before = {name: os.environ.get(name) for name in ("PYTHONPATH", PORT)}
    path = before["PYTHONPATH"]
    os.environ["PYTHONPATH"] = os.pathsep.join([str(folder), *([path] if path else [])])
    os.environ[PORT] = "" if port is None else str(port)
    sys.path.insert(1, str(folder))  # multiprocessing passes it on to processes that it spawns
    try:
        yield
    finally:
        sys.path.remove(str(folder))
        for name, value in before.items():
            os.environ.pop(name)
            if value is not None:
                os.environ[name] = value


def enter(name: str) -> None:
    """In such a program, replace all of AirSim's modules by ours; `name` is the one that is being imported."""
    sys.excepthook = _show
    hide_frames_everywhere(Patches())
    sys.meta_path.insert(0, ModuleFinder(client_modules()))
    from uavaccel.airsim import connection

    connection._connect = _connect
    sys.modules[name] = client_modules()[name]()


def _connect(host: str, port: int, timeout_s: float) -> SocketConnection:
    from uavaccel.airsim.connection import SocketConnection
    from uavaccel.wire.rpc import LOOPBACK

    if not (served := os.environ.get(PORT)):
        raise UserError(REFUSAL)
    return SocketConnection(LOOPBACK, int(served), timeout_s)


def _show(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    if isinstance(error, UserError):
        print(f"uavaccel: error: {error}", file=sys.stderr)
    else:
        sys.__excepthook__(kind, error, trace)


@contextmanager
def forked_children(act: Callable[[], None]) -> Iterator[None]:
    """Let processes that are forked in the `with` block first call `act`, and end with this process."""
    parent = os.getpid()

    def begin() -> None:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        act()
        end_with_parent(parent)

    _in_child.append(begin)
    try:
        yield
    finally:
        _in_child.remove(begin)


def _begin_child() -> None:
    for begin in _in_child:
        begin()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_begin_child)
