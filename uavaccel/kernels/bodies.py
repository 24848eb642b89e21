"""Still geometry read from MuJoCo models: the vehicle's hull, and what stands around it, to touch and to see.

Upright boxes, cylinders and planes are solids of a lane; any other scene is read as a `Scene`, in which every geom that
cannot move is turned as it is.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from uavaccel.errors import UserError
from uavaccel.kernels import scene as at
from uavaccel.kernels.clutter_games import put_clutter
from uavaccel.kernels.fields import BOX, CYLINDER, PLANE
from uavaccel.kernels.lanes import Games
from uavaccel.kernels.scene import GEOM, Scene
from uavaccel.kernels.touching import SOLID_FIELDS
from uavaccel.sim.clutter import ClutterLayout
from uavaccel.sim.lane import (
    APPEARANCE_GROUP,
    BODIES_GROUP,
    MAX_OBSTACLES,
    OBSTACLE_HALF_HEIGHT_M,
    LaneLayout,
    named,
    object_name,
    obstacle_geoms,
)
from uavaccel.sim.scene import DRONE_GROUP, QUADROTOR

HIDDEN_GROUP = 3  # of collision geometry
MOST_CELLS = 256 * 256
LEAST_CELL_M = 0.25
MOST_SHARE = 0.25  # of a grid's cells: a shape that covers more is in none of them, but always considered
DEFAULT_RGBA = (0.5, 0.5, 0.5, 1.0)  # of a geom, which lets its material's through

G = mujoco.mjtGeom
KINDS = {
    int(G.mjGEOM_PLANE): at.PLANE,
    int(G.mjGEOM_BOX): at.BOX,
    int(G.mjGEOM_SPHERE): at.CAPSULE,
    int(G.mjGEOM_CAPSULE): at.CAPSULE,
    int(G.mjGEOM_ELLIPSOID): at.ELLIPSOID,
    int(G.mjGEOM_CYLINDER): at.CYLINDER,
    int(G.mjGEOM_MESH): at.HULL,
    int(G.mjGEOM_HFIELD): at.HEIGHTS,
}

Floats = NDArray[np.float64]


def touchable(model: mujoco.MjModel) -> NDArray[np.int64]:
    """Return the still geoms that the vehicle collides with."""
    vehicle = model.body(QUADROTOR).id
    hull = model.geom_bodyid == vehicle
    types, affinities = model.geom_contype, model.geom_conaffinity
    own_type, own_affinity = (int(np.bitwise_or.reduce(bits[hull])) for bits in (types, affinities))
    meets = (types & own_affinity | affinities & own_type) != 0
    excluded = [pair for pair in map(divmod, model.exclude_signature, [1 << 16] * model.nexclude) if vehicle in pair]
    return np.flatnonzero(_still(model) & meets & ~np.isin(model.geom_bodyid, excluded))


def visible(model: mujoco.MjModel, looks: bool = True) -> NDArray[np.int64]:
    """Return the still geoms that cameras see; a scenery's looks stand for bodies unless depth is measured."""
    hidden = (DRONE_GROUP, HIDDEN_GROUP, BODIES_GROUP if looks else APPEARANCE_GROUP)
    return np.flatnonzero(_still(model) & ~np.isin(model.geom_group, hidden) & (worn(model)[:, 3] > 0))


def worn(model: mujoco.MjModel) -> Floats:
    """Return the geoms' colours (n, 4), 0 to 1: their own, or their materials' in place of the default one."""
    colours, material = model.geom_rgba.astype(np.float64), model.geom_matid
    wearing = (material >= 0) & np.all(model.geom_rgba == np.array(DEFAULT_RGBA, np.float32), axis=1)
    colours[wearing] = model.mat_rgba[material[wearing]]
    return colours


def _still(model: mujoco.MjModel) -> NDArray[np.bool_]:
    still: NDArray[np.bool_] = model.body_rootid[model.geom_bodyid] != model.body(QUADROTOR).id
    return still


def read_scene(model: mujoco.MjModel, seen: bool = False, geoms: NDArray[np.int64] | None = None) -> Scene:
    """Read a model's still geoms as a scene of one world: those to touch, or those to be `seen`.

    Raises UserError for kinds of geoms that are none of MuJoCo's solids.
    """
    if geoms is None:
        geoms = visible(model) if seen else touchable(model)
    for geom in geoms.tolist():
        if int(model.geom_type[geom]) not in KINDS:
            raise UserError(f"simulator = kernels: {object_name(model, geom)} is of a kind that only mujoco knows")
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    rows, shared = _rows(model, data, geoms), {"vertices": np.zeros((0, 3)), "heights": np.zeros(0)}
    meshes = rows[:, at.KIND] == at.HULL
    if seen:
        rows = np.concatenate([rows[~meshes], *(_triangles(model, row) for row in rows[meshes])])
    else:
        shared["vertices"] = _take_hulls(model, rows, meshes)
    shared["heights"] = _take_heights(model, rows)
    return _scene(rows, shared, np.float32 if seen else np.float64)


