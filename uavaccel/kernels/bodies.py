"""Collision geometry read from a scene's MuJoCo model: the vehicle's hull and the solids around it.

Upright boxes, cylinders and planes are solids; a model with anything else is read as a `Scene`.
"""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from uavaccel.errors import UserError
from uavaccel.kernels.clutter_worlds import put_clutter
from uavaccel.kernels.fields import BOX, CYLINDER, PLANE
from uavaccel.kernels.lanes import Games
from uavaccel.kernels.scene import GEOM, Scene
from uavaccel.kernels.still import read_scene, touchable
from uavaccel.kernels.touching import SOLID_FIELDS
from uavaccel.sim.clutter import ClutterLayout
from uavaccel.sim.lane import MAX_OBSTACLES, OBSTACLE_HALF_HEIGHT_M, LaneLayout, named, object_name, obstacle_geoms
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

    scene: Scene | None = None
    """A scene of one world in place of solids; with clutter, what all games have of it."""

    @property
    def most(self) -> int:
        """Largest number of solids in a lane."""
        return len(self.fixed) + len(self.obstacle_names)

    def name_of(self, solid: int, obstacles: int) -> str:
        """Return the name of a solid of a lane with this number of obstacles."""
        return self.obstacle_names[solid] if solid < obstacles else self.names[solid - obstacles]

    def put(self, layout: LaneLayout | ClutterLayout | None, games: Games, row: int) -> int:
        """Fill a game's solids, obstacles first, or its world, and return the number of things around."""
        if isinstance(layout, ClutterLayout):
            put_clutter(layout.rows, games.solids, games.scenes, row)
        if self.scene is not None or isinstance(layout, ClutterLayout):
            return len(self.names)
        solids = games.solids[row]
        count = 0 if layout is None else len(layout)
        if layout is not None:
            half, tall = layout.half_width_m, OBSTACLE_HALF_HEIGHT_M
            solids[:count, 0], solids[:count, 1], solids[:count, 2] = layout.x_m, -layout.y_m, tall
            solids[:count, 3] = solids[:count, 4] = half
            solids[:count, 5], solids[:count, 6] = tall, np.where(layout.round, CYLINDER, BOX)
        solids[count : count + len(self.fixed)] = self.fixed
        return count + len(self.fixed)


def read_surroundings(model: mujoco.MjModel) -> Surroundings:
    """Read a model's collision geometry. Raises UserError for moving bodies, and as `read_scene` does."""
    vehicle, obstacles = model.body(BODY).id, obstacle_geoms(model)
    if np.any(~np.isin(model.body_weldid, (0, vehicle))):
        raise UserError("simulator = kernels: flies one vehicle among things that stand still; use mujoco")
    colliding = (model.geom_contype | model.geom_conaffinity) > 0
    (hull,) = np.flatnonzero(colliding & (model.geom_bodyid == vehicle))
    radius, half_height = model.geom_size[hull, :2]
    measures = np.array([radius, half_height, np.linalg.norm(model.geom_pos[hull]) + model.geom_rbound[hull]])
    still, clutter = touchable(model), named(model, "clutter_")
    if len(clutter):
        scene = read_scene(model, geoms=np.setdiff1d(still, clutter))
        names = tuple(object_name(model, int(geom)) for geom in (*scene.shapes[0, :, GEOM], *clutter))
        return Surroundings(np.zeros((0, SOLID_FIELDS)), names, (), measures, scene)
    fixed = np.setdiff1d(still, obstacles)
    solids = [_solid(model, geom) for geom in fixed.tolist()]
    if any(solid is None for solid in solids):
        scene = read_scene(model, geoms=still)
        names = tuple(object_name(model, int(geom)) for geom in scene.shapes[0, :, GEOM])
        return Surroundings(np.zeros((0, SOLID_FIELDS)), names, (), measures, scene)
    return Surroundings(
        np.array(solids).reshape(-1, SOLID_FIELDS),
        tuple(object_name(model, geom) for geom in fixed.tolist()),
        tuple(object_name(model, int(geom)) for geom in obstacles[:MAX_OBSTACLES]),
        measures,
    )


def _solid(model: mujoco.MjModel, geom: int) -> NDArray[np.float64] | None:
    """Return a geom as a solid, None for one that is no upright box, cylinder or plane of the world itself."""
    kind = KINDS.get(int(model.geom_type[geom]))
    if kind is None or tuple(model.geom_quat[geom]) != UPRIGHT or model.geom_bodyid[geom] != 0:
        return None
    size = model.geom_size[geom].copy()
    if kind == CYLINDER:
        size = np.array([size[0], size[0], size[1]])
    return np.array([*model.geom_pos[geom], *size, kind])
