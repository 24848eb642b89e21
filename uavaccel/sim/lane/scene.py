"""Applies a lane layout to the MuJoCo scene assets/mjcf/lane.xml, and names what the drone has hit.

Obstacles are geoms of the world body, moved in place: a new lane needs neither a new model nor a new GL context. As
bodies of their own they would raise the cost of a physics step from 2 µs to 12 µs or more. MuJoCo finds contacts
through a bounding-volume tree that it builds only once, so that tree is refitted.

A scenery has looks in place of the lane's bodies: trunks for its obstacles, a forest edge for its walls. The bodies are
those of the plain lane, and contacts, depth and segmentation use them; looks are seen only in colour and by the event
camera.
"""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from uavaccel.errors import UserError
from uavaccel.sim.lane.layout import GROUND_TEXTURES, OBSTACLE_TEXTURES, WALL_TEXTURES, LaneLayout
from uavaccel.sim.scene.model import refit_bounding_boxes
from uavaccel.units import ned_to_mujoco

OBSTACLE_HALF_HEIGHT_M = 10.0
PARKED_Z_M = 100.0  # NED: below the ground, out of reach and out of sight
SUN_ELEVATION_RAD = 0.9
DAYLIGHT = 0.65  # the sun's share of full daylight; AMBIENT is that of the sky
AMBIENT = 0.45
APPEARANCE_GROUP, BODIES_GROUP = 4, 5  # visible only in colour, and in all but colour; other groups always are
TRUNK_RATIO = 1.25  # a trunk's radius over a square post's half side: between its sides and its corners


def apply_layout(model: mujoco.MjModel, data: mujoco.MjData, layout: LaneLayout) -> None:
    """Move the scene's obstacles and set its textures and light, in place.

    Raises UserError if the scene has fewer obstacles than the layout, as all scenes but the lane do.
    """
    geoms = obstacle_geoms(model)
    if len(layout) > len(geoms):
        raise UserError(f"the layout has {len(layout)} obstacles, the scene {len(geoms)}: leave some out")
    used, parked = geoms[: len(layout)], geoms[len(layout) :]
    _set_shapes(model, used, layout)
    _set_positions(model, used, layout.x_m, layout.y_m)
    _set_positions(model, parked, model.geom_pos[parked, 0], np.zeros(len(parked)), z_m=PARKED_Z_M)
    model.geom_rgba[used] = (0.5, 0.5, 0.5, 1.0)  # MuJoCo's default, which lets the material's colour through
    model.geom_rgba[parked, 3] = 0.0  # not drawn
    _set_materials(model, used, layout)
    _set_light(model, layout)
    set_appearance(model, used, layout)
    refit_bounding_boxes(model, set(geoms.tolist()))
    mujoco.mj_kinematics(model, data)


def obstacle_geoms(model: mujoco.MjModel) -> NDArray[np.int64]:
    """Return the ids of the geoms that a layout moves, in order of their names; empty in other scenes."""
    return named(model, "obstacle_")


def _set_shapes(model: mujoco.MjModel, geoms: NDArray[np.int64], layout: LaneLayout) -> None:
    half, tall = layout.half_width_m, np.full(len(layout), OBSTACLE_HALF_HEIGHT_M)
    box, cylinder = int(mujoco.mjtGeom.mjGEOM_BOX), int(mujoco.mjtGeom.mjGEOM_CYLINDER)
    model.geom_type[geoms] = np.where(layout.round, cylinder, box)
    model.geom_size[geoms] = np.stack([half, np.where(layout.round, tall, half), tall], axis=1)
    model.geom_aabb[geoms, 3:] = np.stack([half, half, tall], axis=1)
    model.geom_rbound[geoms] = np.sqrt(half**2 * np.where(layout.round, 1, 2) + tall**2)


def _set_positions(
    model: mujoco.MjModel,
    geoms: NDArray[np.int64],
    x_m: NDArray[np.float64],
    y_m: NDArray[np.float64],
    z_m: float = -OBSTACLE_HALF_HEIGHT_M,
) -> None:
    model.geom_pos[geoms] = ned_to_mujoco(np.stack([x_m, y_m, np.full(len(geoms), z_m)], axis=1))


