"""Several pictures rendered one after another into one small buffer, and read back at once.

A picture's last bits depend on its position in the buffer, since vertices are rounded relative to the buffer's corner.
So each picture is rendered at the corner, like that of a single camera, and copied by the GPU into a tile of a pixel
buffer; the CPU waits only for the last one. With two buffers one is rendered while the other is read.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType

import mujoco
import numpy as np
from numpy.typing import NDArray

from uavaccel.sim.camera.canvas import Canvas
from uavaccel.sim.camera.gl import GlRenderer
from uavaccel.sim.camera.view import HEIGHT, WIDTH

TILE_BYTES = WIDTH * HEIGHT * 4  # four bytes of colour per pixel, or a float of depth
BUFFERS = 2


class Tiles:
    """Renders `count` pictures at a time of scenes with the textures of `model`: RGBA or depth, bottom row first.

    Raises UserError if OpenGL is missing.
    """

    def __init__(self, model: mujoco.MjModel, count: int) -> None:
        self.count = count
        self._canvas = Canvas(model, WIDTH, HEIGHT)  # no one else's: a buffer stays bound in it
        self._context = self._canvas.context
        self._rectangle = mujoco.MjrRect(0, 0, WIDTH, HEIGHT)
        self._offsets = [ctypes.c_void_p(TILE_BYTES * place) for place in range(count)]
        from OpenGL import GL  # takes the platform of the first context, so not before there is one

        self._api: ModuleType = GL
        self._buffers = [int(buffer) for buffer in self._api.glGenBuffers(BUFFERS)]
        self._bound = -1
        for buffer in range(BUFFERS):
            self._bind(buffer)
            size, usage = TILE_BYTES * count, self._api.GL_STREAM_READ
            self._api.glBufferData(self._api.GL_PIXEL_PACK_BUFFER, size, None, usage)

    def _bind(self, buffer: int) -> None:
        if buffer != self._bound:
            self._api.glBindBuffer(self._api.GL_PIXEL_PACK_BUFFER, self._buffers[buffer])
            self._bound = buffer

    def render(self, buffer: int, place: int, scene: mujoco.MjvScene, depth: bool = False) -> None:
        """Queue the rendering of a scene into a tile."""
        self._bind(buffer)
        mujoco.mjr_render(self._rectangle, scene, self._context)
        api = self._api
        kind = (api.GL_DEPTH_COMPONENT, api.GL_FLOAT) if depth else (api.GL_RGBA, api.GL_UNSIGNED_BYTE)
        self._canvas.read_pixels(0, 0, WIDTH, HEIGHT, *kind, self._offsets[place])

    @contextmanager
    def read(self, buffer: int, count: int, depth: bool = False) -> Iterator[NDArray[np.uint8] | NDArray[np.float32]]:
        """Yield the first `count` tiles, (count, H, W, 4) uint8 or (count, H, W) float32, valid inside the block."""
        self._bind(buffer)
        api = self._api
        address = api.glMapBuffer(api.GL_PIXEL_PACK_BUFFER, api.GL_READ_ONLY)
        try:
            drawn = np.ctypeslib.as_array((ctypes.c_uint8 * (TILE_BYTES * count)).from_address(address))
            floats = drawn.view(np.float32).reshape(count, HEIGHT, WIDTH)
            yield floats if depth else drawn.reshape(count, HEIGHT, WIDTH, 4)
        finally:
            api.glUnmapBuffer(api.GL_PIXEL_PACK_BUFFER)

    @property
    def renderer(self) -> GlRenderer:
        """The renderer that draws."""
        return self._canvas.renderer

    def close(self) -> None:
        """Free what OpenGL holds."""
        self._api.glDeleteBuffers(BUFFERS, self._buffers)
        self._canvas.leave()
