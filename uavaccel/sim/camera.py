"""The drone's camera, off-screen: AirSim's front camera, 256 x 144 pixels, 90 degrees wide.

Image, pose and simulated time belong together: every picture is of the pose in `data.qpos` at the moment of the
call. Rendering never changes the flight. Pictures come with the top row first; OpenGL's bottom row first is
turned over on the way.
"""

from __future__ import annotations

import atexit
import contextlib
import weakref
from typing import Any, Self

import cv2
import mujoco
import numpy as np
from numpy.typing import NDArray

from uavaccel.errors import UserError
from uavaccel.sim import gl
from uavaccel.sim.lane.scene import object_name

Image = NDArray[np.uint8]
DepthImage = NDArray[np.float32]
GeomImage = NDArray[np.int32]

WIDTH, HEIGHT, FOV_DEG = 256, 144, 90.0  # AirSim's defaults (AirSimSettings.hpp CaptureSetting)
DRONE_GROUP = 1  # of quadrotor.xml's visible geoms
_RENDER_FLAGS = {
    mujoco.mjtRndFlag.mjRND_CULL_FACE: True,  # half the faces of everything
    mujoco.mjtRndFlag.mjRND_SHADOW: False,
    mujoco.mjtRndFlag.mjRND_REFLECTION: False,
    mujoco.mjtRndFlag.mjRND_HAZE: False,
}
_ID_FLAGS = [int(mujoco.mjtRndFlag.mjRND_SEGMENT), int(mujoco.mjtRndFlag.mjRND_IDCOLOR)]
_EVERYTHING = int(mujoco.mjtCatBit.mjCAT_ALL)


class Camera:
    """Pictures from a camera of the model, in any MjData of it; each call returns a fresh array or fills `out`.

    One camera belongs to the thread that made it. `fov_deg` is horizontal, at any width, as AirSim's is.
    Raises UserError where OpenGL is missing or the model has no such camera.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        width: int = WIDTH,
        height: int = HEIGHT,
        camera: str = "front_center",
        fov_deg: float = FOV_DEG,
    ) -> None:
        self.model = model
        self.width, self.height = width, height
        self._half_width = float(np.tan(np.radians(fov_deg) / 2))  # of the picture, one metre ahead
        self._half_height = self._half_width * height / width
        self._view = _fixed_view(model, camera)
        self._options = _options(model, self._view.fixedcamid)
        self._scene = mujoco.MjvScene(model, maxgeom=model.ngeom + 8)
        for flag, value in _RENDER_FLAGS.items():
            self._scene.flags[flag] = value
        self._as_ids = False
        self._resized = not self._models_own_view()
        self._eyes = list(self._scene.camera)  # views of MuJoCo's own two, which it averages
        self._rectangle = mujoco.MjrRect(0, 0, width, height)
        self._pixels: Image = np.empty((height, width, 3), np.uint8)
        self._depth: DepthImage = np.empty((height, width), np.float32)
        self._ray_length = _ray_lengths(width, height, self._half_width)
        self._open()

    def _open(self) -> None:
        self._gl: Any
        self._gl, self.renderer = gl.make_context(self.width, self.height)
        _set_quality(self.model, self.width, self.height)
        self._context: Any = mujoco.MjrContext(self.model, mujoco.mjtFontScale.mjFONTSCALE_50)
        gl.sample_textures_fast(self._context)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)
        self._context.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR
        _close_at_exit(self)

    @property
    def far_m(self) -> float:
        """Depth of the sky: the far end of what is drawn."""
        return float(self.model.vis.map.zfar * self.model.stat.extent)

    def colour(self, data: mujoco.MjData, out: Image | None = None) -> Image:
        """Red, green, blue; (height, width, 3) uint8."""
        self._draw(data)
        picture = _target(self._pixels, out)
        mujoco.mjr_readPixels(picture, None, self._rectangle, self._context)
        return _turned_over(picture, out)

    def render_again(self, out: Image) -> None:
        """The scene of the last picture once more, upside down: the bare loop that ours is measured against."""
        mujoco.mjr_render(self._rectangle, self._scene, self._context)
        mujoco.mjr_readPixels(out, None, self._rectangle, self._context)

    def gray(self, data: mujoco.MjData, out: Image | None = None) -> Image:
        """Luma of the colour picture (ITU-R BT.601, as OpenCV and v2e take it); (height, width) uint8."""
        self._draw(data)
        mujoco.mjr_readPixels(self._pixels, None, self._rectangle, self._context)
        return _turned_over(cv2.cvtColor(self._pixels, cv2.COLOR_RGB2GRAY), out)

    def depth(self, data: mujoco.MjData, out: DepthImage | None = None) -> DepthImage:
        """Metres along the optical axis (AirSim's DepthPlanar); `far_m` for the sky; (height, width) float32."""
        self._draw(data, as_ids=True)  # depth needs no lighting
        picture = _target(self._depth, out)
        mujoco.mjr_readPixels(None, picture, self._rectangle, self._context)
        far = np.float32(self.far_m)
        near = np.float32(self.model.vis.map.znear * self.model.stat.extent)
        depth = _turned_over(picture, out)
        # The buffer is 1 at the near and 0 at the far plane, linear in the inverse of the depth.
        np.divide(near * far, near + depth * (far - near), out=depth)
        return depth

    def depth_perspective(self, data: mujoco.MjData, out: DepthImage | None = None) -> DepthImage:
        """Metres along each pixel's ray (AirSim's DepthPerspective); (height, width) float32."""
        depth = self.depth(data, out)
        depth *= self._ray_length
        return depth

    def segmentation(self, data: mujoco.MjData, out: GeomImage | None = None) -> GeomImage:
        """Id of the geom seen, -1 for the sky; (height, width) int32. Names: `object_names`."""
        self._draw(data, as_ids=True)
        mujoco.mjr_readPixels(self._pixels, None, self._rectangle, self._context)
        drawn = self._pixels[::-1].astype(np.int32) @ np.array([1, 1 << 8, 1 << 16], np.int32)
        ids = np.full(self._scene.ngeom + 1, -1, np.int32)
        for geom in self._scene.geoms[: self._scene.ngeom]:
            ids[geom.segid + 1] = geom.objid
        return np.take(ids, drawn, out=out)

    def object_names(self, geoms: GeomImage) -> list[str]:
        """Names of the objects in a segmentation, sorted; the sky has none."""
        return sorted({object_name(self.model, int(geom)) for geom in np.unique(geoms) if geom >= 0})

    def _draw(self, data: mujoco.MjData, as_ids: bool = False) -> None:
        self._bind()
        mujoco.mj_kinematics(self.model, data)  # mj_step leaves the places of the step's beginning
        mujoco.mj_camlight(self.model, data)
        if as_ids != self._as_ids:
            self._scene.flags[_ID_FLAGS] = self._as_ids = as_ids
        mujoco.mjv_updateScene(self.model, data, self._options, None, self._view, _EVERYTHING, self._scene)
        if self._resized:
            self._set_field_of_view()
        mujoco.mjr_render(self._rectangle, self._scene, self._context)

    def _models_own_view(self) -> bool:
        """Whether the model's vertical field of view is `fov_deg` wide at this aspect, to a thousandth of a pixel."""
        half_height = np.tan(np.radians(self.model.cam_fovy[self._view.fixedcamid]) / 2)
        return abs(half_height / self._half_height - 1) * self.width < 1e-3

    def _set_field_of_view(self) -> None:
        near = self._eyes[0].frustum_near
        for eye in self._eyes:
            eye.frustum_width = near * self._half_width
            eye.frustum_top, eye.frustum_bottom = near * self._half_height, -near * self._half_height

    def _bind(self) -> None:
        if self._gl is None:
            raise ValueError("this camera is closed")
        gl.check_process()
        gl.bind(self._gl)

    def close(self) -> None:
        """Free what OpenGL holds; further calls do nothing."""
        if getattr(self, "_gl", None) is None or not gl.survives():
            return
        self._bind()
        self._context.free()  # before its GL context, or it would free what is another's
        gl.release(self._gl)
        self._context = self._gl = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __del__(self) -> None:
        try:  # noqa: SIM105 - at the interpreter's end contextlib may be gone already
            self.close()
        except Exception:
            pass


def _fixed_view(model: mujoco.MjModel, camera: str) -> mujoco.MjvCamera:
    view = mujoco.MjvCamera()
    view.type = mujoco.mjtCamera.mjCAMERA_FIXED
    view.fixedcamid = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, camera)
    if view.fixedcamid < 0:
        names = ", ".join(model.camera(index).name for index in range(model.ncam))
        raise UserError(f"no camera {camera!r} in the scene; there is {names or 'none'}")
    return view


