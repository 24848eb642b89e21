"""What scripts of AirSim's time need on a modern, headless Python: NumPy's old names, windows, keys, gym 0.21.

What changes a module does so when the script, or a library of its, imports that module.
"""

from __future__ import annotations

import builtins
import functools
import importlib.util
import os
import warnings
from collections.abc import Callable
from types import ModuleType
from typing import TYPE_CHECKING

from uavaccel.fly.modules import Modules, named_module
from uavaccel.fly.patches import Patches

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import ArrayLike, DTypeLike, NDArray

OLD_NAMES = {  # of NumPy, gone since 1.24 and 2.0, and what they mean: of Python, or NumPy's name of today
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


def supply(patches: Patches, sleep: Callable[[float], None]) -> None:
    """Put all of them in place; waiting for a key in a window takes its time by `sleep`."""
    os.environ["MPLBACKEND"] = "Agg"
    patches.set(builtins, "input", _no_input)
    patches.when_imported("numpy", lambda module: supply_numpy(patches, module))
    patches.when_imported("cv2", lambda module: supply_windows(patches, module, sleep))
    patches.when_imported("matplotlib.pyplot", lambda module: supply_pause(patches, module, sleep))
    for name in ("uavaccel.airsim", "uavaccel.airsim.utils"):
        patches.when_imported(name, lambda module: patches.set(module, "wait_key", no_key))


def supply_numpy(patches: Patches, numpy: ModuleType) -> None:
    """NumPy's old names, and `fromstring` of bytes."""
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
    """OpenCV's windows, shown nowhere; no key is ever pressed."""

    def wait_key(delay: int = 0) -> int:
        sleep(max(delay, 0) / 1000)
        return NO_KEY

    for name in WINDOWS:
        patches.set(cv2, name, lambda *arguments, **options: None)
    for name in ("waitKey", "waitKeyEx"):
        patches.set(cv2, name, wait_key)


def supply_pause(patches: Patches, pyplot: ModuleType, sleep: Callable[[float], None]) -> None:
    """Matplotlib's pause between two pictures, shown nowhere."""
    patches.set(pyplot, "pause", lambda interval: sleep(interval))


def old_modules() -> Modules:
    """scipy.misc, whose images went in SciPy 1.2; gym 0.21 and its adapter where no gym is installed."""
    found: dict[str, Callable[[], ModuleType]] = {
        "scipy.misc": lambda: named_module("scipy.misc", imsave=_save_image, imread=_read_image)
    }
    if importlib.util.find_spec("gym") is None:
        found |= {name: lambda name=name: _of_gym(name) for name in (*GYM, "shimmy")}  # type: ignore[misc]
    return found


@functools.cache
def _gym() -> dict[str, ModuleType]:
    from uavaccel.fly import old_gym

    return old_gym.modules()


def _of_gym(name: str) -> ModuleType:
    return _gym()[name]


def _read_image(name: str) -> NDArray[np.generic]:
    """Red first. Raises FileNotFoundError where there is no image."""
    import cv2

    pixels = cv2.imread(str(name))
    if pixels is None:
        raise FileNotFoundError(f"no image in {name}")
    return pixels[..., ::-1]


def _save_image(name: str, image: ArrayLike) -> None:
    """Stretched to 0 to 255 where it is not of bytes, red first."""
    import cv2
    import numpy as np

    pixels = np.asarray(image)
    if pixels.dtype != np.uint8:
        low, high = float(pixels.min()), float(pixels.max())
        pixels = ((pixels - low) * (255 / ((high - low) or 1.0))).astype(np.uint8)
    cv2.imwrite(str(name), pixels[..., ::-1] if pixels.ndim == 3 else pixels)


def _no_input(prompt: object = "") -> str:
    """As if Enter were pressed."""
    print(prompt)
    return ""


def no_key(message: str = "") -> str:
    """As if Enter were pressed."""
    if message:
        print(message)
    return "\n"
