"""Shared memory of a renderer and its cameras: a slot for each camera, besides a pipe in each direction.

Memory and pipes have no names, so that nothing remains of them after the last process has ended, however it did. A
camera writes pose and kind into its slot and its number into the pipe of requests; the renderer writes the picture
into the slot and a byte into the camera's own pipe. Each notices the other's end as the end of a pipe.
"""

from __future__ import annotations

import mmap
import os
import tempfile
from collections.abc import Iterator

import mujoco
import numpy as np
from numpy.typing import NDArray

from uavaccel.sim.camera.view import HEIGHT, WIDTH, AnyImage

KINDS = ("gray", "colour", "depth", "segmentation")
REQUEST_BYTES = 2  # the camera's number, little-endian: writes of so few bytes are whole
DONE = b"\1"
_PICTURE_BYTES = WIDTH * HEIGHT * 4
_APPEARANCE = (  # the visible parts of the model that a layout changes
    *("geom_type", "geom_size", "geom_rbound", "geom_pos", "geom_quat", "geom_rgba", "geom_matid"),
    *("geom_dataid", "geom_sameframe"),
    *("light_pos", "light_dir", "light_diffuse", "light_ambient"),
)


def slot_dtype(model: mujoco.MjModel) -> np.dtype[np.void]:
    """Return the type of a slot: kind of picture, number of changes of the looks, qpos, looks, picture bottom up."""
    looks = sum(getattr(model, name).nbytes for name in _APPEARANCE)
    return np.dtype(
        [
            ("kind", np.int64),
            ("revision", np.int64),
            ("pose", np.float64, model.nq),
            ("looks", np.uint8, looks),
            ("picture", np.uint8, _PICTURE_BYTES),
        ],
        align=True,
    )


def write_appearance(model: mujoco.MjModel, looks: NDArray[np.uint8]) -> None:
    """Copy the appearance of the model's objects and lights to `looks`."""
    for values, kept in _views(model, looks):
        kept[:] = values


def read_appearance(looks: NDArray[np.uint8], model: mujoco.MjModel) -> None:
    """Copy `looks` to the model."""
    for values, kept in _views(model, looks):
        values[:] = kept


def _views(model: mujoco.MjModel, looks: NDArray[np.uint8]) -> Iterator[tuple[NDArray[np.uint8], NDArray[np.uint8]]]:
    """Yield the bytes of each visible part of the model, and those of `looks` that hold it."""
    start = 0
    for name in _APPEARANCE:
        values = getattr(model, name).view(np.uint8).reshape(-1)
        yield values, looks[start : start + len(values)]
        start += len(values)


def pixels(slot: np.void, kind: str) -> AnyImage:
    """Return the picture in a slot as an array of its kind: (H, W) uint8, float32 or int32, or (H, W, 3) uint8."""
    if kind in ("gray", "colour"):
        shape = (HEIGHT, WIDTH) if kind == "gray" else (HEIGHT, WIDTH, 3)
        return np.asarray(slot["picture"][: int(np.prod(shape))].reshape(shape))
    dtype = np.float32 if kind == "depth" else np.int32
    return np.asarray(slot["picture"].view(dtype).reshape(HEIGHT, WIDTH))


def anonymous_memory(size: int) -> int:
    """Return a file descriptor of `size` zero bytes, shared by processes that inherit it."""
    if hasattr(os, "memfd_create"):
        descriptor = os.memfd_create("uavaccel")
    else:
        descriptor, path = tempfile.mkstemp()
        os.unlink(path)
    os.ftruncate(descriptor, size)
    return descriptor


def map_records(descriptor: int, dtype: np.dtype[np.void], count: int) -> NDArray[np.void]:
    """Map `count` records in shared memory."""
    return np.frombuffer(mmap.mmap(descriptor, dtype.itemsize * count), dtype)
