"""What cameras draw with: an OpenGL context with MuJoCo's textures, shared by a thread's worlds that look alike."""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Callable
from functools import partial

import mujoco
import numpy as np

from uavaccel.sim.camera import gl
from uavaccel.sim.camera.view import set_quality

# What `mjr_makeContext` copies from the model; everything else comes with the scene of each picture.
UPLOADED = ("tex_", "mat_tex", "mesh_", "hfield_", "skin_")
Key = tuple[int, int, bytes]
_of_thread = threading.local()  # .canvases: those that are open, by Key


class Canvas:
    """An OpenGL context of `width` x `height` pixels with the textures and meshes of a model.

    Uploading the textures of a lane takes .2 s in software, so that many environments of one process share one. It
    belongs to the thread that made it by `open`, and is freed when the last of its cameras leaves it.
    """

    def __init__(self, model: mujoco.MjModel, width: int, height: int, left: Callable[[], object]) -> None:
        self._gl, self.renderer = gl.make_context(width, height)
        self.turns = gl.turns(self.renderer)
        with self.turns:
            self.context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_50)
            gl.sample_textures_fast(self.context)
            if self.renderer.software:
                gl.drop_stencil(self.context, width, height)
            mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self.context)
            self.read_pixels = gl.pixel_reader()
        self.context.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR
        self._users, self._left = 0, left

    def bind(self) -> None:
        """Make it current in this thread. Raises UserError in a process forked from one that has rendered."""
        gl.check_process()
        with self.turns:
            gl.bind(self._gl)

    def leave(self) -> None:
        """Free it if no other camera draws with it; nothing is freed in a forked process."""
        self._users -= 1
        if self._users > 0 or not gl.survives():
            return
        self._left()
        self.bind()
        with self.turns:
            self.context.free()  # before its GL context, or it would free what is another's
            gl.release(self._gl)

    @classmethod
    def open(cls, model: mujoco.MjModel, width: int, height: int) -> Canvas:
        """Return this thread's canvas for such a model, made if there is none; each caller has to `leave` it.

        Raises UserError if OpenGL is missing.
        """
        gl.check_process()
        set_quality(model, width, height)  # part of what is compared
        canvases: dict[Key, Canvas] = _of_thread.__dict__.setdefault("canvases", {})
        key = (width, height, appearance(model))
        canvas = canvases.get(key)
        if canvas is None:
            canvas = canvases[key] = cls(model, width, height, partial(canvases.pop, key))
        canvas._users += 1
        return canvas


def appearance(model: mujoco.MjModel) -> bytes:
    """Return a digest of what MuJoCo uploads of a model: equal digests draw equal pictures of equal scenes."""
    digest = hashlib.blake2b(repr((model.vis.quality, model.vis.map, float(model.stat.extent))).encode())
    plane = model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE
    of_planes = model.geom_matid[plane]  # a lane's ground changes, but not how its textures repeat
    repeats = model.mat_texrepeat[of_planes], model.mat_texuniform[of_planes], of_planes >= 0
    for array in (model.geom_size[plane], model.geom_dataid[plane], *repeats):
        digest.update(np.ascontiguousarray(array).tobytes())
    for name in sorted(dir(model)):
        if name.startswith(UPLOADED):
            array = np.ascontiguousarray(getattr(model, name))
            digest.update(f"{name}{array.shape}".encode() + array.tobytes())
    return digest.digest()