def _rows(model: mujoco.MjModel, data: mujoco.MjData, geoms: NDArray[np.int64]) -> Floats:
    """Return shapes (n, SHAPE_FIELDS), meshes as HULL without vertices; DATA holds the geom's data for now."""
    rows = np.zeros((len(geoms), at.SHAPE_FIELDS))
    rows[:, at.KIND] = [KINDS[kind] for kind in model.geom_type[geoms].tolist()]
    rows[:, at.BOUND], rows[:, at.CENTRE : at.AXES] = model.geom_rbound[geoms], data.geom_xpos[geoms]
    rows[:, at.AXES : at.HALF] = data.geom_xmat[geoms]
    flat = np.isin(rows[:, at.KIND], (at.PLANE, at.BOX))
    rows[:, at.RGB : at.DATA], rows[:, at.GEOM] = _colours(model, geoms, flat), geoms
    rows[:, at.MATERIAL] = model.geom_matid[geoms]
    rows[:, at.DATA] = model.geom_dataid[geoms]
    kinds, sizes = rows[:, at.KIND], model.geom_size[geoms]
    half = sizes.copy()
    round_ = (kinds == at.CYLINDER) | (kinds == at.CAPSULE)
    half[round_] = sizes[round_][:, [0, 0, 1]]
    half[model.geom_type[geoms] == G.mjGEOM_SPHERE, 2] = 0.0
    mesh = kinds == at.HULL
    half[mesh] = model.geom_aabb[geoms[mesh], 3:]
    middle = model.geom_aabb[geoms[mesh], :3]
    axes = rows[mesh, at.AXES : at.HALF].reshape(-1, 3, 3)
    rows[mesh, at.CENTRE : at.AXES] += np.einsum("nij,nj->ni", axes, middle)
    rows[mesh, at.BOUND] = np.linalg.norm(half[mesh], axis=1)
    rows[np.isin(kinds, (at.PLANE, at.HEIGHTS)), at.BOUND] = at.UNBOUNDED
    rows[:, at.HALF : at.RGB] = half
    return rows


def _colours(model: mujoco.MjModel, geoms: NDArray[np.int64], flat: NDArray[np.bool_]) -> Floats:
    """Return the geoms' colours (n, 3), 0 to 1, times their textures' means, except on `flat` ones, which show them."""
    means, colours = np.ones((model.nmat, 3)), worn(model)[geoms, :3]
    for material in range(model.nmat):
        texture = int(model.mat_texid[material, mujoco.mjtTextureRole.mjTEXROLE_RGB])
        if texture >= 0 and model.tex_nchannel[texture] >= 3:
            channels = int(model.tex_nchannel[texture])
            size, first = int(model.tex_width[texture] * model.tex_height[texture]), int(model.tex_adr[texture])
            texels = model.tex_data[first : first + size * channels].reshape(size, channels)
            means[material] = texels[:, :3].mean(axis=0) / 255
    material = model.geom_matid[geoms]
    averaged = (material >= 0) & ~flat
    colours[averaged] *= means[material[averaged]]
    return colours


def _take_hulls(model: mujoco.MjModel, rows: Floats, meshes: NDArray[np.bool_]) -> Floats:
    """Return the vertices (v, 3) of the meshes' convex hulls, and let the shapes refer to them."""
    vertices: list[Floats] = [np.zeros((0, 3))]
    known: dict[int, tuple[int, int]] = {}
    for row in np.flatnonzero(meshes):
        mesh = int(rows[row, at.DATA])
        if mesh not in known:
            first, graph = int(model.mesh_vertadr[mesh]), int(model.mesh_graphadr[mesh])
            own = np.arange(int(model.mesh_vertnum[mesh]))
            if graph >= 0:  # of whose vertices these are the convex hull's
                count = int(model.mesh_graph[graph])
                own = np.asarray(model.mesh_graph[graph + 2 + count : graph + 2 + 2 * count], np.int64)
            corners = model.mesh_vert[first + own] - model.geom_aabb[int(rows[row, at.GEOM]), :3]
            known[mesh] = sum(map(len, vertices)), len(corners)
            vertices.append(corners)
        first, count = known[mesh]
        rows[row, at.DATA], rows[row, at.COUNT] = first, count
        rows[row, at.BOUND] = np.linalg.norm(np.concatenate(vertices)[first : first + count], axis=1).max()
    return np.concatenate(vertices)


