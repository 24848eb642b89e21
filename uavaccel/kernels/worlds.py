"""Worlds drawn at random, one per game: things that stand on the ground or hang in the air, a start, and a goal.

A world is a pure function of a recipe and a seed, whichever machine draws it. The functions are compiled for the CPU
and for a GPU, allocate nothing and raise nothing. MuJoCo's axes, metres.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from uavaccel.errors import UserError
from uavaccel.kernels import scene as at
from uavaccel.kernels.fields import BOX, CYLINDER, PLANE
from uavaccel.kernels.scene import Scene, empty_scene, list_shapes
from uavaccel.sim.parts import part
from uavaccel.sim.vehicle.hotloop import sources
from uavaccel.vision.noise import Word, uniform_block

CLUTTER = 5  # stream of random numbers (vision/noise)
ATTEMPTS = 12  # at a place for a shape, and for start and goal
FULL_TURN = 2.0 * math.pi
BLOCKS = 3  # of four random numbers that an attempt takes


class Recipe(NamedTuple):
    """What worlds are like. Sizes are half sizes or radii."""

    half_m: float = 24.0
    """Half the side of the square that holds everything."""
    density: float = 0.04
    """Shapes per square metre of it; fewer where they find no place."""
    cylinders: float = 1.0
    """Share of upright cylinders; shares need not add up to 1."""
    boxes: float = 1.0
    """Share of upright boxes, turned about the vertical."""
    spheres: float = 0.0
    """Share of spheres in the air."""
    ellipsoids: float = 0.0
    """Share of ellipsoids in the air, turned about the vertical."""
    small_m: float = 0.15
    large_m: float = 0.6
    """Range of half sizes across."""
    low_m: float = 3.0
    high_m: float = 6.0
    """Range of heights of what stands on the ground; what is in the air is below the latter."""
    gap_m: float = 0.0
    """Least distance between any two shapes, seen from above."""
    clear_m: float = 1.5
    """Least distance from start and goal to any shape."""
    near_m: float = 15.0
    far_m: float = 30.0
    """Range of distances from start to goal, as far as the square has room."""
    altitude_m: float = 1.5
    """Height of start and goal."""
    cell_m: float = 1.0
    """Side of the grid's cells."""


def count_of(recipe: Recipe) -> int:
    """Return the number of shapes that worlds of a recipe ask for, without the ground."""
    return round(recipe.density * (2 * recipe.half_m) ** 2)


def worlds_of(recipe: Recipe, worlds: int, seen: bool = False) -> Scene:
    """Allocate worlds for a recipe. Raises UserError for one that asks for nothing that can be drawn."""
    check(recipe)
    shapes, side = count_of(recipe), math.ceil(2 * recipe.half_m / recipe.cell_m)
    across = math.sqrt(2.0) * recipe.large_m + at.LISTING_MARGIN_M  # of a turned box
    cells = (math.floor(2 * across / recipe.cell_m) + 2) ** 2
    return empty_scene(worlds, shapes + 1, side * side, shapes * cells, seen)


def check(recipe: Recipe) -> None:
    """Raise UserError for a recipe that asks for nothing that can be drawn."""
    for low, high in (("small_m", "large_m"), ("low_m", "high_m"), ("near_m", "far_m")):
        if not 0 < getattr(recipe, low) <= getattr(recipe, high):
            raise UserError(f"worlds: {low} must be more than 0, and not more than {high}")
    if not (recipe.cell_m > 0 and recipe.half_m > 2 * recipe.large_m and recipe.density >= 0):
        raise UserError("worlds: half_m must hold large_m twice, cell_m be more than 0, and density not less")
    shares = recipe.cylinders, recipe.boxes, recipe.spheres, recipe.ellipsoids
    if min(shares) < 0 or sum(shares) <= 0:
        raise UserError("worlds: a share of cylinders, boxes, spheres or ellipsoids must be more than 0, and none less")


@part
def drawn(seed: Word, attempt: int, shape: int, block: int) -> tuple[float, float, float, float]:
    """Return four uniform numbers in [0, 1)."""
    a, b, c, d = uniform_block(seed, attempt, CLUTTER, BLOCKS * shape + block)
    return float(a), float(b), float(c), float(d)


