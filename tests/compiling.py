"""What tests compile, kept in numba's cache until a file that could be compiled with it changes."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

from numba import jit

from uavaccel.sim.parts import Part
from uavaccel.sim.vehicle.hotloop import stamped

PACKAGE = Path(__file__).parents[1] / "uavaccel"
FILES = sorted(file for room in ("kernels", "sim", "vision") for file in (PACKAGE / room).rglob("*.py"))
SOURCES = zlib.crc32(b"".join(file.read_bytes() for file in FILES)) | 1


def kept(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """As `numba.njit` with these options."""
    return lambda function: jit(nopython=True, cache=True, **options)(stamped(function, SOURCES))


@cache
def alone(part: Any) -> Any:
    """A part as it is compiled by itself, which its callers otherwise do each time."""
    return jit(cache=True, **part.targetoptions)(stamped(part.py_func, SOURCES))


class Alone:
    """A module whose parts are called from Python."""

    def __init__(self, module: ModuleType) -> None:
        self._module = module

    def __getattr__(self, name: str) -> Any:
        found = getattr(self._module, name)
        return alone(found) if isinstance(found, Part) else found
