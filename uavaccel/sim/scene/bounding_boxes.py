"""MuJoCo's bounding-volume tree of the world body, refitted to geoms that were moved: it is built only once."""

from __future__ import annotations

from collections.abc import Collection

import mujoco
import numpy as np
from numpy.typing import NDArray


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
            boxes[node] = _box(model, geom)


def _box(model: mujoco.MjModel, geom: int) -> NDArray[np.float64]:
    """Middle and half sizes (6,) of a geom along the axes of its body."""
    flat, own = np.empty(9), model.geom_aabb[geom]
    mujoco.mju_quat2Mat(flat, model.geom_quat[geom])
    turn = flat.reshape(3, 3)
    return np.concatenate([model.geom_pos[geom] + turn @ own[:3], np.abs(turn) @ own[3:]])
