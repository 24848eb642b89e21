"""Poses, positions and attitudes in NED or FRD, their composition, and the limits of where a vehicle can be."""

from __future__ import annotations

import math
from collections.abc import Container, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uavaccel.errors import UserError
from uavaccel.kinematics import Quaternion, Vector
from uavaccel.units import mujoco_to_ned, quaternion_mujoco_to_ned

LEVEL: Quaternion = (1.0, 0.0, 0.0, 0.0)
HERE: Vector = (0.0, 0.0, 0.0)


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


def from_mujoco(position_m: NDArray[np.float64], quaternion: NDArray[np.float64]) -> Pose:
    """Return the pose, NED, of a position (3,) and a quaternion (4,) as MuJoCo has them."""
    x, y, z = mujoco_to_ned(position_m).tolist()
    w, i, j, k = quaternion_mujoco_to_ned(quaternion).tolist()
    return Pose((x, y, z), (w, i, j, k))


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


HIGHEST_M = 20_000.0  # above the sea, up to which air_density follows the standard atmosphere
FARTHEST_M = 10_000.0  # north or east: farther away the physics loses its millimetres
STRONGEST_WIND_M_S = 100.0  # in a storm of 1 000 m/s a tick's drag exceeds the speed that it brakes
DEEPEST_M = 0.05  # of penetration; contacts would throw a vehicle that is placed deeper
LONGEST_NAME = 256
APART_M = 0.75  # between the middles of two vehicles, so that they do not touch


def check_bounds(position_m: Vector, ground_altitude_m: float, anywhere: bool = False) -> None:
    """Raise UserError for an NED position that is too high, too far away or, unless `anywhere`, below the ground."""
    x_m, y_m, z_m = position_m
    top_m = ground_altitude_m - HIGHEST_M
    if not top_m <= z_m <= (FARTHEST_M if anywhere else 0.0):
        raise UserError(f"position: NED z has to be from {top_m:g} (thin air) to 0 m (the ground), not {z_m:g}")
    if not max(abs(x_m), abs(y_m)) <= FARTHEST_M:
        raise UserError(f"position: north and east have to be within {FARTHEST_M:g} m, not {x_m:g} and {y_m:g} m")


def check_wind(wind_m_s: Vector) -> None:
    """Raise ValueError for a wind above STRONGEST_WIND_M_S, or one that is not finite."""
    if not (speed := math.hypot(*wind_m_s)) <= STRONGEST_WIND_M_S:
        raise ValueError(f"wind must be at most {STRONGEST_WIND_M_S:g} m/s, not {speed:g}")


def check_name(name: str, taken: Container[str] = (), kind: str = "a vehicle") -> None:
    """Raise UserError for a name that is taken, or that is not possible in a model, a file name or a line of text."""
    if name in taken or "/" in name or not name.isprintable() or not 0 < len(name) <= LONGEST_NAME:
        raise UserError(
            f"{kind} cannot be called {name[:LONGEST_NAME]!r}: names differ, hold no / and nothing unprintable, "
            f"and have at most {LONGEST_NAME} characters"
        )


def check_apart(name: str, position_m: Vector, places: Mapping[str, Vector]) -> None:
    """Raise UserError for a position too close to another vehicle's; `places` are positions by name."""
    for other, place_m in places.items():
        if math.dist(position_m, place_m) < APART_M:
            raise UserError(f"{name} would start less than {APART_M:g} m from {other}")
