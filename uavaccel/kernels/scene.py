"""Any still scene as plain arrays: its shapes, and a grid of cells on the ground in which each shape is listed.

A scene has one or more worlds, a row each. Vertices of meshes and heights of height fields are shared by all worlds.
Metres, MuJoCo's axes. A scene to touch is of float64, with meshes as their convex hulls; one to see is of float32, with
meshes as triangles.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numba import njit
from numba.extending import overload
from numpy.typing import NDArray

from uavaccel.kernels.fields import BOX as BOX
from uavaccel.kernels.fields import CYLINDER, Vector
from uavaccel.kernels.fields import PLANE as PLANE
from uavaccel.sim.parts import part

Shape: TypeAlias = NDArray[np.floating]

ELLIPSOID, CAPSULE, TRIANGLE, HULL, HEIGHTS = range(3, 8)
"""Kinds of shapes beside BOX, CYLINDER and PLANE. A sphere is a CAPSULE without length."""

# A shape: a row of Scene.shapes.
KIND, BOUND, REACH = 0, 1, 2  # BOUND: radius of the bounding sphere; REACH: of a circle around it, seen from above
CENTRE = 3
AXES = 6  # rotation matrix, row by row; of a TRIANGLE its first corner from the centre, and two edges
HALF = 15  # half sizes: of a round shape radius, radius, half length; of a PLANE 0 for infinite
RGB = 18  # 0 to 1; without a texture that is seen
DATA, COUNT, LINES, BASE = 21, 22, 23, 24  # first vertex and number of a HULL; first height, columns, rows, depth
GEOM = 25  # the geom's index in its model
MATERIAL = 26  # and its material's, -1 for none; textures are seen on planes and boxes alone
SHAPE_FIELDS = 27

# A grid: a row of Scene.frame. Shapes before LOOSE are in no cell, but always considered.
LEFT, LOW, CELL, COLUMNS, ROWS, BOTTOM, TOP, LOOSE, SHAPES = range(9)
FRAME_FIELDS = 9

CELLS_A_SHAPE = 6.0  # of a grid, about
UNBOUNDED = 1e6  # BOUND of planes and height fields
LISTING_MARGIN_M = 1e-3  # by which shapes are listed in more cells, which outweighs rounding in float32


class Scene(NamedTuple):
    """Worlds of still shapes."""

    shapes: Any
    """(W, n, SHAPE_FIELDS) float32 or float64."""
    start: Any
    """(W, cells + 1) int32: where a cell's shapes begin in `items`; row by row, from LEFT and LOW."""
    items: Any
    """(W, m) int32: indices of shapes."""
    frame: Any
    """(W, FRAME_FIELDS): of the type of the shapes."""
    vertices: Any
    """(v, 3): of convex hulls, from their shapes' centres."""
    heights: Any
    """(h,): of height fields, row by row."""


def empty_scene(worlds: int, shapes: int, cells: int, items: int, seen: bool) -> Scene:
    """Allocate a scene without meshes and height fields."""
    kind = np.float32 if seen else np.float64
    return Scene(
        np.zeros((worlds, shapes, SHAPE_FIELDS), kind),
        np.zeros((worlds, cells + 1), np.int32),
        np.zeros((worlds, items), np.int32),
        np.zeros((worlds, FRAME_FIELDS), kind),
        np.zeros((0, 3), kind),
        np.zeros(0, kind),
    )


def as_seen(scene: Scene) -> Scene:
    """Return the same shapes to see, in the same cells; for shapes that are no meshes."""
    parts = ("shapes", "frame", "vertices", "heights")
    return scene._replace(**{name: getattr(scene, name).astype(np.float32) for name in parts})


@part
def world_of(scene: Scene, game: int) -> int:
    """Return a game's world: that of its row, or the only one."""
    return min(game, len(scene.shapes) - 1)


@part(error_model="numpy")
def triple(shape: Shape, field: int) -> Vector:
    """Return three fields of a shape from `field` on."""
    return shape[field], shape[field + 1], shape[field + 2]


@part(error_model="numpy")
def into(shape: Shape, v: Vector) -> Vector:
    """Turn a vector of the world into a shape's axes."""
    a = AXES
    return (
        shape[a] * v[0] + shape[a + 3] * v[1] + shape[a + 6] * v[2],
        shape[a + 1] * v[0] + shape[a + 4] * v[1] + shape[a + 7] * v[2],
        shape[a + 2] * v[0] + shape[a + 5] * v[1] + shape[a + 8] * v[2],
    )


@part(error_model="numpy")
def spread_along(shape: Shape, kind: int, axis: int) -> float:
    """Return a shape's reach from its centre along an axis of the world."""
    if kind == TRIANGLE:
        corner = shape[AXES + axis]
        return max(abs(corner), abs(corner + shape[AXES + 3 + axis]), abs(corner + shape[AXES + 6 + axis]))
    x, y, z = shape[AXES + 3 * axis], shape[AXES + 3 * axis + 1], shape[AXES + 3 * axis + 2]
    if kind == ELLIPSOID:
        return math.sqrt((x * shape[HALF]) ** 2 + (y * shape[HALF + 1]) ** 2 + (z * shape[HALF + 2]) ** 2)
    if kind == CYLINDER:
        return abs(z) * shape[HALF + 2] + math.sqrt(max(x * x + y * y, 0.0)) * shape[HALF]
    if kind == CAPSULE:
        return abs(z) * shape[HALF + 2] + shape[HALF]
    return abs(x) * shape[HALF] + abs(y) * shape[HALF + 1] + abs(z) * shape[HALF + 2]