def _options(model: mujoco.MjModel, camera: int) -> mujoco.MjvOption:
    """What is drawn: all but the drone, for a camera that it carries: nothing of it is in view."""
    options = mujoco.MjvOption()
    options.geomgroup[DRONE_GROUP] = model.cam_bodyid[camera] != model.body("quadrotor").id
    return options


def _set_quality(model: mujoco.MjModel, width: int, height: int) -> None:
    """What MjrContext reads once, when it is made: no shadow map and no multisampling, each several frames' worth."""
    model.vis.quality.shadowsize = 0
    model.vis.quality.offsamples = 0
    model.vis.global_.offwidth, model.vis.global_.offheight = width, height


def _ray_lengths(width: int, height: int, half_width: float) -> DepthImage:
    """Length of each pixel's ray to the plane one metre ahead; (height, width)."""
    pixel = 2 * half_width / width
    right = (np.arange(width) + 0.5 - width / 2) * pixel
    down = (np.arange(height) + 0.5 - height / 2) * pixel
    return np.sqrt(1 + right[None, :] ** 2 + down[:, None] ** 2).astype(np.float32)


def _target(like: NDArray[Any], out: NDArray[Any] | None) -> NDArray[Any]:
    """Where to read a picture like that into: `out` itself, if OpenGL can write there, else a fresh array."""
    fits = out is not None and out.flags.c_contiguous and (out.shape, out.dtype) == (like.shape, like.dtype)
    return out if out is not None and fits else np.empty_like(like)


def _turned_over(picture: NDArray[Any], out: NDArray[Any] | None) -> NDArray[Any]:
    """The top row first: turned over in place, a third of the time that a second picture takes."""
    cv2.flip(picture, 0, dst=picture)
    if out is None or out is picture:
        return picture
    np.copyto(out, picture)
    return out


_open_cameras: weakref.WeakSet[Camera] = weakref.WeakSet()


def _close_at_exit(camera: Camera) -> None:
    """Close before MuJoCo's own exit handler, which takes the display away: handlers run last in, first out."""
    if not _open_cameras:
        atexit.unregister(_close_all)
        atexit.register(_close_all)
    _open_cameras.add(camera)


def _close_all() -> None:
    for camera in list(_open_cameras):
        with contextlib.suppress(Exception):
            camera.close()