def _triangles(model: mujoco.MjModel, mesh_row: Floats) -> Floats:
    """Return the triangles (n, SHAPE_FIELDS) of a mesh."""
    mesh, geom = int(mesh_row[at.DATA]), int(mesh_row[at.GEOM])
    first, count = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
    own = model.mesh_vert[model.mesh_face[first : first + count] + model.mesh_vertadr[mesh]]
    axes = mesh_row[at.AXES : at.HALF].reshape(3, 3)
    corners = (own - model.geom_aabb[geom, :3]) @ axes.T + mesh_row[at.CENTRE : at.AXES]
    middle = (corners.min(axis=1) + corners.max(axis=1)) / 2
    rows = np.repeat(mesh_row[None], count, axis=0)
    rows[:, at.KIND], rows[:, at.CENTRE : at.AXES] = at.TRIANGLE, middle
    rows[:, at.BOUND] = np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1)
    rows[:, at.AXES : at.AXES + 3] = corners[:, 0] - middle
    rows[:, at.AXES + 3 : at.AXES + 6] = corners[:, 1] - corners[:, 0]
    rows[:, at.AXES + 6 : at.HALF] = corners[:, 2] - corners[:, 0]
    return rows


def _take_heights(model: mujoco.MjModel, rows: Floats) -> Floats:
    """Return the heights of all height fields, m, and let the shapes refer to them."""
    heights: list[Floats] = [np.zeros(0)]
    for row in np.flatnonzero(rows[:, at.KIND] == at.HEIGHTS):
        field = int(rows[row, at.DATA])
        columns, lines = int(model.hfield_ncol[field]), int(model.hfield_nrow[field])
        first, (*wide, tall, base) = int(model.hfield_adr[field]), model.hfield_size[field]
        rows[row, at.DATA], rows[row, at.COUNT] = sum(map(len, heights)), columns
        rows[row, at.LINES], rows[row, at.BASE] = lines, base
        heights.append(model.hfield_data[first : first + columns * lines] * tall)
        rows[row, at.HALF : at.RGB] = *wide, heights[-1].max()
    return np.concatenate(heights)


def _scene(rows: Floats, shared: dict[str, Floats], kind: Any) -> Scene:
    """Lay out a grid, and list the shapes in its cells."""
    reach = _spreads(rows)
    upright, half = np.abs(rows[:, at.AXES + 8]) == 1.0, rows[:, at.HALF : at.RGB]
    round_ = np.isin(rows[:, at.KIND], (at.CYLINDER, at.CAPSULE, at.ELLIPSOID))
    wide = np.where(upright & round_, half[:, :2].max(axis=1), np.hypot(reach[:, 0], reach[:, 1]))
    rows[:, at.REACH] = np.minimum(wide, rows[:, at.BOUND]) + at.LISTING_MARGIN_M
    beside = np.isin(rows[:, at.KIND], (at.PLANE, at.HEIGHTS))
    frame = _frame(rows[~beside], reach[~beside])
    cells = np.prod(np.minimum(2 * reach[:, :2] / frame[at.CELL] + 1, frame[[at.COLUMNS, at.ROWS]]), axis=1)
    beside |= cells > MOST_SHARE * frame[at.COLUMNS] * frame[at.ROWS] + 1
    order = np.argsort(~beside, kind="stable")
    frame[at.LOOSE], frame[at.SHAPES] = beside.sum(), len(rows)
    entries = int(cells[~beside].sum()) + 4 * len(rows)
    start = np.zeros((1, int(frame[at.COLUMNS] * frame[at.ROWS]) + 1), np.int32)
    scene = Scene(
        rows[order][None].astype(kind),
        start,
        np.zeros((1, entries), np.int32),
        frame[None].astype(kind),
        shared["vertices"].astype(kind),
        shared["heights"].astype(kind),
    )
    needed = int(at.list_world(scene, 0))
    return scene._replace(items=scene.items[:, :needed].copy())


def _spreads(rows: Floats) -> Floats:
    """Return `scene.spread_along` of every shape (n, 3); of planes and height fields a bound."""
    half, axes = rows[:, at.HALF : at.RGB], rows[:, at.AXES : at.HALF].reshape(-1, 3, 3)
    reach: Floats = np.einsum("nij,nj->ni", np.abs(axes), half)
    reach[rows[:, at.KIND] == at.CAPSULE] += rows[rows[:, at.KIND] == at.CAPSULE, at.HALF][:, None]
    flat = rows[:, at.KIND] == at.TRIANGLE
    corner, one, two = (axes[flat, each] for each in range(3))
    reach[flat] = np.abs(np.stack([corner, corner + one, corner + two])).max(axis=0)
    return reach