@part
def draw_way(recipe: Recipe, seed: Word, way: NDArray[np.float64]) -> None:
    """Write start and goal (6,), a distance apart that the recipe allows if the square has room for it."""
    room = recipe.half_m - recipe.clear_m
    way[2] = way[5] = recipe.altitude_m
    for attempt in range(ATTEMPTS):
        x, y, turn, far = drawn(seed, attempt, 0, 0)
        way_m = min(recipe.near_m + far * (recipe.far_m - recipe.near_m), 2.0 * room)
        way[0], way[1] = (2.0 * x - 1.0) * room, (2.0 * y - 1.0) * room
        way[3], way[4] = way[0] + way_m * math.cos(FULL_TURN * turn), way[1] + way_m * math.sin(FULL_TURN * turn)
        if abs(way[3]) <= room and abs(way[4]) <= room:
            return
    way[0] = way[1] = -room
    part_m = min(recipe.far_m, 2.0 * room * math.sqrt(2.0)) / math.sqrt(2.0)
    way[3] = way[4] = part_m - room


@part
def draw_kind(recipe: Recipe, share: float) -> int:
    """Return a kind of shape; a sphere is a CAPSULE."""
    share *= recipe.cylinders + recipe.boxes + recipe.spheres + recipe.ellipsoids
    if share < recipe.cylinders:
        return CYLINDER
    if share < recipe.cylinders + recipe.boxes:
        return BOX
    return at.CAPSULE if share < recipe.cylinders + recipe.boxes + recipe.spheres else at.ELLIPSOID


@part
def draw_shape(recipe: Recipe, seed: Word, attempt: int, number: int, shape: Any) -> float:
    """Write a shape, and return how far it reaches from its centre, seen from above."""
    x, y, kind_, turn = drawn(seed, attempt, number, 0)
    one, two, three, tall = drawn(seed, attempt, number, 1)
    kind, more_m = draw_kind(recipe, kind_), recipe.large_m - recipe.small_m
    wide, deep, high = recipe.small_m + one * more_m, recipe.small_m + two * more_m, recipe.small_m + three * more_m
    if kind == CYLINDER or kind == at.CAPSULE:
        deep, high = wide, 0.0
    middle = high + tall * max(recipe.high_m - 2.0 * high, 0.0)
    if kind in (CYLINDER, BOX):
        high = middle = 0.5 * (recipe.low_m + tall * (recipe.high_m - recipe.low_m))
    elif kind == at.CAPSULE:
        middle = wide + tall * max(recipe.high_m - 2.0 * wide, 0.0)
    cosine, sine = math.cos(FULL_TURN * turn), math.sin(FULL_TURN * turn)
    for field in range(at.SHAPE_FIELDS):
        shape[field] = 0.0
    shape[at.KIND] = kind
    shape[at.HALF], shape[at.HALF + 1], shape[at.HALF + 2] = wide, deep, high
    shape[at.AXES], shape[at.AXES + 1], shape[at.AXES + 3], shape[at.AXES + 4] = cosine, -sine, sine, cosine
    shape[at.AXES + 8], shape[at.GEOM] = 1.0, number
    across = math.sqrt(wide * wide + deep * deep) if kind == BOX else max(wide, deep)
    tip = max(across, high) if kind == at.ELLIPSOID else math.sqrt(across * across + high * high)
    shape[at.BOUND] = across if kind == at.CAPSULE else tip
    room = recipe.half_m - across
    shape[at.CENTRE], shape[at.CENTRE + 1] = (2.0 * x - 1.0) * room, (2.0 * y - 1.0) * room
    shape[at.CENTRE + 2] = middle
    red, green, blue, _ = drawn(seed, attempt, number, 2)
    shape[at.RGB], shape[at.RGB + 1], shape[at.RGB + 2] = 0.2 + 0.8 * red, 0.2 + 0.8 * green, 0.2 + 0.8 * blue
    return across


