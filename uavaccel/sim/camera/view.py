"""A camera's view as MuJoCo's abstract scene: the part of rendering that needs no OpenGL."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, TypeVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from uavaccel.errors import UserError
from uavaccel.sim.lane import APPEARANCE_GROUP, BODIES_GROUP
from uavaccel.sim.poses import Pose, from_mujoco
from uavaccel.sim.scene import DRONE_GROUP
from uavaccel.units import ned_to_mujoco

Image = NDArray[np.uint8]
DepthImage = NDArray[np.float32]
GeomImage = NDArray[np.int32]
AnyImage = NDArray[Any]
"""An `Image`, a `DepthImage` or a `GeomImage`."""
Scalar = TypeVar("Scalar", bound=np.integer | np.floating)

FRONT = "front_center"
WIDTH, HEIGHT, FOV_DEG = 256, 144, 90.0  # AirSim's defaults (AirSimSettings.hpp CaptureSetting)
_RENDER_FLAGS = {
    mujoco.mjtRndFlag.mjRND_CULL_FACE: True,  # half the faces of everything
    mujoco.mjtRndFlag.mjRND_SHADOW: False,
    mujoco.mjtRndFlag.mjRND_REFLECTION: False,
    mujoco.mjtRndFlag.mjRND_HAZE: False,
}
_ID_FLAGS = [int(mujoco.mjtRndFlag.mjRND_SEGMENT), int(mujoco.mjtRndFlag.mjRND_IDCOLOR)]
_EVERYTHING = int(mujoco.mjtCatBit.mjCAT_ALL)


class View:
    """The scene in front of the model's camera, FRONT; `fov_deg` is its own, horizontal at any width.

    Raises UserError if the model has no such camera, or one that is no pinhole.
    """

    def __init__(self, model: mujoco.MjModel, width: int, height: int) -> None:
        self.model, self._camera, self._options = model, mujoco.MjvCamera(), mujoco.MjvOption()
        self._camera.type = mujoco.mjtCamera.mjCAMERA_FIXED
        self._camera.fixedcamid = number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, FRONT)
        if number < 0:
            names = ", ".join(model.camera(index).name for index in range(model.ncam))
            raise UserError(f"no camera {FRONT!r} in the scene; there is {names or 'none'}")
        if not is_pinhole(model, number):
            raise UserError(
                f"camera {FRONT!r}: must be fixed to its body, in perspective, and have fovy, not sensorsize"
            )
        self.fov_deg = own_fov_deg(model, number)
        # for a camera on the drone everything except the drone, which is out of its view
        self._options.sitegroup[:] = 0  # marks of MJCF, not things; their ids are not geoms'
        self._options.geomgroup[DRONE_GROUP] = model.cam_bodyid[number] != model.body("quadrotor").id
        self.scene = mujoco.MjvScene(model, maxgeom=model.ngeom + 8)
        for flag, value in _RENDER_FLAGS.items():
            self.scene.flags[flag] = value
        self._as_ids = False
        self._show_appearance(True)
        self.look_from(None, width, height, self.fov_deg)
        self._eyes = list(self.scene.camera)  # views of MuJoCo's own two, which it averages

    def look_from(self, eye: Pose | None, width: int, height: int, fov_deg: float) -> None:
        """Set the pose, NED, None for the camera's own, the size in pixels and the field of view."""
        self._eye = eye
        self.half_width = float(np.tan(np.radians(fov_deg) / 2))  # of the picture, one metre ahead
        self._half_height = self.half_width * height / width
        own = np.tan(np.radians(self.model.cam_fovy[self._camera.fixedcamid]) / 2)
        self._resized = not abs(own / self._half_height - 1) * width < 1e-3  # a thousandth of a pixel

    def show_everything(self) -> None:
        """Make the drone visible too."""
        self._options.geomgroup[DRONE_GROUP] = True

    def update(self, data: mujoco.MjData, as_ids: bool = False) -> mujoco.MjvScene:
        """Return the scene for the pose in `data.qpos`; with `as_ids` each geom has an unlit colour that encodes it."""
        mujoco.mj_kinematics(self.model, data)  # mj_step leaves the positions of the step's beginning
        mujoco.mj_camlight(self.model, data)
        if self._eye is not None:  # the model's camera is moved, which affects no physics and lasts until the next step
            (forward, right, down), camera = self._eye.matrix().T, self._camera.fixedcamid
            axes = np.stack([ned_to_mujoco(right), -ned_to_mujoco(down), -ned_to_mujoco(forward)], axis=1)
            data.cam_xpos[camera], data.cam_xmat[camera] = ned_to_mujoco(self._eye.position_m), axes.ravel()
        if as_ids != self._as_ids:
            self.scene.flags[_ID_FLAGS] = self._as_ids = as_ids
            self._show_appearance(not as_ids)
        mujoco.mjv_updateScene(self.model, data, self._options, None, self._camera, _EVERYTHING, self.scene)
        for eye in self._eyes if self._resized else ():
            eye.frustum_width = eye.frustum_near * self.half_width
            eye.frustum_top = eye.frustum_near * self._half_height
            eye.frustum_bottom = -eye.frustum_top
        return self.scene

    def geoms(self, drawn: NDArray[np.integer]) -> GeomImage:
        """Decode the geoms' ids in a picture (height, width, 3 or more) rendered `as_ids`; -1 for the sky."""
        segments = drawn[..., :3].astype(np.int32) @ np.array([1, 1 << 8, 1 << 16], np.int32)
        ids = np.full(self.scene.ngeom + 1, -1, np.int32)
        for geom in self.scene.geoms[: self.scene.ngeom]:
            ids[geom.segid + 1] = geom.objid
        return ids[segments]

    def _show_appearance(self, on: bool) -> None:
        """Show a scenery's looks, or its bodies instead."""
        self._options.geomgroup[APPEARANCE_GROUP] = on
        self._options.geomgroup[BODIES_GROUP] = not on


