"""Several pictures drawn one after another into one small buffer, and read back together.

A picture's last bits depend on where in its buffer it is drawn: vertices are rounded relative to the buffer's corner.
So each is drawn at the corner, as a camera's only picture is, and queued, by the GPU itself, into a tile of a pixel
buffer; what the processor waits for is the last one.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from uavaccel.sim import gl
from uavaccel.sim.view import HEIGHT, WIDTH, set_quality

TILE_BYTES = WIDTH * HEIGHT * 4  # four bytes of colour a pixel, or a float of depth


class Tiles:
    """`count` pictures at a time of scenes that share the textures of `model`; red, green, blue, alpha, or depth.

    Bottom row first. Raises UserError where OpenGL is missing.
    """

    def __init__(self, model: mujoco.MjModel, count: int) -> None:
        self.count = count
        self._gl: Any
        self._gl, self.renderer = gl.make_context(WIDTH, HEIGHT)
        set_quality(model, WIDTH, HEIGHT)
        self._context: Any = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_50)
        gl.sample_textures_fast(self._context)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)
        self._rectangle = mujoco.MjrRect(0, 0, WIDTH, HEIGHT)
        self._offsets = [ctypes.c_void_p(TILE_BYTES * place) for place in range(count)]
        from OpenGL import GL  # takes the platform of the first context, so not before there is one

        self._api: Any = GL
        self._buffer = int(GL.glGenBuffers(1))
        GL.glBindBuffer(GL.GL_PIXEL_PACK_BUFFER, self._buffer)
        GL.glBufferData(GL.GL_PIXEL_PACK_BUFFER, TILE_BYTES * count, None, GL.GL_STREAM_READ)

    def draw(self, place: int, scene: mujoco.MjvScene, depth: bool = False) -> None:
        """Queue a picture of the scene for a tile."""
        gl_api = self._api
        mujoco.mjr_render(self._rectangle, scene, self._context)
        kind = (
            (gl_api.GL_DEPTH_COMPONENT, gl_api.GL_FLOAT)
            if depth
            else (gl_api.GL_RGBA, gl_api.GL_UNSIGNED_BYTE)
        )
        gl_api.glReadPixels(0, 0, WIDTH, HEIGHT, *kind, self._offsets[place])

    @contextmanager
    def read(self, count: int, depth: bool = False) -> Iterator[NDArray[Any]]:
        """The first `count` tiles, (count, H, W, 4) uint8 or (count, H, W) float32, for as long as the block lasts."""
        gl_api, size = self._api, TILE_BYTES * count
        address = gl_api.glMapBuffer(gl_api.GL_PIXEL_PACK_BUFFER, gl_api.GL_READ_ONLY)
        try:
            drawn = np.ctypeslib.as_array((ctypes.c_uint8 * size).from_address(address))
            tiles = drawn.view(np.float32).reshape(count, HEIGHT, WIDTH)
            yield tiles if depth else drawn.reshape(count, HEIGHT, WIDTH, 4)
        finally:
            gl_api.glUnmapBuffer(gl_api.GL_PIXEL_PACK_BUFFER)

    def close(self) -> None:
        """Free what OpenGL holds."""
        self._api.glDeleteBuffers(1, [self._buffer])
        self._context.free()  # before its GL context, or it would free what is another's
        gl.release(self._gl)