@part
def has_place(recipe: Recipe, shapes: Any, count: int, across: float, way: Any) -> bool:
    """Return whether a shape, the one after `count`, is far enough from the others, and from start and goal."""
    shape = shapes[count]
    x, y = shape[at.CENTRE], shape[at.CENTRE + 1]
    for end in range(0, 6, 3):
        if math.hypot(x - way[end], y - way[end + 1]) < across + recipe.clear_m:
            return False
    if recipe.gap_m > 0.0:
        for other in range(1, count):
            wide, deep = shapes[other, at.HALF], shapes[other, at.HALF + 1]
            reach = math.sqrt(wide * wide + deep * deep) if int(shapes[other, at.KIND]) == BOX else max(wide, deep)
            away = math.hypot(x - shapes[other, at.CENTRE], y - shapes[other, at.CENTRE + 1])
            if away < across + reach + recipe.gap_m:
                return False
    return True


@part(inline=False)
def draw_world(scene: Scene, world: int, recipe: Recipe, seed: Word, way: NDArray[np.float64]) -> int:
    """Draw a world into a row of a scene, with `way` (6,): start and goal; return the number of its shapes."""
    draw_way(recipe, seed, way)
    shapes, frame = scene.shapes[world], scene.frame[world]
    for field in range(at.SHAPE_FIELDS):
        shapes[0, field] = 0.0
    shapes[0, at.KIND], shapes[0, at.BOUND] = PLANE, at.UNBOUNDED
    for axis in range(3):
        shapes[0, at.AXES + 4 * axis] = 1.0
        shapes[0, at.RGB + axis] = 0.4
    count = 1
    for number in range(1, len(shapes)):
        for attempt in range(ATTEMPTS):
            across = draw_shape(recipe, seed, attempt, number, shapes[count])
            if has_place(recipe, shapes, count, across, way):
                count += 1
                break
    side = math.ceil(2.0 * recipe.half_m / recipe.cell_m)
    frame[at.LEFT] = frame[at.LOW] = -recipe.half_m
    frame[at.CELL], frame[at.COLUMNS], frame[at.ROWS] = recipe.cell_m, side, side
    frame[at.BOTTOM], frame[at.TOP] = 0.0, max(recipe.high_m, 2.0 * recipe.large_m)
    frame[at.LOOSE], frame[at.SHAPES] = 1, count
    list_shapes(scene, world)
    return count


@part
def copy_world(scene: Scene, other: Scene, world: int) -> None:
    """Copy a world to another scene's row, of the other precision or the same."""
    for shape in range(int(scene.frame[world, at.SHAPES])):
        for field in range(at.SHAPE_FIELDS):
            other.shapes[world, shape, field] = scene.shapes[world, shape, field]
    for field in range(at.FRAME_FIELDS):
        other.frame[world, field] = scene.frame[world, field]
    for cell in range(scene.start.shape[1]):
        other.start[world, cell] = scene.start[world, cell]
    for entry in range(scene.start[world, scene.start.shape[1] - 1]):
        other.items[world, entry] = scene.items[world, entry]


def put_world(scene: Scene, world: int, one: Scene) -> None:
    """Write the only world of a scene without meshes and height fields into a row of another.

    Raises UserError for one that has any, or that does not fit.
    """
    fits = all(len(own[0]) <= room.shape[1] for own, room in zip(one[:3], scene[:3], strict=True))
    if not fits or len(one.vertices) or len(one.heights):
        raise UserError(f"this world does not fit into those of {scene.shapes.shape[1]} shapes without meshes")
    scene.frame[world] = one.frame[0]
    scene.shapes[world, : one.shapes.shape[1]] = one.shapes[0]
    scene.start[world] = one.start[0, -1]
    scene.start[world, : one.start.shape[1]] = one.start[0]
    scene.items[world, : one.items.shape[1]] = one.items[0]


def _compile(stamp: int) -> Any:
    """Compile the entry point, or load it from numba's cache; `stamp` as in kernels/pictures."""

    @njit(cache=True, nogil=True)
    def draw(scene, recipe, seeds, ways):  # type: ignore[no-untyped-def]
        for world in range(len(seeds) * (stamp != 0)):
            draw_world(scene, world, recipe, seeds[world], ways[world])

    return draw


draw_worlds = _compile(sources(__name__))
"""`draw_worlds(scene, recipe, seeds (W,) int64, ways (W, 6))` draws all worlds of a scene."""
