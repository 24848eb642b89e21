"""Portable float maps, as AirSim's scripts write depth images."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray


def read_pfm(file: str | Path) -> tuple[NDArray[np.floating], float]:
    """The rows in the file's order, (height, width) or (height, width, 3), and the scale. Raises ValueError."""
    data = Path(file).read_bytes()
    header = re.match(rb"(PF|Pf)\s+(\d+)\s+(\d+)\s+(\S+)\s", data)
    if header is None:
        raise ValueError(f"{file}: not a PFM file")
    kind, width, height, scale = header.groups()
    floats = np.frombuffer(data, "<f4" if float(scale) < 0 else ">f4", offset=header.end())
    shape = (int(height), int(width), 3) if kind == b"PF" else (int(height), int(width))
    return floats.reshape(shape), abs(float(scale))


def write_pfm(file: str | Path, image: NDArray[np.generic], scale: float = 1) -> None:
    """Write float32 pixels, H x W, H x W x 1 or H x W x 3, in the array's order. Raises ValueError."""
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
