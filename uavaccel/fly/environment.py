"""The environment of a script: AirSim's client, other clocks, and stand-ins for what a modern, headless Python lacks.

Scripts of AirSim's time expect old names of NumPy, windows, keys and gym 0.21. A module is changed when the script, or
one of its libraries, imports it. Processes that a script starts find the same: programs by a `sitecustomize` in a
folder on PYTHONPATH, forked processes have it already. In `wall` they share the flight's server; they cannot share a
simulated clock.
"""

from __future__ import annotations

import atexit
import builtins
import contextlib
import functools
import importlib.util
import os
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from math import inf
from pathlib import Path
from types import FrameType, ModuleType, TracebackType
from typing import TYPE_CHECKING

from uavaccel.clock import counted_time_module
from uavaccel.errors import UserError
from uavaccel.fly.keys import KEY_S, LIBRARIES, NAMED, Keyboard, key_modules
from uavaccel.fly.modules import ModuleFinder, Modules, Patches, client_modules, importing, named_module
from uavaccel.fly.options import ANSWERS, FlightOptions
from uavaccel.fly.script import hide_frames_everywhere
from uavaccel.processes.lifetime import end_with_parent

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import ArrayLike, DTypeLike, NDArray

    from uavaccel.airsim.connection import Connect, SocketConnection

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
            from uavaccel.fly.environment import enter
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
OLD_NAMES = {  # NumPy's names that 1.24 and 2.0 removed, and what they mean: Python's types, or NumPy's present names
    "bool": bool,
    "complex": complex,
    "float": float,
    "int": int,
    "object": object,
    "str": str,
    "bool8": "bool_",
    "complex_": "complex128",
    "float_": "float64",
    "unicode_": "str_",
    "string_": "bytes_",
    "Inf": "inf",
    "NaN": "nan",
    "infty": "inf",
    "PINF": "inf",
    "product": "prod",
    "cumproduct": "cumprod",
    "sometrue": "any",
    "alltrue": "all",
    "in1d": "isin",
}
GYM = ("gym", *(f"gym.{part}" for part in ("core", "envs", "error", "logger", "spaces", "utils")), "shimmy")
GYM += ("gym.envs.registration", "gym.utils.seeding")
NO_KEY = -1  # of cv2.waitKey
WINDOWS: tuple[str, ...] = ("destroyAllWindows", "destroyWindow", "imshow", "moveWindow", "namedWindow", "resizeWindow")
WINDOWS += ("setMouseCallback", "setWindowProperty", "setWindowTitle", "startWindowThread")


@contextmanager
def script_environment(
    connect: Connect,
    in_scripts: Mapping[str, ModuleType],
    options: FlightOptions,
    port: int | None,
    forked: Callable[[], None],
) -> Iterator[tuple[Patches, ModuleFinder]]:
    """Let the script in the `with` block find our client, which connects by `connect`, and everything that it lacks.

    Its own files import the modules `in_scripts`, `time` among them. Its child processes find the same, and use the
    server on `port`; a forked process first calls `forked`. Yields the patches, which are undone at the end of the
    block, and the finder of the client's modules.
    """
    clock, threads = in_scripts["time"], in_scripts.get("threading", threading)
    wait, now_s = (getattr(clock, name) for name in ("sleep", "monotonic"))
    keyboard = Keyboard(wait, now_s, options.keys, threads.Thread)
    answer = answering(None if options.scratch is None else options.scratch / ANSWERS)
    with (
        supplied(connect, keyboard, answer, in_scripts) as environment,
        client_for_children(options.scratch, port),
        forked_children(forked),
    ):
        yield environment


@contextmanager
def supplied(
    connect: Connect, keyboard: Keyboard, answer: Callable[[object], str], in_scripts: Mapping[str, ModuleType]
) -> Iterator[tuple[Patches, ModuleFinder]]:
    """Let this process find our client and all that a script lacks, in the `with` block; `answer` replaces `input`."""
    with ExitStack() as stack:
        patches = stack.enter_context(Patches())
        patches.set(builtins, "input", answer)
        _supply_old_interfaces(patches, keyboard)
        hide_frames_everywhere(patches)
        patches.when_imported("uavaccel.airsim.connection", lambda module: patches.set(module, "_connect", connect))
        exported = {**sys.modules, **in_scripts}
        for name in ("math", "os", "sys", "time"):  # AirSim's client exports the modules that it imports
            patches.when_imported(
                "uavaccel.airsim",
                lambda module, name=name: patches.set(module, name, exported[name]),  # type: ignore[misc]
            )
        finder = stack.enter_context(importing(client_modules() | old_modules(), in_scripts))
        stack.enter_context(key_modules(keyboard))
        yield patches, finder


def _supply_old_interfaces(patches: Patches, keyboard: Keyboard) -> None:
    """Supply what old scripts expect; a window's keys are those of `keyboard`, and figures are shown nowhere."""

    def supply_plots(pyplot: ModuleType) -> None:
        switch_backend: Callable[[str], None] = pyplot.switch_backend
        patches.set(pyplot, "pause", keyboard.pass_time)
        patches.set(pyplot, "show", _nothing)
        patches.set(pyplot, "switch_backend", lambda newbackend: switch_backend("agg"))

    def no_key(message: str = "") -> str:
        """Replaces `airsim.wait_key`: answers as if Enter were pressed."""
        if message:
            print(message)
        return "\n"

    os.environ["MPLBACKEND"] = "Agg"
    patches.when_imported("numpy", lambda module: supply_numpy(patches, module))
    patches.when_imported("cv2", lambda module: supply_windows(patches, module, keyboard))
    patches.when_imported("matplotlib", lambda module: patches.set(module, "use", _nothing))
    patches.when_imported("matplotlib.pyplot", supply_plots)
    for name in ("uavaccel.airsim", "uavaccel.airsim.utils"):
        patches.when_imported(name, lambda module: patches.set(module, "wait_key", no_key))


