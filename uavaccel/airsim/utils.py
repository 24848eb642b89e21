"""AirSim's helpers for scripts. Source of names and conventions: AirSim v1.8.1, PythonClient/airsim/utils.py."""

from __future__ import annotations

import inspect
import logging
import math
import os
import sys
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uavaccel.airsim.pfm import read_pfm, write_pfm
from uavaccel.airsim.types import ImageResponse, Quaternionr

__all__ = [
    "get_pfm_array",
    "get_public_fields",
    "list_to_2d_float_array",
    "read_pfm",
    "string_to_float_array",
    "string_to_uint8_array",
    "to_dict",
    "to_eularian_angles",
    "to_quaternion",
    "to_str",
    "wait_key",
    "write_file",
    "write_pfm",
    "write_png",
]


def string_to_uint8_array(bstr: bytes) -> NDArray[np.uint8]:
    """The bytes as numbers, in an array of its own."""
    return np.frombuffer(bstr, np.uint8).copy()


def string_to_float_array(bstr: bytes) -> NDArray[np.float32]:
    """The bytes as single-precision numbers, in an array of its own."""
    return np.frombuffer(bstr, np.float32).copy()


def list_to_2d_float_array(flst: ArrayLike, width: int, height: int) -> NDArray[np.float32]:
    """(height, width) of a row-major list."""
    return np.reshape(np.asarray(flst, np.float32), (height, width))


def get_pfm_array(response: ImageResponse) -> NDArray[np.float32]:
    """The floats of an image, (height, width)."""
    return list_to_2d_float_array(response.image_data_float, response.width, response.height)


def get_public_fields(obj: object) -> list[str]:
    """Names of an object's attributes that are neither private nor functions."""
    return [
        name
        for name, value in inspect.getmembers(obj)
        if not name.startswith("_") and not inspect.isroutine(value)
    ]


def to_dict(obj: object) -> dict[str, object]:
    return {name: getattr(obj, name) for name in get_public_fields(obj)}


def to_str(obj: object) -> str:
    return str(to_dict(obj))


def write_file(filename: str | Path, bstr: bytes) -> None:
    """Write bytes, such as those of a PNG."""
    Path(filename).write_bytes(bstr)


def write_png(filename: str | Path, image: NDArray[np.integer | np.floating]) -> None:
    """Write an array (height, width, channels), blue first."""
    import cv2

    if not cv2.imwrite(str(filename), image):
        logging.error("Writing PNG file %s failed", filename)


def to_eularian_angles(q: Quaternionr) -> tuple[float, float, float]:
    """Pitch, roll and yaw, in this order, in radians."""
    x, y, z, w = q
    roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = math.asin(min(1.0, max(-1.0, 2 * (w * y - z * x))))
    yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return pitch, roll, yaw


def to_quaternion(pitch: float, roll: float, yaw: float) -> Quaternionr:
    """The inverse of `to_eularian_angles`; radians."""
    cos_p, sin_p = math.cos(pitch / 2), math.sin(pitch / 2)
    cos_r, sin_r = math.cos(roll / 2), math.sin(roll / 2)
    cos_y, sin_y = math.cos(yaw / 2), math.sin(yaw / 2)
    return Quaternionr(
        w_val=cos_y * cos_r * cos_p + sin_y * sin_r * sin_p,
        x_val=cos_y * sin_r * cos_p - sin_y * cos_r * sin_p,
        y_val=cos_y * cos_r * sin_p + sin_y * sin_r * cos_p,
        z_val=sin_y * cos_r * cos_p - cos_y * sin_r * sin_p,
    )


def wait_key(message: str = "") -> str | None:
    """Wait for a key on the terminal and return it; without a terminal, the next character of standard input."""
    if message:
        print(message)
    if os.name == "nt" or not sys.stdin.isatty():
        return sys.stdin.read(1) or None
    import termios
    import tty

    terminal = sys.stdin.fileno()
    before = termios.tcgetattr(terminal)
    try:
        tty.setcbreak(terminal)
        return sys.stdin.read(1)
    finally:
        termios.tcsetattr(terminal, termios.TCSADRAIN, before)
