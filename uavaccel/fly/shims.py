"""The environment of a script: AirSim's client, other clocks, and stand-ins for what a modern, headless Python lacks.

Scripts of AirSim's time expect old names of NumPy, windows, keys and gym 0.21. A module is changed when the script, or
one of its libraries, imports it.
"""

from __future__ import annotations

import builtins
import functools
import importlib.util
import os
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from math import inf
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

from uavaccel.fly.children import client_for_children, forked_children
from uavaccel.fly.keyboard import KEY_S, NAMED, Keyboard
from uavaccel.fly.keys import key_modules
from uavaccel.fly.modules import ModuleFinder, Modules, Patches, client_modules, importing, named_module
from uavaccel.fly.options import ANSWERS, FlightOptions
from uavaccel.fly.script import hide_frames_everywhere

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import ArrayLike, DTypeLike, NDArray

    from uavaccel.airsim.connection import Connect

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
WINDOWS = ("destroyAllWindows", "destroyWindow", "imshow", "moveWindow", "namedWindow", "resizeWindow")


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
    """Supply what old scripts expect; a window's keys are those of `keyboard`."""
    os.environ["MPLBACKEND"] = "Agg"
    patches.when_imported("numpy", lambda module: supply_numpy(patches, module))
    patches.when_imported("cv2", lambda module: supply_windows(patches, module, keyboard))
    patches.when_imported("matplotlib", lambda module: patches.set(module, "use", _nothing))
    patches.when_imported("matplotlib.pyplot", lambda module: supply_plots(patches, module, keyboard))
    for name in ("uavaccel.airsim", "uavaccel.airsim.utils"):
        patches.when_imported(name, lambda module: patches.set(module, "wait_key", no_key))


def supply_plots(patches: Patches, pyplot: ModuleType, keyboard: Keyboard) -> None:
    """Let figures be shown nowhere."""
    patches.set(pyplot, "pause", lambda interval: keyboard.pass_time(interval))
    patches.set(pyplot, "show", _nothing)
    switch_backend: Callable[[str], None] = pyplot.switch_backend
    patches.set(pyplot, "switch_backend", lambda newbackend: switch_backend("agg"))


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

    for name in WINDOWS:
        patches.set(cv2, name, _nothing)
    for name, wait in (("waitKey", wait_key), ("waitKeyEx", wait_key), ("pollKey", lambda: wait_key(1))):
        patches.set(cv2, name, wait)


def old_modules() -> Modules:
    """scipy.misc, whose image functions SciPy 1.2 removed; gym 0.21 and its adapter where no gym is installed."""
    found: Modules = {"scipy.misc": lambda: named_module("scipy.misc", imsave=_save_image, imread=_read_image)}
    if importlib.util.find_spec("gym") is None:
        found |= {name: functools.partial(_gym, name) for name in GYM}
    return found


def _gym(name: str) -> ModuleType:
    from uavaccel.fly import old_gym

    return old_gym.modules()[name]


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


def no_key(message: str = "") -> str:
    """Replaces `airsim.wait_key`: answers as if Enter were pressed."""
    if message:
        print(message)
    return "\n"
