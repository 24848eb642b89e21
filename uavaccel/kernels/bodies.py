"""Collision geometry read from a scene's MuJoCo model: the vehicle's hull and the solids around it."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from uavaccel.errors import UserError
from uavaccel.kernels.fields import BOX, CYLINDER, PLANE
from uavaccel.kernels.touching import SOLID_FIELDS
from uavaccel.sim.lane.layout import MAX_OBSTACLES, LaneLayout
from uavaccel.sim.lane.scene import OBSTACLE_HALF_HEIGHT_M, object_name, obstacle_geoms
from uavaccel.sim.vehicle.vehicle import BODY

KINDS = {
    int(mujoco.mjtGeom.mjGEOM_BOX): BOX,
    int(mujoco.mjtGeom.mjGEOM_CYLINDER): CYLINDER,
    int(mujoco.mjtGeom.mjGEOM_PLANE): PLANE,
}
UPRIGHT = (1.0, 0.0, 0.0, 0.0)


class Surroundings(NamedTuple):
    """The collision geometry of a scene, without a lane's layout."""

    fixed: NDArray[np.float64]
    """(n, SOLID_FIELDS): solids that every lane has."""
    names: tuple[str, ...]
    """Their names."""
    obstacle_names: tuple[str, ...]
    hull: NDArray[np.float64]
    """(3,): radius, half height, and distance from the body's origin to the hull's farthest point, metres."""

    @property
    def most(self) -> int:
        """Largest number of solids in a lane."""
        return len(self.fixed) + len(self.obstacle_names)

    def name_of(self, solid: int, obstacles: int) -> str:
        """Return the name of a solid of a lane with this number of obstacles."""
        return self.obstacle_names[solid] if solid < obstacles else self.names[solid - obstacles]

    def put(self, layout: LaneLayout | None, solids: NDArray[np.float64]) -> int:
        """Fill the solids (most, SOLID_FIELDS) of a lane, obstacles first, and return their number."""
        count = 0 if layout is None else len(layout)
        if layout is not None:
            half, tall = layout.half_width_m, OBSTACLE_HALF_HEIGHT_M
            solids[:count, 0], solids[:count, 1], solids[:count, 2] = layout.x_m, -layout.y_m, tall
            solids[:count, 3] = solids[:count, 4] = half
            solids[:count, 5], solids[:count, 6] = tall, np.where(layout.round, CYLINDER, BOX)
        solids[count : count + len(self.fixed)] = self.fixed
        return count + len(self.fixed)


def read_surroundings(model: mujoco.MjModel) -> Surroundings:
    """Read a scene's collision geometry. Raises UserError for shapes that the kernels do not know, or moving bodies."""
    touching = (model.geom_contype | model.geom_conaffinity) > 0
    vehicle = model.body(BODY).id
    obstacles = obstacle_geoms(model)
    world = np.flatnonzero(touching & (model.geom_bodyid == 0))
    fixed = [int(geom) for geom in world if geom not in set(obstacles.tolist())]
    if model.nbody != 2:
        raise UserError("simulator = kernels: flies one vehicle among things that stand still; use mujoco")
    (hull,) = np.flatnonzero(touching & (model.geom_bodyid == vehicle))
    radius, half_height = model.geom_size[hull, :2]
    reach = np.linalg.norm(model.geom_pos[hull]) + model.geom_rbound[hull]
    return Surroundings(
        np.array([_solid(model, geom) for geom in fixed]).reshape(-1, SOLID_FIELDS),
        tuple(object_name(model, geom) for geom in fixed),
        tuple(object_name(model, int(geom)) for geom in obstacles[:MAX_OBSTACLES]),
        np.array([radius, half_height, reach]),
    )


def _solid(model: mujoco.MjModel, geom: int) -> NDArray[np.float64]:
    kind = KINDS.get(int(model.geom_type[geom]))
    if kind is None or tuple(model.geom_quat[geom]) != UPRIGHT:
        name = object_name(model, geom)
        raise UserError(f"simulator = kernels: {name} is no upright box, cylinder or plane; use mujoco")
    size = model.geom_size[geom].copy()
    if kind == CYLINDER:
        size = np.array([size[0], size[0], size[1]])
    return np.array([*model.geom_pos[geom], *size, kind])
