"""The environment of a script: AirSim's client, other clocks, and stand-ins for what a modern, headless Python lacks.

Scripts of AirSim's time expect old names of NumPy, windows, keys and gym 0.21. A module is changed when the script, or
one of its libraries, imports it.
"""

from __future__ import annotations

import builtins
import functools
import importlib.util
import os
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

from uavaccel.fly.children import client_for_children, forked_children
from uavaccel.fly.keys import key_modules
from uavaccel.fly.modules import ModuleFinder, Modules, client_modules, importing, named_module
from uavaccel.fly.patches import Patches
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
GYM = ("gym", "gym.envs", "gym.envs.registration", "gym.core", "gym.utils", "gym.spaces", "gym.utils.seeding")
NO_KEY = -1  # of cv2.waitKey
WINDOWS = ("destroyAllWindows", "destroyWindow", "imshow", "moveWindow", "namedWindow", "resizeWindow")


@contextmanager
def script_environment(
    connect: Connect,
    in_scripts: Mapping[str, ModuleType],
    scratch: Path | None,
    port: int | None,
    forked: Callable[[], None],
) -> Iterator[tuple[Patches, ModuleFinder]]:
    """Let the script in the `with` block find our client, which connects by `connect`, and everything that it lacks.

    Its own files import the modules `in_scripts`, `time` among them. Its child processes use the server on `port`,
    through modules in the folder `scratch`; a forked process first calls `forked`. Yields the patches, which are undone
    at the end of the block, and the finder of the client's modules.
    """
    clock = in_scripts["time"]
    sleep, now_s = (getattr(clock, name) for name in ("sleep", "monotonic"))
    with ExitStack() as stack:
        patches = stack.enter_context(Patches())
        _supply_old_interfaces(patches, sleep)
        hide_frames_everywhere(patches)
        patches.when_imported(
            "uavaccel.airsim.connection", lambda module: patches.set(module, "_connect", connect)
        )
        finder = stack.enter_context(importing(client_modules() | old_modules(), in_scripts))
        stack.enter_context(key_modules(sleep, now_s))
        stack.enter_context(client_for_children(scratch, port))
        stack.enter_context(forked_children(forked))
        yield patches, finder


def _supply_old_interfaces(patches: Patches, sleep: Callable[[float], None]) -> None:
    """Supply what old scripts expect; waiting for a key in a window uses `sleep`."""
    os.environ["MPLBACKEND"] = "Agg"
    patches.set(builtins, "input", _no_input)
    patches.when_imported("numpy", lambda module: supply_numpy(patches, module))
    patches.when_imported("cv2", lambda module: supply_windows(patches, module, sleep))
    patches.when_imported(
        "matplotlib.pyplot", lambda module: patches.set(module, "pause", lambda interval: sleep(interval))
    )
    for name in ("uavaccel.airsim", "uavaccel.airsim.utils"):
        patches.when_imported(name, lambda module: patches.set(module, "wait_key", no_key))


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


def supply_windows(patches: Patches, cv2: ModuleType, sleep: Callable[[float], None]) -> None:
    """Replace OpenCV's windows by ones that are shown nowhere; no key is ever pressed."""

    def wait_key(delay: int = 0) -> int:
        sleep(max(delay, 0) / 1000)
        return NO_KEY

    for name in WINDOWS:
        patches.set(cv2, name, lambda *arguments, **options: None)
    for name in ("waitKey", "waitKeyEx"):
        patches.set(cv2, name, wait_key)


def old_modules() -> Modules:
    """scipy.misc, whose image functions SciPy 1.2 removed; gym 0.21 and its adapter where no gym is installed."""
    found: dict[str, Callable[[], ModuleType]] = {
        "scipy.misc": lambda: named_module("scipy.misc", imsave=_save_image, imread=_read_image)
    }
    if importlib.util.find_spec("gym") is None:
        found |= {name: lambda name=name: _gym()[name] for name in (*GYM, "shimmy")}  # type: ignore[misc]
    return found


@functools.cache
def _gym() -> dict[str, ModuleType]:
    from uavaccel.fly import old_gym

    return old_gym.modules()


def _read_image(name: str) -> NDArray[np.generic]:
    """Return the pixels of an image file, red first. Raises FileNotFoundError if there is no image."""
    import cv2

    pixels = cv2.imread(str(name))
    if pixels is None:
        raise FileNotFoundError(f"no image in {name}")
    return pixels[..., ::-1]


def _save_image(name: str, image: ArrayLike) -> None:
    """Write an image, red first; one that is not of bytes is scaled to 0 to 255."""
    import cv2
    import numpy as np

    pixels = np.asarray(image)
    if pixels.dtype != np.uint8:
        low, high = float(pixels.min()), float(pixels.max())
        pixels = ((pixels - low) * (255 / ((high - low) or 1.0))).astype(np.uint8)
    cv2.imwrite(str(name), pixels[..., ::-1] if pixels.ndim == 3 else pixels)


def _no_input(prompt: object = "") -> str:
    """Replaces `input`: answers as if Enter were pressed."""
    print(prompt)
    return ""


def no_key(message: str = "") -> str:
    """Replaces `airsim.wait_key`: answers as if Enter were pressed."""
    if message:
        print(message)
    return "\n"
