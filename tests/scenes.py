"""Scenes of known measures, and what a camera 90 degrees wide must see of them, by rays cast in numpy.

A ray through a pixel is (forward 1, right, down), so the distance at which it ends is the depth along the optical
axis, and that times its length the depth along the ray.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import cv2
import mujoco
import numpy as np
from numpy.typing import NDArray

from uavaccel.sim.lane import object_name

Scene = tuple[mujoco.MjModel, mujoco.MjData]
ROWS, COLUMNS = 144, 256

# Name: middle and half sizes of a box, north, east, down, in metres; as in blocks.xml, whose second axis is west.
BLOCKS = {
    "block_north": ((45.0, 0.0, -6.0), (3.0, 20.0, 6.0)),
    "block_north_east": ((40.0, 35.0, -4.0), (4.0, 4.0, 4.0)),
    "block_east": ((0.0, 45.0, -6.0), (20.0, 3.0, 6.0)),
    "block_south": ((-45.0, 0.0, -3.0), (3.0, 12.0, 3.0)),
    "block_west": ((0.0, -45.0, -6.0), (20.0, 3.0, 6.0)),
    "block_north_west": ((35.0, -35.0, -8.0), (3.0, 3.0, 8.0)),
    "ground": ((0.0, 0.0, 1.0), (100.0, 100.0, 1.0)),
}


def object_names(model: mujoco.MjModel, geoms: NDArray[np.int32]) -> list[str]:
    """The names of the objects in a segmentation, sorted, without the sky."""
    return sorted({object_name(model, int(geom)) for geom in np.unique(geoms) if geom >= 0})


def assert_bounded(model: mujoco.MjModel) -> None:
    """MuJoCo looks for contacts and rays only within its bounds of shapes: none is too small, nor twice as large."""
    kinds, size = model.geom_type, model.geom_size
    sphere, capsule, ellipsoid, cylinder, box = (kinds == kind for kind in (2, 3, 4, 5, 6))
    across = np.where(ellipsoid | box, size[:, 1], size[:, 0])
    up = np.select([sphere, capsule, cylinder], [size[:, 0], size[:, 0] + size[:, 1], size[:, 1]], size[:, 2])
    half, known = np.stack([size[:, 0], across, up], axis=1), sphere | capsule | ellipsoid | cylinder | box
    rim = np.hypot(up, np.where(box, np.hypot(size[:, 0], across), size[:, 0]))
    reach = np.where(box | cylinder, rim, half.max(axis=1))[known]
    np.testing.assert_allclose(model.geom_aabb[known], np.hstack([0 * half, half])[known])
    assert (model.geom_rbound[known] >= reach * (1 - 1e-9)).all()
    assert (model.geom_rbound[known] < 2 * reach).all()


class Pose(NamedTuple):
    """NED metres, and roll, pitch and yaw in degrees."""

    position_m: tuple[float, float, float]
    degrees: tuple[float, float, float]

    def matrix(self) -> NDArray[np.float64]:
        """Forward, right and down, as columns in NED: turned by yaw, then pitch, then roll."""
        roll, pitch, yaw = np.radians(self.degrees)
        turned = np.eye(3)
        for axis, angle in ((2, yaw), (1, pitch), (0, roll)):
            a, b = [index for index in range(3) if index != axis]
            step, sign = np.eye(3), -1.0 if axis == 1 else 1.0
            step[a, a] = step[b, b] = np.cos(angle)
            step[b, a], step[a, b] = sign * np.sin(angle), -sign * np.sin(angle)
            turned = turned @ step
        return turned

    def quaternion(self) -> NDArray[np.float64]:
        """wxyz, as the product of three turns."""
        w = np.array([1.0, 0.0, 0.0, 0.0])
        for axis, angle in ((2, self.degrees[2]), (1, self.degrees[1]), (0, self.degrees[0])):
            half, turn = np.radians(angle) / 2, np.zeros(3)
            turn[axis] = np.sin(half)
            w = np.array([w[0] * np.cos(half) - w[1:] @ turn,
                          *(w[0] * turn + np.cos(half) * w[1:] + np.cross(w[1:], turn))])  # fmt: skip
        return w

    def camera_m(self) -> NDArray[np.float64]:
        """Where the camera is: 0.46 m ahead of the vehicle's middle."""
        return np.array(self.position_m) + 0.46 * self.matrix()[:, 0]

    def message(self) -> dict[str, Any]:
        orientation = self.quaternion().tolist()
        return {
            "position": dict(zip(("x_val", "y_val", "z_val"), self.position_m, strict=True)),
            "orientation": dict(zip(("w_val", "x_val", "y_val", "z_val"), orientation, strict=True)),
        }


class Seen(NamedTuple):
    """Per pixel (144, 256): metres along the axis and along the ray, and which box is seen, -1 for none."""

    planar_m: NDArray[np.float64]
    perspective_m: NDArray[np.float64]
    box: NDArray[np.int64]

    def inside(self) -> NDArray[np.bool_]:
        """Pixels away from every edge, where the ray and the rasteriser must agree."""
        box = self.box.astype(np.int16)
        around = np.ones((3, 3), np.uint8)
        return (cv2.dilate(box, around) == box) & (cv2.erode(box, around) == box)


def cast_rays(pose: Pose, boxes: dict[str, Any]) -> Seen:
    """What a camera 90 degrees wide sees of boxes, given in NED."""
    return cast_from(pose.camera_m(), pose.matrix(), boxes, COLUMNS, ROWS, 90.0)


def cast_from(
    eye: NDArray[np.float64], axes: NDArray[np.float64], boxes: dict[str, Any], columns: int, rows: int, fov_deg: float
) -> Seen:
    """What a camera at `eye` sees of boxes in NED; its forward, right and down are the columns of `axes`."""
    pixel = 2 * np.tan(np.radians(fov_deg) / 2) / columns
    right = (np.arange(columns) + 0.5 - columns / 2) * pixel
    down = (np.arange(rows) + 0.5 - rows / 2) * pixel
    rays = np.stack(np.broadcast_arrays(1.0, right[None, :], down[:, None]), axis=-1)
    world = rays @ axes.T
    ends = []
    for middle, half in boxes.values():
        with np.errstate(divide="ignore", invalid="ignore"):
            sides = (np.array(middle) + np.multiply.outer([-1.0, 1.0], half) - eye)[:, None, None] / world
        enters, leaves = sides.min(axis=0).max(axis=-1), sides.max(axis=0).min(axis=-1)
        ends.append(np.where((enters > 0) & (enters <= leaves), enters, np.inf))
    planar = np.min(ends, axis=0)
    box = np.where(np.isfinite(planar), np.argmin(ends, axis=0), -1)
    return Seen(planar, planar * np.linalg.norm(rays, axis=-1), box)