@part(error_model="numpy")
def beside(shape: Shape, x: float, y: float, half: float) -> bool:
    """Return whether one of a shape's axes, seen from above, separates it from a square around (x, y)."""
    if int(shape[KIND]) == TRIANGLE:
        return False
    for axis in range(3):
        u, v = shape[AXES + axis], shape[AXES + 3 + axis]
        reach = half * (abs(u) + abs(v))
        for other in range(3):
            along = u * shape[AXES + other] + v * shape[AXES + 3 + other]
            wide = shape[HALF] if int(shape[KIND]) == CAPSULE and other == 2 else 0.0
            reach += abs(along) * (shape[HALF + other] + wide)
        if abs(u * (x - shape[CENTRE]) + v * (y - shape[CENTRE + 1])) > reach:
            return True
    return False


@part(error_model="numpy")
def whole(number: float) -> int:
    """Return the largest integer that is not above a number; on a GPU math.floor returns a float."""
    return int(math.floor(number))  # noqa: RUF046


@part(error_model="numpy")
def cell_range(centre: float, reach: float, first: float, cell: float, count: int) -> tuple[int, int]:
    """Return the first cell that an interval meets, and the one after the last."""
    low, high = whole((centre - reach - first) / cell), whole((centre + reach - first) / cell)
    return max(low, 0), min(high + 1, count)


def add_to(counts: Any, place: int, number: int) -> int:  # type: ignore[empty-body]
    """Add to a count, and return what it was before; on a GPU threads take turns (kernels/cuda)."""


@overload(add_to)
def _add_alone(counts, place, number):  # type: ignore[no-untyped-def]
    def add(counts, place, number):  # type: ignore[no-untyped-def]
        before = counts[place]
        counts[place] = before + number
        return before

    return add


@part(inline=False, error_model="numpy")
def visit(scene: Scene, world: int, shape: int, place: bool) -> int:
    """Count a shape in the cells that it meets, or with `place` list it there; return their number.

    A shape without extent is in none.
    """
    frame, row, start = scene.frame[world], scene.shapes[world, shape], scene.start[world]
    if row[BOUND] <= 0.0:
        return 0
    columns, rows, cell = int(frame[COLUMNS]), int(frame[ROWS]), frame[CELL]
    wide, high = spread_along(row, int(row[KIND]), 0), spread_along(row, int(row[KIND]), 1)
    first_x, last_x = cell_range(row[CENTRE], wide + LISTING_MARGIN_M, frame[LEFT], cell, columns)
    first_y, last_y = cell_range(row[CENTRE + 1], high + LISTING_MARGIN_M, frame[LOW], cell, rows)
    half, found = 0.5 * cell + LISTING_MARGIN_M, 0
    for y in range(first_y, last_y):
        for x in range(first_x, last_x):
            if beside(row, frame[LEFT] + (x + 0.5) * cell, frame[LOW] + (y + 0.5) * cell, half):
                continue
            found += 1
            before = add_to(start, y * columns + x, -1 if place else 1)
            if place:
                scene.items[world, before - 1] = shape
    return found


@part(error_model="numpy")
def list_shapes(scene: Scene, world: int) -> int:
    """List the shapes of a world in its cells, as `frame` lays these out, and return the number of entries needed.

    Where that is more than `items` has room for, the cells are left empty.
    """
    frame, start = scene.frame[world], scene.start[world]
    loose, shapes = int(frame[LOOSE]), int(frame[SHAPES])
    for cell in range(len(start)):
        start[cell] = 0
    needed = 0
    for shape in range(loose, shapes):
        needed += visit(scene, world, shape, False)
    before, fits = 0, needed <= scene.items.shape[1]
    for cell in range(len(start)):  # counts of shapes become the ends of cells
        before += start[cell] if cell < len(start) - 1 else 0
        start[cell] = before if fits else 0
    if not fits:
        return needed
    for shape in range(shapes - 1, loose - 1, -1):
        visit(scene, world, shape, True)
    return needed


@part(error_model="numpy")
def sort_cell(scene: Scene, world: int, cell: int) -> None:
    """Sort the shapes of a cell, which threads have listed in any order."""
    items, first = scene.items[world], scene.start[world, cell]
    for entry in range(first + 1, scene.start[world, cell + 1]):
        item, place = items[entry], entry
        while place > first and items[place - 1] > item:
            items[place] = items[place - 1]
            place -= 1
        items[place] = item


@njit(cache=True, nogil=True, error_model="numpy")
def list_world(scene, world):  # type: ignore[no-untyped-def]
    """Do as `list_shapes`, called from Python."""
    return list_shapes(scene, world)
