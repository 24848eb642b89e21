"""Processes that a script starts: in `wall` they share the flight's server; they cannot share a simulated clock.

Programs find what a script finds by a `sitecustomize` in a folder on PYTHONPATH; forked processes have it already.
"""

from __future__ import annotations

import atexit
import contextlib
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import FrameType, TracebackType
from typing import TYPE_CHECKING

from uavaccel.clock import counted_time_module
from uavaccel.errors import UserError
from uavaccel.fly.keyboard import Keyboard
from uavaccel.fly.keys import LIBRARIES as KEYS
from uavaccel.fly.modules import client_modules
from uavaccel.processes.lifetime import end_with_parent

if TYPE_CHECKING:
    from uavaccel.airsim.connection import SocketConnection

PORT = "UAVACCEL_FLY_PORT"  # the server's port for a script's programs; "" without a server
REFUSAL = (
    "a process that the script has started calls the simulation; it cannot share a simulated clock: "
    "fly the script with --timing wall"
)
FLIGHT = "UAVACCEL_FLY_PROCESS"  # the process of a flight on a simulated clock, which is told of refusals
PATIENT_POLLS, POLL_S = 4, 1.0  # a script that has not moved for so long after a refusal waits for what was refused
_FOLDER = "client"
_MODULE = """import sys
from importlib.machinery import PathFinder
from importlib.util import find_spec, module_from_spec

__name__ = "uavaccel.fly.sitecustomize"  # which is no script's

class Finder:
    @classmethod
    def find_spec(cls, name, path=None, target=None):
        if name not in {names!r} or cls not in sys.meta_path:
            return None
        sys.meta_path.remove(cls)
        if find_spec("uavaccel") is None:
            sys.path.append({root!r})
        try:
            from uavaccel.fly.children import enter
        except Exception:  # another Python, or one without the packages
            return None
        enter()
        found = (finder.find_spec(name, path, target) for finder in list(sys.meta_path))
        return next(filter(None, found), None)

sys.meta_path.insert(0, Finder)
own = PathFinder.find_spec("sitecustomize", [place for place in sys.path if place != {folder!r}])
if own is not None:
    own.loader.exec_module(module_from_spec(own))
"""

_in_child: list[Callable[[], None]] = []
_supplied = ExitStack()  # of a program, until its end


@contextmanager
def client_for_children(scratch: Path | None, port: int | None) -> Iterator[None]:
    """Let Python programs that the `with` block starts find what a script finds; our client uses the server on `port`.

    Without a port the client refuses to connect. `scratch` is a folder for the module that Python imports when it
    starts; without it nothing is changed.
    """
    if scratch is None:
        yield
        return
    folder = scratch / _FOLDER
    folder.mkdir(exist_ok=True)
    names = {name.partition(".")[0] for name in client_modules()} | {*KEYS, "cv2", "gym", "matplotlib"}
    text = _MODULE.format(root=str(Path(__file__).parents[2]), folder=str(folder), names=names)
    (folder / "sitecustomize.py").write_text(text, encoding="utf-8")
    before = {name: os.environ.get(name) for name in ("PYTHONPATH", PORT)}
    path = before["PYTHONPATH"]
    os.environ["PYTHONPATH"] = os.pathsep.join([str(folder), *([path] if path else [])])
    os.environ[PORT] = "" if port is None else str(port)
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name)
            if value is not None:
                os.environ[name] = value


def enter() -> None:
    """In such a program, which imports what a script may lack, supply it."""
    from uavaccel.fly.shims import answering, supplied

    sys.excepthook = _show
    clock = counted_time_module(lambda seconds: None)
    keyboard = Keyboard(*(getattr(clock, name) for name in ("sleep", "monotonic")))
    _supplied.enter_context(supplied(_connect, keyboard, answering(), {}))
    atexit.register(_supplied.close)


def _connect(host: str, port: int, timeout_s: float) -> SocketConnection:
    from uavaccel.airsim.connection import SocketConnection
    from uavaccel.wire.rpc import LOOPBACK

    if not (served := os.environ.get(PORT)):
        raise refusal()
    return SocketConnection(LOOPBACK, int(served), timeout_s)


# --- refusals --------------------------------------------------------------------------------------------------


def refusal() -> UserError:
    """Return the error for a process that cannot share the clock, and tell the flight's process."""
    with contextlib.suppress(KeyError, ValueError, OSError):
        os.kill(int(os.environ[FLIGHT]), signal.SIGUSR2)
    return UserError(REFUSAL)


@contextmanager
def ended_by_refusals(progress: Callable[[], int]) -> Iterator[None]:
    """End the `with` block by a UserError if a process was refused and the script waits for it.

    It waits if for some seconds it has stood at one place of Python's own modules, and has made no `progress`.
    """
    places: list[object] = []

    def poll(number: int, frame: FrameType | None) -> None:
        waits = frame is not None and frame.f_globals.get("__name__", "").partition(".")[0] in sys.stdlib_module_names
        place = frame and (id(frame), frame.f_lasti, progress())
        places[:] = [*(places if place in places else []), place] if waits else []
        if len(places) > PATIENT_POLLS:
            places.clear()
            if (processes := sys.modules.get("multiprocessing")) is not None:
                for child in processes.active_children():
                    child.terminate()
            raise UserError(f"{REFUSAL}; the script waits for it")

    def begin(number: int, frame: FrameType | None) -> None:
        if signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0):
            signal.setitimer(signal.ITIMER_REAL, POLL_S, POLL_S)

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    os.environ[FLIGHT] = str(os.getpid())
    handlers = {signal.SIGUSR2: begin, signal.SIGALRM: poll}
    before = {number: signal.signal(number, handler) for number, handler in handlers.items()}
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        del os.environ[FLIGHT]
        for number, handler in before.items():
            late = number == signal.SIGUSR2 and handler == signal.SIG_DFL  # a pool's next process may still be refused
            signal.signal(number, signal.SIG_IGN if late else handler)


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
