"""MuJoCo's bounding-volume tree of the world body, refitted to geoms that were moved: it is built only once."""

from __future__ import annotations

from collections.abc import Collection

import mujoco
import numpy as np


def refit_bounding_boxes(model: mujoco.MjModel, moved: Collection[int]) -> None:
    """Refit the world body's tree to the geoms `moved`; nodes precede their children, so from last to first."""
    first, count = int(model.body_bvhadr[0]), int(model.body_bvhnum[0])
    boxes, children = model.bvh_aabb[first:], model.bvh_child[first:]
    for node in reversed(range(count)):
        geom = int(model.bvh_nodeid[first + node])
        if geom < 0:
            low = (boxes[children[node], :3] - boxes[children[node], 3:]).min(axis=0)
            high = (boxes[children[node], :3] + boxes[children[node], 3:]).max(axis=0)
            boxes[node] = np.concatenate([(low + high) / 2, (high - low) / 2])
        elif geom in moved:
            boxes[node] = np.concatenate([model.geom_pos[geom], _half_extents(model, geom)])


def _half_extents(model: mujoco.MjModel, geom: int) -> np.ndarray:
    """Half sizes (3,) of a geom along the axes of its body."""
    turn = np.empty(9)
    mujoco.mju_quat2Mat(turn, model.geom_quat[geom])
    return np.asarray(np.abs(turn.reshape(3, 3)) @ model.geom_aabb[geom, 3:])
