"""Off-screen cameras: AirSim's front camera, 256 x 144 pixels and 90 degrees wide, and those of any pose and size.

A picture shows the pose in `data.qpos` at the moment of the call, and rendering never changes the flight. Pictures have
the top row first, unlike OpenGL's. A thread's cameras of worlds that look alike draw on one canvas.
"""

from __future__ import annotations

import atexit
import contextlib
import ctypes
import hashlib
import threading
import weakref
from collections.abc import Callable
from contextvars import ContextVar
from functools import partial
from typing import NamedTuple, Self

import mujoco
import numpy as np

from uavaccel.sim.camera import gl
from uavaccel.sim.camera.pixels import luma, turned_colours
from uavaccel.sim.camera.view import (
    FOV_DEG,
    HEIGHT,
    WIDTH,
    DepthImage,
    GeomImage,
    Image,
    View,
    far_m,
    ray_lengths,
    set_quality,
    to_metres,
)
from uavaccel.sim.poses import Pose

SKY_M = 65504.0  # AirSim's depth of the sky: the largest half-precision number
FRONT_CENTER = Pose((0.46, 0.0, 0.0))  # quadrotor.xml's own camera
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
        if self._users > 0 or gl.forked:
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
    has = of_planes >= 0
    repeats = model.mat_texrepeat[of_planes[has]], model.mat_texuniform[of_planes[has]], has
    for array in (model.geom_size[plane], model.geom_dataid[plane], *repeats):
        digest.update(np.ascontiguousarray(array).tobytes())
    for name in sorted(dir(model)):
        if name.startswith(UPLOADED):
            array = np.ascontiguousarray(getattr(model, name))
            digest.update(f"{name}{array.shape}".encode() + array.tobytes())
    return digest.digest()


_GL_RGBA, _GL_UNSIGNED_BYTE = 0x1908, 0x1401


class Lens(NamedTuple):
    """Size of a picture in pixels, and its horizontal field of view in degrees."""

    width: int = WIDTH
    height: int = HEIGHT
    fov_deg: float = FOV_DEG


CameraMaker = Callable[[mujoco.MjModel, int, int], "Camera"]
_maker: ContextVar[CameraMaker | None] = ContextVar("camera maker", default=None)


def make_cameras_with(maker: CameraMaker) -> None:
    """Let the worlds of this thread make their cameras with `maker(model, width, height)`."""
    _maker.set(maker)


def make_camera(model: mujoco.MjModel, width: int, height: int) -> Camera:
    """Make the front camera of a world of this thread, by default a `Camera`; see `make_cameras_with`."""
    return (_maker.get() or Camera)(model, width, height)