def _set_materials(model: mujoco.MjModel, geoms: NDArray[np.int64], layout: LaneLayout) -> None:
    materials = np.array([model.material(f"obstacle_{name}").id for name in OBSTACLE_TEXTURES])
    model.geom_matid[geoms] = materials[layout.texture]
    for wall in ("wall_west", "wall_east"):
        model.geom(wall).matid = model.material(f"wall_{WALL_TEXTURES[layout.wall_texture]}").id
    model.geom("ground").matid = model.material(f"ground_{GROUND_TEXTURES[layout.ground_texture]}").id


def _set_light(model: mujoco.MjModel, layout: LaneLayout) -> None:
    sun = model.light("sun")
    sun.dir, sun.ambient, sun.diffuse = sunlight(layout)


def sunlight(layout: LaneLayout) -> tuple[NDArray[np.float64], float, float]:
    """Return a lane's light: the sun's direction in MuJoCo's axes, the ambient and the diffuse level."""
    level, azimuth = np.cos(SUN_ELEVATION_RAD), layout.sun_azimuth_rad
    direction = [level * np.cos(azimuth), level * np.sin(azimuth), np.sin(SUN_ELEVATION_RAD)]
    return ned_to_mujoco(direction), layout.light * AMBIENT, layout.light * DAYLIGHT


def object_name(model: mujoco.MjModel, geom: int) -> str:
    """Return the name of a geom or, if it has none, of its body; "" for -1, the sky."""
    if geom < 0:
        return ""
    return str(model.geom(geom).name or model.body(int(model.geom_bodyid[geom])).name)


def set_appearance(model: mujoco.MjModel, obstacles: NDArray[np.int64], layout: LaneLayout) -> None:
    """Let the looks of a scenery's model follow its bodies, which have been placed; the plain lane has none.

    `obstacles` are the geoms of the layout's obstacles, in its order.
    """
    trunks = named(model, "trunk_")
    if not len(trunks):
        return
    used, meshes = trunks[: len(obstacles)], _trunk_meshes(model, layout)
    model.geom_rgba[trunks] = (0.5, 0.5, 0.5, 0.0)  # MuJoCo's default lets the material's colour through
    model.geom_rgba[used, 3] = 1.0
    model.geom_dataid[used], model.geom_matid[used] = meshes, model.geom_matid[obstacles]
    model.geom_sameframe[used] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE  # else their turn goes unnoticed
    away_from_sun = np.array([np.cos(layout.sun_azimuth_rad / 2), 0.0, 0.0, -np.sin(layout.sun_azimuth_rad / 2)])
    for geom, mesh, obstacle in zip(used, meshes, obstacles, strict=True):
        _place(model, geom, mesh, model.geom_pos[obstacle, :2], away_from_sun)
    for side in ("west", "east"):
        model.geom(f"edge_{side}").matid = model.geom(f"wall_{side}").matid


def _trunk_meshes(model: mujoco.MjModel, layout: LaneLayout) -> NDArray[np.int64]:
    """Return the mesh of the trunk nearest in size to each obstacle."""
    meshes = [mesh for mesh in range(model.nmesh) if model.mesh(mesh).name.startswith("trunk_")]
    radii_m = model.numeric("trunk_radii_m").data
    wanted = layout.half_width_m * np.where(layout.round, 1.0, TRUNK_RATIO)
    nearest = np.abs(np.log(wanted[:, None] / radii_m)).argmin(axis=1)
    chosen: NDArray[np.int64] = np.array(meshes)[nearest]
    return chosen


def _place(
    model: mujoco.MjModel, geom: int, mesh: int, place_m: NDArray[np.float64], turn: NDArray[np.float64]
) -> None:
    """Place a mesh's origin on the ground; MuJoCo stores meshes in the frame of their inertia."""
    mujoco.mju_rotVecQuat(model.geom_pos[geom], model.mesh_pos[mesh], turn)
    model.geom_pos[geom, :2] += place_m
    mujoco.mju_mulQuat(model.geom_quat[geom], turn, model.mesh_quat[mesh])


def named(model: mujoco.MjModel, beginning: str) -> NDArray[np.int64]:
    """Return the ids of the geoms whose names have that beginning, in order of their names."""
    names = [model.geom(geom).name for geom in range(model.ngeom)]
    return np.array([geom for geom, name in enumerate(names) if name.startswith(beginning)], int)
