"""AirSim's helpers for scripts. Source of names and conventions: AirSim v1.8.1, PythonClient/airsim/utils.py."""

from __future__ import annotations

import inspect
import logging
import math
import os
import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uavaccel.airsim.types import ImageResponse, Quaternionr


def read_pfm(file: str | Path) -> tuple[NDArray[np.floating], float]:
    """Read a portable float map: rows in the file's order, (height, width[, 3]), and the scale. Raises ValueError."""
    data = Path(file).read_bytes()
    header = re.match(rb"(PF|Pf)\s+(\d+)\s+(\d+)\s+(\S+)\s", data)
    if header is None:
        raise ValueError(f"{file}: not a PFM file")
    kind, width, height, scale = header.groups()
    floats = np.frombuffer(data, "<f4" if float(scale) < 0 else ">f4", offset=header.end())
    shape = (int(height), int(width), 3) if kind == b"PF" else (int(height), int(width))
    return floats.reshape(shape), abs(float(scale))


def write_pfm(file: str | Path, image: NDArray[np.generic], scale: float = 1) -> None:
    """Write a portable float map of float32 pixels, H x W[ x 1 or 3], in the array's order. Raises ValueError."""
    if image.dtype.name != "float32":
        raise ValueError(f"image must be float32, not {image.dtype.name}")
    colour = image.ndim == 3 and image.shape[2] == 3
    if not colour and image.ndim != 2 and not (image.ndim == 3 and image.shape[2] == 1):
        raise ValueError(f"image must be H x W x 3, H x W x 1 or H x W, not {image.shape}")
    order = image.dtype.byteorder
    little = order == "<" or (order == "=" and sys.byteorder == "little")
    kind = "PF" if colour else "Pf"
    header = f"{kind}\n{image.shape[1]} {image.shape[0]}\n{-scale if little else scale:f}\n"
    Path(file).write_bytes(header.encode() + image.tobytes())


def string_to_uint8_array(bstr: bytes) -> NDArray[np.uint8]:
    """Return the bytes as an array of numbers, which is a copy."""
    return np.frombuffer(bstr, np.uint8).copy()


def string_to_float_array(bstr: bytes) -> NDArray[np.float32]:
    """Return the bytes as an array of single-precision numbers, which is a copy."""
    return np.frombuffer(bstr, np.float32).copy()


def list_to_2d_float_array(flst: ArrayLike, width: int, height: int) -> NDArray[np.float32]:
    """Return the array (height, width) of a row-major list."""
    return np.reshape(np.asarray(flst, np.float32), (height, width))


def get_pfm_array(response: ImageResponse) -> NDArray[np.float32]:
    """Return the array (height, width) of a float image."""
    return list_to_2d_float_array(response.image_data_float, response.width, response.height)


def get_public_fields(obj: object) -> list[str]:
    """Return the names of an object's attributes that are neither private nor functions."""
    return [
        name for name, value in inspect.getmembers(obj) if not name.startswith("_") and not inspect.isroutine(value)
    ]


def to_dict(obj: object) -> dict[str, object]:
    return {name: getattr(obj, name) for name in get_public_fields(obj)}


def to_str(obj: object) -> str:
    return str(to_dict(obj))


def write_file(filename: str | Path, bstr: bytes) -> None:
    """Write bytes, such as those of a PNG."""
    Path(filename).write_bytes(bstr)


def write_png(filename: str | Path, image: NDArray[np.integer | np.floating]) -> None:
    """Write bytes (height, width, channels), blue first, as PNG."""
    from PIL import Image

    try:
        Image.fromarray(image[..., ::-1].copy() if image.ndim == 3 else image).save(filename, "PNG")
    except OSError:
        logging.error("Writing PNG file %s failed", filename)


def to_eularian_angles(q: Quaternionr) -> tuple[float, float, float]:
    """Pitch, roll and yaw, in this order, in radians."""
    x, y, z, w = q
    roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = math.asin(min(1.0, max(-1.0, 2 * (w * y - z * x))))
    yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return pitch, roll, yaw


def to_quaternion(pitch: float, roll: float, yaw: float) -> Quaternionr:
    """Invert `to_eularian_angles`; radians."""
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


if not TYPE_CHECKING:  # as in uavaccel.airsim.types
    __all__ = [name for name, kind in vars().items() if getattr(kind, "__module__", "") == __name__]