def vehicle_pose(data: mujoco.MjData, vehicle: int = 0) -> Pose:
    """Return the pose, NED, of vehicle number `vehicle` in `data.qpos`."""
    place, attitude = np.split(data.qpos[7 * vehicle : 7 * vehicle + 7], [3])
    return from_mujoco(place, attitude)


def is_pinhole(model: mujoco.MjModel, camera: int) -> bool:
    """Return whether a camera is fixed to its body, and sees in perspective what its `fovy` says."""
    fixed = model.cam_mode[camera] == mujoco.mjtCamLight.mjCAMLIGHT_FIXED
    perspective = model.cam_projection[camera] == mujoco.mjtProjection.mjPROJ_PERSPECTIVE
    return bool(fixed and perspective and not model.cam_sensorsize[camera].any())


def own_fov_deg(model: mujoco.MjModel, camera: int) -> float:
    """Return how wide a camera's pictures of WIDTH x HEIGHT are: FOV_DEG if within a thousandth of a pixel."""
    half_width = float(np.tan(np.radians(model.cam_fovy[camera]) / 2)) * WIDTH / HEIGHT
    is_airsims = abs(half_width / np.tan(np.radians(FOV_DEG) / 2) - 1) * WIDTH < 1e-3
    return FOV_DEG if is_airsims else float(np.degrees(2 * np.arctan(half_width)))


def far_m(model: mujoco.MjModel) -> float:
    """Return the depth of the sky: the far clipping plane, in metres."""
    return float(model.vis.map.zfar * model.stat.extent)


def to_metres(model: mujoco.MjModel, depth: DepthImage) -> DepthImage:
    """Convert OpenGL's depth buffer, 1 at the near and 0 at the far plane, to metres in place."""
    far, near = np.float32(far_m(model)), np.float32(model.vis.map.znear * model.stat.extent)
    np.divide(near * far, near + depth * (far - near), out=depth)  # linear in the inverse of the depth
    return depth


@lru_cache(maxsize=8)  # clients may set any field of view
def ray_lengths(width: int, height: int, fov_deg: float) -> DepthImage:
    """Return the length of each pixel's ray to the plane one metre ahead; (height, width)."""
    pixel = 2 * float(np.tan(np.radians(fov_deg) / 2)) / width
    right = (np.arange(width) + 0.5 - width / 2) * pixel
    down = (np.arange(height) + 0.5 - height / 2) * pixel
    return np.sqrt(1 + right[None, :] ** 2 + down[:, None] ** 2).astype(np.float32)


def set_quality(model: mujoco.MjModel, width: int, height: int) -> None:
    """Switch off shadow map and multisampling, whose setup takes several frames, before an MjrContext is made."""
    quality = model.vis.quality
    quality.shadowsize = quality.offsamples = 0
    model.vis.global_.offwidth, model.vis.global_.offheight = width, height
