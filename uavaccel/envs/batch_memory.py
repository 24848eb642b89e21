"""Observations of a batch in memory that its processes share."""

from __future__ import annotations

import mmap
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from uavaccel.sim.rendering.slots import anonymous_memory


class Observations:
    """Each lane's present observation and, where one step ends a game and begins another, the ended one's last."""

    def __init__(self, descriptor: int, lanes: int, shape: tuple[int, ...], dtype: str) -> None:
        self.descriptor = descriptor
        self._size = lanes, shape, dtype
        both = np.frombuffer(mmap.mmap(descriptor, _bytes(*self._size)), dtype).reshape(2, lanes, *shape)
        self.present: NDArray[Any] = both[0]
        self.last: NDArray[Any] = both[1]

    @classmethod
    def made(cls, lanes: int, shape: tuple[int, ...], dtype: str) -> Self:
        return cls(anonymous_memory(_bytes(lanes, shape, dtype)), lanes, shape, dtype)

    @classmethod
    def opened(cls, descriptor: int, size: dict[str, Any]) -> Self:
        """Those that another process made; `size` is its `size`."""
        return cls(descriptor, size["lanes"], tuple(size["shape"]), size["dtype"])

    @property
    def size(self) -> dict[str, Any]:
        lanes, shape, dtype = self._size
        return {"lanes": lanes, "shape": list(shape), "dtype": dtype}

    def of(self, lane: int) -> tuple[NDArray[Any], NDArray[Any]]:
        """Present and last observation of a lane."""
        return self.present[lane], self.last[lane]


def _bytes(lanes: int, shape: tuple[int, ...], dtype: str) -> int:
    return 2 * lanes * int(np.prod(shape)) * np.dtype(dtype).itemsize
