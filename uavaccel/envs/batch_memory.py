"""Observations of a batch in memory that its processes share."""

from __future__ import annotations

import mmap
from typing import Self, TypedDict

import numpy as np

from uavaccel.envs.values import Frame
from uavaccel.sim.rendering.slots import anonymous_memory


class Size(TypedDict):
    """Of what is shared: slots, and the shape and type of an observation."""

    slots: int
    shape: list[int]
    dtype: str


class Observations:
    """Each environment's present observation and, where a step ends a game and begins another, the ended one's last."""

    def __init__(self, descriptor: int, slots: int, shape: tuple[int, ...], dtype: str) -> None:
        self.descriptor = descriptor
        self._size = slots, shape, dtype
        both = np.frombuffer(mmap.mmap(descriptor, _bytes(*self._size)), dtype).reshape(2, slots, *shape)
        self.present: Frame = both[0]
        self.last: Frame = both[1]

    @classmethod
    def made(cls, slots: int, shape: tuple[int, ...], dtype: str) -> Self:
        return cls(anonymous_memory(_bytes(slots, shape, dtype)), slots, shape, dtype)

    @classmethod
    def opened(cls, descriptor: int, size: Size) -> Self:
        """Those that another process made; `size` is its `size`."""
        return cls(descriptor, size["slots"], tuple(size["shape"]), size["dtype"])

    @property
    def size(self) -> Size:
        slots, shape, dtype = self._size
        return {"slots": slots, "shape": list(shape), "dtype": dtype}

    def of(self, slot: int) -> tuple[Frame, Frame]:
        """Present and last observation of a slot."""
        return self.present[slot], self.last[slot]


def _bytes(slots: int, shape: tuple[int, ...], dtype: str) -> int:
    return 2 * slots * int(np.prod(shape)) * np.dtype(dtype).itemsize