def _nothing(*arguments: object, **options: object) -> None:
    """Replaces what would open a window, or choose how."""


def supply_numpy(patches: Patches, numpy: ModuleType) -> None:
    """Supply NumPy's old names, and `fromstring` for bytes."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        missing = {name: now for name, now in OLD_NAMES.items() if not hasattr(numpy, name)}
        if not hasattr(numpy, "NINF"):
            patches.set(numpy, "NINF", -numpy.inf)
    for name, now in missing.items():
        patches.set(numpy, name, getattr(numpy, now) if isinstance(now, str) else now)
    original: Callable[..., NDArray[np.generic]] = numpy.fromstring

    @functools.wraps(original)
    def fromstring(
        string: str | bytes, dtype: DTypeLike = float, count: int = -1, sep: str = "", **options: object
    ) -> NDArray[np.generic]:
        if sep:
            return original(string, dtype, count, sep=sep, **options)
        data = string.encode("latin1") if isinstance(string, str) else string
        copied: NDArray[np.generic] = numpy.frombuffer(data, dtype, count).copy()
        return copied

    patches.set(numpy, "fromstring", fromstring)


def supply_windows(patches: Patches, cv2: ModuleType, keyboard: Keyboard) -> None:
    """Replace OpenCV's windows by ones that are shown nowhere."""

    def wait_key(delay: int = 0) -> int:
        """Wait for a key: for `delay` ms, or, if that is 0, for ever where one comes."""
        key = keyboard.next(delay / 1000 if delay > 0 else KEY_S if not keyboard.keys else inf)
        if key is None:
            return NO_KEY
        return NAMED.get(key) or ord(key)

    sliders: dict[tuple[str, str], int] = {}  # the position of each trackbar, by its name and its window's

    def create_trackbar(
        name: str, window: str, value: int | None, count: int, onChange: object = None, **options: object
    ) -> None:
        sliders[name, window] = min(max(value or 0, 0), count)

    def set_trackbar(name: str, window: str, position: int) -> None:
        sliders[name, window] = position

    supplied = {
        **dict.fromkeys(WINDOWS, _nothing),
        "waitKey": wait_key,
        "waitKeyEx": wait_key,
        "pollKey": lambda: wait_key(1),
        "createTrackbar": create_trackbar,
        "setTrackbarPos": set_trackbar,
        "getTrackbarPos": lambda name, window: sliders.get((name, window), -1),
        "getWindowProperty": lambda window, property: 1.0,  # it is there, and visible
        "selectROI": lambda *arguments, **options: (0, 0, 0, 0),  # cancelled
    }
    for name, replacement in supplied.items():
        patches.set(cv2, name, replacement)


def old_modules() -> Modules:
    """scipy.misc, whose image functions SciPy 1.2 removed; gym 0.21 and its adapter where no gym is installed."""
    found: Modules = {"scipy.misc": lambda: named_module("scipy.misc", imsave=_save_image, imread=_read_image)}
    if importlib.util.find_spec("gym") is None:
        gym = functools.partial(importlib.import_module, "uavaccel.fly.old_gym")
        found |= {name: lambda name=name: gym().modules()[name] for name in GYM}  # type: ignore[misc]
    return found


def _read_image(name: str) -> NDArray[np.generic]:
    """Return the pixels of an image file, red first. Raises FileNotFoundError if there is no image."""
    import numpy as np
    from PIL import Image, UnidentifiedImageError

    try:
        return np.asarray(Image.open(name).convert("RGB"))
    except UnidentifiedImageError:
        raise FileNotFoundError(f"no image in {name}") from None


def _save_image(name: str, image: ArrayLike) -> None:
    """Write an image, red first; one that is not of bytes is scaled to 0 to 255."""
    import numpy as np
    from PIL import Image

    pixels = np.asarray(image)
    if pixels.dtype != np.uint8:
        low, high = float(pixels.min()), float(pixels.max())
        pixels = ((pixels - low) * (255 / ((high - low) or 1.0))).astype(np.uint8)
    Image.fromarray(pixels).save(name)


def answering(kept: Path | None = None) -> Callable[[object], str]:
    """Return what replaces `input`: it reads lines of standard input, if that is no terminal; without one, Enter.

    The lines are kept in a file, unless it exists already, for flights that are compared with this one.
    """
    keeps = kept is not None and not kept.exists()

    def answer(prompt: object = "") -> str:
        line = "" if sys.stdin is None or sys.stdin.isatty() else sys.stdin.readline()
        if keeps and kept is not None:
            with kept.open("a", encoding="utf-8") as file:
                file.write(line)
        line = line.removesuffix("\n")
        print(f"{prompt}{line}")
        return line

    return answer


# --- processes that a script starts ---------------------------------------------------------------------------------


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
    names = {name.partition(".")[0] for name in client_modules()} | {*LIBRARIES, "cv2", "gym", "matplotlib"}
    text = _MODULE.format(root=str(Path(__file__).parents[2]), folder=str(folder), names=names)
    (folder / "sitecustomize.py").write_text(text, encoding="utf-8")
    path = os.environ.get("PYTHONPATH")
    os.environ |= {"PYTHONPATH": os.pathsep.join(filter(None, [str(folder), path])), PORT: str(port or "")}
    try:
        yield
    finally:
        del os.environ[PORT], os.environ["PYTHONPATH"]
        if path is not None:
            os.environ["PYTHONPATH"] = path


def enter() -> None:
    """In such a program, which imports what a script may lack, supply it."""
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