class Camera:
    """Renders the model's front camera, in any MjData of it, with its thread's OpenGL context for such models.

    A camera belongs to the thread that made it. Its field of view is that of the model, horizontal at any width. Raises
    UserError if OpenGL is missing or the model has no such camera.
    """

    def __init__(self, model: mujoco.MjModel, width: int = WIDTH, height: int = HEIGHT) -> None:
        self.model, self._view = model, View(model, width, height)
        self._look_through(Lens(width, height, self._view.fov_deg))
        self._canvas = Canvas.open(model, width, height)
        self._context, self._turns = self._canvas.context, self._canvas.turns
        self._is_open = True
        atexit.unregister(_close_all)
        atexit.register(_close_all)  # before MuJoCo's own exit handler, which removes the display: last in, first out
        _open_cameras.add(self)

    def _look_through(self, lens: Lens) -> None:
        self._lens, self.width, self.height = lens, lens.width, lens.height
        self._rectangle = mujoco.MjrRect(0, 0, lens.width, lens.height)
        self._pixels: Image = np.full((lens.height, lens.width, 4), 128, np.uint8)  # as the driver has them
        self._address = self._pixels.ctypes.data_as(ctypes.c_void_p)

    @property
    def renderer(self) -> gl.GlRenderer:
        """The renderer that draws its pictures."""
        return self._canvas.renderer

    @property
    def far_m(self) -> float:
        """Depth of the sky: the far clipping plane, in metres."""
        return far_m(self.model)

    def gray(self, data: mujoco.MjData) -> Image:
        """Render luma (ITU-R BT.601, as OpenCV and v2e compute it); (height, width) uint8."""
        self._read_colours(data)
        return luma(self._pixels, turned=True)

    def colour(self, data: mujoco.MjData) -> Image:
        """Render red, green, blue; (height, width, 3) uint8."""
        self._read_colours(data)
        return turned_colours(self._pixels)

    def depth(self, data: mujoco.MjData) -> DepthImage:
        """Render metres along the optical axis (AirSim's DepthPlanar), `far_m` for the sky; (height, width) float32."""
        return to_metres(self.model, self._read_depths(data))

    def depth_perspective(self, data: mujoco.MjData) -> DepthImage:
        """Render metres along each pixel's ray (AirSim's DepthPerspective); (height, width) float32."""
        return self.depth(data) * ray_lengths(*self._lens)

    def segmentation(self, data: mujoco.MjData) -> GeomImage:
        """Render the id of the geom in each pixel, -1 for the sky; (height, width) int32."""
        self._read_colours(data, as_ids=True)
        return self._view.geoms(self._pixels[::-1])

    def render_again(self, out: Image) -> None:
        """Render the last scene again in colour, bottom row first: the bare cost, for benchmarks."""
        mujoco.mjr_render(self._rectangle, self._view.scene, self._context)
        mujoco.mjr_readPixels(out, None, self._rectangle, self._context)

    def _read_depths(self, data: mujoco.MjData) -> DepthImage:
        """Return OpenGL's depth buffer, 1 at the near and 0 at the far plane; depth needs no lighting."""
        self._draw(data, as_ids=True)
        picture = np.empty((self.height, self.width), np.float32)
        with self._turns:
            mujoco.mjr_readPixels(None, picture, self._rectangle, self._context)
        return np.ascontiguousarray(picture[::-1])

    def _read_colours(self, data: mujoco.MjData, as_ids: bool = False) -> None:
        """Read red, green, blue, alpha: with three bytes per pixel the driver takes five times as long."""
        self._draw(data, as_ids)
        with self._turns:
            self._canvas.read_pixels(0, 0, self.width, self.height, _GL_RGBA, _GL_UNSIGNED_BYTE, self._address)

    def _draw(self, data: mujoco.MjData, as_ids: bool) -> None:
        if not self._is_open:
            raise ValueError("this camera is closed")
        self._canvas.bind()
        scene = self._view.update(data, as_ids)
        with self._turns:
            mujoco.mjr_render(self._rectangle, scene, self._context)

    def close(self) -> None:
        """Free what OpenGL holds; further calls do nothing."""
        if getattr(self, "_is_open", False):
            self._is_open = False
            self._canvas.leave()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __del__(self) -> None:
        try:  # noqa: SIM105 - at the interpreter's end contextlib may be gone already
            self.close()
        except Exception:
            pass


class BlankCamera(Camera):
    """Takes grey pictures of the sky without OpenGL, for flights of which only the modelled time counts."""

    def __init__(self, model: mujoco.MjModel, width: int, height: int) -> None:
        self.model = model
        self._look_through(Lens(width, height))

    def _read_colours(self, data: mujoco.MjData, as_ids: bool = False) -> None:
        """Leave the pixels as they are."""

    def depth(self, data: mujoco.MjData) -> DepthImage:
        return np.full((self.height, self.width), self.far_m, np.float32)

    def segmentation(self, data: mujoco.MjData) -> GeomImage:
        return np.full((self.height, self.width), -1, np.int32)


_open_cameras: weakref.WeakSet[Camera] = weakref.WeakSet()


def _close_all() -> None:
    for camera in list(_open_cameras):
        with contextlib.suppress(Exception):
            camera.close()


class MountedCamera(Camera):
    """A camera that is pointed for each picture, of at most `width` x `height` pixels.

    The vehicle that carries it is visible. Raises UserError if OpenGL is missing.
    """

    def __init__(self, model: mujoco.MjModel, width: int = WIDTH, height: int = HEIGHT) -> None:
        super().__init__(model, width, height)
        self.width_most, self.height_most = width, height
        self._view.show_everything()

    def point(self, eye: Pose | None, lens: Lens) -> None:
        """Take the next pictures from `eye`, NED, or from the model's own camera if None, through `lens`."""
        self._view.look_from(eye, lens.width, lens.height, lens.fov_deg)
        if lens != self._lens:
            self._look_through(lens)

    def depth(self, data: mujoco.MjData) -> DepthImage:
        """Render metres along the optical axis, SKY_M for the sky; (height, width) float32."""
        picture = self._read_depths(data)
        sky = picture == 0.0
        depth = to_metres(self.model, picture)
        depth[sky] = SKY_M
        return depth

    def depth_perspective(self, data: mujoco.MjData) -> DepthImage:
        """Render metres along each pixel's ray, SKY_M for the sky; (height, width) float32."""
        return np.minimum(super().depth_perspective(data), np.float32(SKY_M))