def _frame(rows: Floats, reach: Floats) -> Floats:
    """Return the frame of a grid around these shapes."""
    frame = np.zeros(at.FRAME_FIELDS)
    middle = rows[:, at.CENTRE : at.AXES]
    low, high = np.zeros(3), np.ones(3)
    if len(rows):
        low, high = (middle - reach).min(axis=0) - 0.01, (middle + reach).max(axis=0) + 0.01
    wide = high - low
    cells = min(max(at.CELLS_A_SHAPE * len(rows), 1.0), MOST_CELLS)
    frame[at.CELL] = max(np.sqrt(wide[0] * wide[1] / cells), LEAST_CELL_M)
    frame[at.COLUMNS], frame[at.ROWS] = np.ceil(wide[:2] / frame[at.CELL])
    frame[[at.LEFT, at.LOW, at.BOTTOM]], frame[at.TOP] = low, high[2]
    return frame


SOLIDS = (BOX, CYLINDER, PLANE)  # kinds of what stands upright in a lane
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


def read_surroundings(model: mujoco.MjModel, scene: str) -> Surroundings:
    """Read the collision geometry of a scene's model, whose layouts place obstacles in a lane or clutter.

    Raises UserError for a hull or contacts that only MuJoCo has, and as `read_scene` does.
    """
    still = touchable(model)
    hull = _hull(model, still)
    radius, half_height = model.geom_size[hull, :2]
    measures = np.array([radius, half_height, model.geom_rbound[hull]])
    if scene != "lane":
        clutter = named(model, "clutter_") if scene == "clutter" else still[:0]
        world = read_scene(model, geoms=np.setdiff1d(still, clutter))
        names = tuple(object_name(model, int(geom)) for geom in (*world.shapes[0, :, GEOM], *clutter))
        return Surroundings(np.zeros((0, SOLID_FIELDS)), names, (), measures, world)
    obstacles = obstacle_geoms(model)
    fixed = np.setdiff1d(still, obstacles)
    return Surroundings(
        np.array([_solid(model, geom) for geom in fixed.tolist()]).reshape(-1, SOLID_FIELDS),
        tuple(object_name(model, geom) for geom in fixed.tolist()),
        tuple(object_name(model, int(geom)) for geom in obstacles[:MAX_OBSTACLES]),
        measures,
    )


def _hull(model: mujoco.MjModel, still: NDArray[np.int64]) -> int:
    """Return the vehicle's hull. Raises UserError for one that only MuJoCo flies, or lets touch what is `still`."""
    vehicle, use = model.body(QUADROTOR).id, "use simulator = mujoco"
    own = ~_still(model) & ((model.geom_contype | model.geom_conaffinity) > 0)
    hull, *others = np.flatnonzero(own).tolist()
    upright = not model.geom_pos[hull].any() and tuple(model.geom_quat[hull]) == UPRIGHT
    if others or model.geom_bodyid[hull] != vehicle or not upright or model.geom_type[hull] != G.mjGEOM_CYLINDER:
        raise UserError(f"simulator = kernels: a drone touches with one upright cylinder at its origin alone; {use}")
    for geom in (hull, *still.tolist()):
        if model.geom_margin[geom] or model.geom_gap[geom]:
            raise UserError(f"simulator = kernels: {object_name(model, geom)} has a margin or a gap; {use}")
    overridden = model.opt.enableflags & mujoco.mjtEnableBit.mjENBL_OVERRIDE
    switched_off = model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_CONTACT
    if model.npair or overridden or switched_off:
        raise UserError(f"simulator = kernels: contact pairs, or options that override or disable contacts; {use}")
    return hull


def _solid(model: mujoco.MjModel, geom: int) -> Floats:
    """Return a geom of a lane as a solid. Raises UserError for one that is none."""
    kind = KINDS.get(int(model.geom_type[geom]))
    if kind not in SOLIDS or tuple(model.geom_quat[geom]) != UPRIGHT or model.geom_bodyid[geom] != 0:
        raise UserError(
            f"simulator = kernels: {object_name(model, geom)}: a lane has upright boxes, cylinders and planes of the "
            "world; use simulator = mujoco"
        )
    size = model.geom_size[geom].copy()
    if kind == CYLINDER:
        size = np.array([size[0], size[0], size[1]])
    return np.array([*model.geom_pos[geom], *size, kind])
