"""What scripts of AirSim's time need on a modern, headless Python: NumPy's old names, windows, keys.

Each is put in place for the process that flies a script, and never taken back.
"""

from __future__ import annotations

import builtins
import functools
import os
import warnings
from collections.abc import Callable
from types import ModuleType
from typing import Any

import cv2
import numpy as np

from uavaccel.airsim import utils
from uavaccel.fly.modules import named_module

OLD_NAMES = {  # of NumPy, gone since 1.24 and 2.0
    "bool": bool,
    "complex": complex,
    "float": float,
    "int": int,
    "object": object,
    "str": str,
    "bool8": np.bool_,
    "complex_": np.complex128,
    "float_": np.float64,
    "unicode_": np.str_,
    "string_": np.bytes_,
    "Inf": np.inf,
    "NaN": np.nan,
    "infty": np.inf,
    "PINF": np.inf,
    "NINF": -np.inf,
    "product": np.prod,
    "cumproduct": np.cumprod,
    "sometrue": np.any,
    "alltrue": np.all,
    "in1d": np.isin,
}
NO_KEY = -1  # of cv2.waitKey
WINDOWS = ("destroyAllWindows", "destroyWindow", "imshow", "moveWindow", "namedWindow", "resizeWindow")


def supply(sleep: Callable[[float], None]) -> None:
    """Put all of them in place; waiting for a key in a window takes its time by `sleep`."""
    os.environ["MPLBACKEND"] = "Agg"
    supply_numpy()
    supply_windows(sleep)
    builtins.input = _no_input
    utils.wait_key = _no_key
    import uavaccel.airsim as airsim

    airsim.wait_key = _no_key


def supply_numpy() -> None:
    """NumPy's old names, and `fromstring` of bytes."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for name, value in OLD_NAMES.items():
            if not hasattr(np, name):
                setattr(np, name, value)
    original = np.fromstring

    @functools.wraps(original)
    def fromstring(string: Any, dtype: Any = float, count: int = -1, sep: str = "", **options: Any) -> Any:
        if sep:
            return original(string, dtype, count, sep=sep, **options)
        data = string.encode("latin1") if isinstance(string, str) else string
        return np.frombuffer(data, dtype, count).copy()

    np.fromstring = fromstring  # type: ignore[assignment]


def supply_windows(sleep: Callable[[float], None]) -> None:
    """OpenCV's windows, shown nowhere; no key is ever pressed."""

    def wait_key(delay: int = 0) -> int:
        sleep(max(delay, 0) / 1000)
        return NO_KEY

    for name in WINDOWS:
        setattr(cv2, name, lambda *arguments, **options: None)
    cv2.waitKey = cv2.waitKeyEx = wait_key


def old_modules() -> dict[str, ModuleType]:
    """scipy.misc, whose images went in SciPy 1.2."""
    return {"scipy.misc": named_module("scipy.misc", imsave=_save_image, imread=_read_image)}


def _read_image(name: str) -> Any:
    """Red first. Raises FileNotFoundError where there is no image."""
    pixels = cv2.imread(str(name))
    if pixels is None:
        raise FileNotFoundError(f"no image in {name}")
    return pixels[..., ::-1]


def _save_image(name: str, image: Any) -> None:
    """Stretched to 0 to 255 where it is not of bytes, red first."""
    pixels = np.asarray(image)
    if pixels.dtype != np.uint8:
        low, high = float(pixels.min()), float(pixels.max())
        pixels = ((pixels - low) * (255 / ((high - low) or 1.0))).astype(np.uint8)
    cv2.imwrite(str(name), pixels[..., ::-1] if pixels.ndim == 3 else pixels)


def _no_input(prompt: object = "") -> str:
    """As if Enter were pressed."""
    print(prompt)
    return ""


def _no_key(message: str = "") -> str:
    """As if Enter were pressed."""
    if message:
        print(message)
    return "\n"
