"""Places the shapes of a layout in the MuJoCo scene assets/mjcf/clutter.xml, as sim/lane/scene does a lane's."""

from __future__ import annotations

import mujoco
import numpy as np

from uavaccel.errors import UserError
from uavaccel.sim.clutter.layout import (
    BOX,
    CAPSULE,
    COS,
    CYLINDER,
    ELLIPSOID,
    GREY,
    HALF_X,
    HALF_Y,
    HALF_Z,
    KIND,
    PARKED_Z_M,
    SIN,
    ClutterLayout,
    X,
    Z,
)  # fmt: skip
from uavaccel.sim.lane.scene import named
from uavaccel.sim.scene.model import refit_bounding_boxes

GEOMS = {
    BOX: mujoco.mjtGeom.mjGEOM_BOX,
    CYLINDER: mujoco.mjtGeom.mjGEOM_CYLINDER,
    ELLIPSOID: mujoco.mjtGeom.mjGEOM_ELLIPSOID,
    CAPSULE: mujoco.mjtGeom.mjGEOM_SPHERE,
}


def apply_clutter(model: mujoco.MjModel, data: mujoco.MjData, layout: ClutterLayout) -> None:
    """Place the layout's shapes in the scene. Raises UserError if the scene has fewer, as all but the clutter do."""
    geoms, rows = named(model, "clutter_"), layout.rows
    if len(rows) > len(geoms):
        raise UserError(f"the clutter has {len(rows)} shapes, the scene {len(geoms)}: leave some out")
    used = geoms[: len(rows)]
    model.geom_pos[geoms, 2], model.geom_rgba[geoms, 3] = PARKED_Z_M, 0.0  # not drawn
    half, kind = rows[:, [HALF_X, HALF_Y, HALF_Z]], rows[:, KIND]
    round_, upright = kind == CAPSULE, kind == CYLINDER
    model.geom_type[used] = [int(GEOMS[int(each)]) for each in kind]
    boxes = np.where(round_[:, None], half[:, :1], half)
    model.geom_aabb[used, :3], model.geom_aabb[used, 3:] = 0.0, boxes
    model.geom_size[used] = np.where(upright[:, None], half[:, [0, 2, 2]], half)
    model.geom_size[used[round_], 1:] = 0.0
    model.geom_size[used[upright], 2] = 0.0
    across = np.where(kind == BOX, np.hypot(half[:, 0], half[:, 1]), np.maximum(half[:, 0], half[:, 1]))
    bound = np.where(kind == ELLIPSOID, np.maximum(across, half[:, 2]), np.hypot(across, half[:, 2]))
    model.geom_rbound[used] = bound
    model.geom_pos[used] = rows[:, X : Z + 1]
    cosine, sine = rows[:, COS], rows[:, SIN]
    along = np.sqrt((1.0 + cosine) / 2.0)  # the cosine of half the yaw, which is at most an eighth of a turn
    model.geom_quat[used] = np.stack([along, 0 * sine, 0 * sine, sine / (2.0 * along)], axis=1)
    model.geom_sameframe[used] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE  # else their turn goes unnoticed
    model.geom_rgba[used] = np.stack([*[rows[:, GREY]] * 3, layout.standing * 1.0], axis=1)
    refit_bounding_boxes(model, set(geoms.tolist()))
    mujoco.mj_kinematics(model, data)
