"""Ray casting in a scene, NED: the first geom hit, its distance and its surface normal."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from uavaccel.units import mujoco_to_ned, ned_to_mujoco

NEAR_END_M = 1e-3
# Those of depth pictures: neither the vehicles' hulls nor looks.
_GROUPS = np.array([1, 1, 1, 0, 0, 1], np.uint8)


class Hits(NamedTuple):
    """Hits of n rays: metres (n,), inf for none; geoms (n,), -1 for none; outward normals (n, 3), NED."""

    distance_m: NDArray[np.float64]
    geoms: NDArray[np.int32]
    normals: NDArray[np.float64]


def cast(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    start_m: ArrayLike,
    directions: NDArray[np.float64],
    longest_m: float = np.inf,
    *,
    exclude: str | None,
) -> Hits:
    """Cast rays from a position along unit vectors (n, 3), through the body `exclude`, if any."""
    mujoco.mj_kinematics(model, data)  # mj_step leaves the positions of the step's beginning
    count = len(directions)
    geoms, distance_m, normals = np.full(count, -1, np.int32), np.full(count, -1.0), np.zeros((count, 3))
    cutoff = min(longest_m, mujoco.mjMAXVAL)
    mujoco.mj_multiRay(
        model,
        data,
        ned_to_mujoco(start_m),
        ned_to_mujoco(directions).ravel(),
        _GROUPS,
        True,
        -1 if exclude is None else model.body(exclude).id,
        geoms,
        distance_m,
        normals.reshape(-1),
        count,
        cutoff,
    )
    missed = (geoms < 0) | (distance_m < 0) | (distance_m > longest_m)
    distance_m[missed], geoms[missed] = np.inf, -1
    return Hits(distance_m, geoms, mujoco_to_ned(normals))


def sees(model: mujoco.MjModel, data: mujoco.MjData, start_m: ArrayLike, end_m: ArrayLike, *, exclude: str) -> bool:
    """Return whether only the body `exclude` is between two positions, except for what touches the second."""
    way = np.asarray(end_m, float) - np.asarray(start_m, float)
    length_m = float(np.linalg.norm(way))
    if length_m <= NEAR_END_M:
        return True
    hits = cast(model, data, start_m, (way / length_m)[None], length_m - NEAR_END_M, exclude=exclude)
    return bool(np.isinf(hits.distance_m[0]))
