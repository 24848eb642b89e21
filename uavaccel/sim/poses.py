"""Poses, a position and an attitude in NED or FRD, and their composition."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uavaccel.kinematics import Quaternion, Vector

LEVEL: Quaternion = (1.0, 0.0, 0.0, 0.0)


class Pose(NamedTuple):
    """A position in metres and a unit wxyz quaternion, relative to an outer frame."""

    position_m: Vector = (0.0, 0.0, 0.0)
    orientation_wxyz: Quaternion = LEVEL

    def of(self, inner: Pose) -> Pose:
        """Return `inner`, a pose in this pose's frame, in the outer frame."""
        turned = self.matrix() @ np.array(inner.position_m)
        x, y, z = (float(value) for value in np.array(self.position_m) + turned)
        return Pose((x, y, z), multiply(self.orientation_wxyz, inner.orientation_wxyz))

    def matrix(self) -> NDArray[np.float64]:
        """Return the rotation matrix (3, 3), whose columns are forward, right and down."""
        w, x, y, z = self.orientation_wxyz
        return np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        )

    def inwards(self, points_m: ArrayLike) -> NDArray[np.float64]:
        """Return points (..., 3) of the outer frame in this pose's frame."""
        return np.asarray((np.asarray(points_m) - np.array(self.position_m)) @ self.matrix())

    def inwards_pose(self, other: Pose) -> Pose:
        """Return a pose of the outer frame in this pose's frame: the inverse of `of`."""
        w, x, y, z = self.orientation_wxyz
        place_x, place_y, place_z = (float(value) for value in self.inwards(other.position_m))
        return Pose((place_x, place_y, place_z), multiply((w, -x, -y, -z), other.orientation_wxyz))


def multiply(a: Quaternion, b: Quaternion) -> Quaternion:
    """Return the rotation by `b` followed by `a`, wxyz."""
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


def from_degrees(roll: float, pitch: float, yaw: float) -> Quaternion:
    """Return the attitude rotated by yaw, then pitch, then roll: AirSim's toQuaternion."""
    turns = [(math.cos(math.radians(a) / 2), math.sin(math.radians(a) / 2)) for a in (roll, pitch, yaw)]
    (cr, sr), (cp, sp), (cy, sy) = turns
    return multiply(multiply((cy, 0.0, 0.0, sy), (cp, 0.0, sp, 0.0)), (cr, sr, 0.0, 0.0))
