"""What a scenery shows in place of the lane's bodies: trunks where its obstacles stand, a wood's edge for its walls.

The bodies are those of the plain lane. They are what can be touched, and what depth and segmentation show; looks are
for the eye alone, in colour and for the event camera.
"""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from uavaccel.sim.lane.layout import LaneLayout

LOOKS_GROUP, BODIES_GROUP = 4, 5  # seen in colour alone, and in all but colour; other groups are seen in both
TRUNK_RATIO = 1.25  # a trunk's radius over a square post's half side: between its sides and its corners


def put_on_looks(model: mujoco.MjModel, obstacles: NDArray[np.int64], layout: LaneLayout) -> None:
    """Let the looks of a scenery's model follow its bodies, which have been laid out; the plain lane has none.

    `obstacles`: geoms of the layout's obstacles, in its order.
    """
    trunks = named(model, "trunk_")
    if not len(trunks):
        return
    used, meshes = trunks[: len(obstacles)], _trunk_meshes(model, layout)
    model.geom_rgba[trunks] = (0.5, 0.5, 0.5, 0.0)  # MuJoCo's default lets the material's colour through
    model.geom_rgba[used, 3] = 1.0
    model.geom_dataid[used], model.geom_matid[used] = meshes, model.geom_matid[obstacles]
    model.geom_sameframe[used] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE  # else their turn goes unnoticed
    away_from_sun = np.array(
        [np.cos(layout.sun_azimuth_rad / 2), 0.0, 0.0, -np.sin(layout.sun_azimuth_rad / 2)]
    )
    for geom, mesh, obstacle in zip(used, meshes, obstacles, strict=True):
        _place(model, geom, mesh, model.geom_pos[obstacle, :2], away_from_sun)
    for side in ("west", "east"):
        model.geom(f"edge_{side}").matid = model.geom(f"wall_{side}").matid


def _trunk_meshes(model: mujoco.MjModel, layout: LaneLayout) -> NDArray[np.int64]:
    """For each obstacle the trunk that is nearest to it in size."""
    meshes = [mesh for mesh in range(model.nmesh) if model.mesh(mesh).name.startswith("trunk_")]
    radii_m = model.numeric("trunk_radii_m").data
    wanted = layout.half_width_m * np.where(layout.round, 1.0, TRUNK_RATIO)
    nearest = np.abs(np.log(wanted[:, None] / radii_m)).argmin(axis=1)
    chosen: NDArray[np.int64] = np.array(meshes)[nearest]
    return chosen


def _place(
    model: mujoco.MjModel, geom: int, mesh: int, place_m: NDArray[np.float64], turn: NDArray[np.float64]
) -> None:
    """Put a mesh's own origin somewhere on the ground: MuJoCo keeps meshes in the frame of their inertia."""
    mujoco.mju_rotVecQuat(model.geom_pos[geom], model.mesh_pos[mesh], turn)
    model.geom_pos[geom, :2] += place_m
    mujoco.mju_mulQuat(model.geom_quat[geom], turn, model.mesh_quat[mesh])


def named(model: mujoco.MjModel, beginning: str) -> NDArray[np.int64]:
    """Ids of the geoms whose names begin so, in the order of their names."""
    names = [model.geom(geom).name for geom in range(model.ngeom)]
    return np.array([geom for geom, name in enumerate(names) if name.startswith(beginning)], int)
