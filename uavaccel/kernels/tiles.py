"""What each tile of a picture may see, nearest first: on a GPU, whose warps cast the rays of a tile together.

A picture's tiles have 8 x 4 pixels. Of every shape in view `Sight` has the tiles that its box covers, and the distance
from which on it may be met, in steps; its shapes are in the order of these. A tile's rays meet those that cover it
until all of them have met something nearer than the rest. Rays through a scene's cells (kernels/casting) meet the same.
"""

from __future__ import annotations

import math
from typing import NamedTuple, TypeAlias

import numpy as np

from uavaccel.kernels import scene as at
from uavaccel.kernels.casting import EYE_FIELDS, HALF, HUGE, ONE, ZERO, Eye
from uavaccel.kernels.fields import HALF_HEIGHT, HALF_WIDTH, Float, Integer, Operand, Vector
from uavaccel.kernels.rays import dot, minus, plus
from uavaccel.kernels.scene import Shape, into, triple
from uavaccel.sim.parts import part

Box: TypeAlias = tuple[Vector, Vector, Vector, Vector]
"""A box's centre and half its edges, right, up and forwards from an eye."""
Bounds: TypeAlias = tuple[Float, Float, Float, Float]

TILE_ROWS, TILE_COLUMNS = 4, 8
STEPS = 256  # of distance; what is farther is in the last
STEP_M, MARGIN_M = np.float32(0.25), np.float32(1e-3)
MARGIN_PIXELS = np.float32(0.1)
CLIP_M = np.float32(1e-3)  # in front of the eye: what is nearer is not projected
EDGES = 12


class Sight(NamedTuple):
    """What the cameras of L lanes may see."""

    eyes: Operand
    """(L, EYE_FIELDS) float32: casting.put_eye."""
    counts: Operand
    """(L,) int32: number of shapes in view."""
    items: Operand
    """(L, n) int32: their indices, by distance; beyond `counts` whatever was there before."""
    tiles: Operand
    """(L, n) int32: the tiles that each covers, `packed`."""
    nears: Operand
    """(L, n) float32: distances, m, from which on each may be met."""


def sight_of(lanes: int, shapes: int) -> Sight:
    """Allocate what `lanes` lanes may see of `shapes` shapes."""
    of_shapes = lanes, max(shapes, 1)
    items, covered = np.zeros(of_shapes, np.int32), np.zeros(of_shapes, np.int32)
    eyes = np.zeros((lanes, EYE_FIELDS), np.float32)
    return Sight(eyes, np.zeros(lanes, np.int32), items, covered, np.zeros(of_shapes, np.float32))


@part(error_model="numpy")
def box_of(shape: Shape, eye: Eye) -> Box:
    """Return a box around a shape; around a triangle a parallelogram."""
    origin, (right, up, back), _ = eye
    away = minus(triple(shape, at.CENTRE), origin)
    a, x, y, z = at.AXES, shape[at.HALF], shape[at.HALF + 1], shape[at.HALF + 2]
    if int(shape[at.KIND]) == at.TRIANGLE:
        one, two = triple(shape, a + 3), triple(shape, a + 6)
        one, two = (HALF * one[0], HALF * one[1], HALF * one[2]), (HALF * two[0], HALF * two[1], HALF * two[2])
        away, three = plus(plus(plus(away, triple(shape, a), ONE), one, ONE), two, ONE), (ZERO, ZERO, ZERO)
    else:
        if int(shape[at.KIND]) == at.CAPSULE:
            z += x
        one = shape[a] * x, shape[a + 3] * x, shape[a + 6] * x
        two = shape[a + 1] * y, shape[a + 4] * y, shape[a + 7] * y
        three = shape[a + 2] * z, shape[a + 5] * z, shape[a + 8] * z
    forward = -back[0], -back[1], -back[2]
    return (
        (dot(right, away), dot(up, away), dot(forward, away)),
        (dot(right, one), dot(up, one), dot(forward, one)),
        (dot(right, two), dot(up, two), dot(forward, two)),
        (dot(right, three), dot(up, three), dot(forward, three)),
    )


@part(error_model="numpy")
def step_of(shape: Shape, eye: Eye) -> int:
    """Return the step of the distance of a shape, or of its box, from an eye."""
    away, bound, kind = minus(eye[0], triple(shape, at.CENTRE)), shape[at.BOUND], int(shape[at.KIND])
    far = math.sqrt(dot(away, away)) - bound
    if kind != at.TRIANGLE and bound < at.UNBOUNDED:
        p, tall = into(shape, away), shape[at.HALF + 2] + (shape[at.HALF] if kind == at.CAPSULE else ZERO)
        x, y = max(abs(p[0]) - shape[at.HALF], ZERO), max(abs(p[1]) - shape[at.HALF + 1], ZERO)
        z = max(abs(p[2]) - tall, ZERO)
        far = max(far, math.sqrt(x * x + y * y + z * z))
    return min(max(int((far - MARGIN_M) / STEP_M), 0), STEPS - 1)


@part(error_model="numpy")
def extended(bounds: Bounds, p: Vector) -> Bounds:
    """Return bounds of what is right and up, per metre forward, with another point."""
    x, y = p[0] / p[2], p[1] / p[2]
    return min(bounds[0], x), max(bounds[1], x), min(bounds[2], y), max(bounds[3], y)


@part(error_model="numpy")
def bounds_of(box: Box) -> Bounds:
    """Return the bounds of a box, right and up per metre forward, as far as it is in front; of its edges, that is."""
    bounds = HUGE, -HUGE, HUGE, -HUGE
    for edge in range(EDGES):
        along, second, third = box[1], box[2], box[3]
        if edge >= 8:
            along, second, third = box[3], box[1], box[2]
        elif edge >= 4:
            along, second, third = box[2], box[3], box[1]
        middle = plus(plus(box[0], second, ONE if edge & 1 else -ONE), third, ONE if edge & 2 else -ONE)
        low, high = plus(middle, along, -ONE), plus(middle, along, ONE)
        if low[2] > high[2]:
            low, high = high, low
        if high[2] <= CLIP_M:
            continue
        if low[2] < CLIP_M:
            low = plus(low, minus(high, low), (CLIP_M - low[2]) / (high[2] - low[2]))
            low = low[0], low[1], CLIP_M
        bounds = extended(extended(bounds, low), high)
    return bounds


@part(error_model="numpy")
def packed(low: Float, high: Float, first: Float, last: Float, size: tuple[int, int]) -> int:
    """Return the tiles of the columns from `low` to `high` and the rows from `first` to `last`; -1 for none."""
    if not (low <= size[1] - 1 and high >= ZERO and first <= size[0] - 1 and last >= ZERO):
        return -1
    left, right = int(max(low, ZERO)) // TILE_COLUMNS, int(min(high, np.float32(size[1] - 1))) // TILE_COLUMNS
    top, bottom = int(max(first, ZERO)) // TILE_ROWS, int(min(last, np.float32(size[0] - 1))) // TILE_ROWS
    return left | right << 8 | top << 16 | bottom << 24


@part(error_model="numpy")
def tiles_of(shape: Shape, camera: Operand, eye: Eye, size: tuple[int, int]) -> int:
    """Return the tiles that a shape may cover in a picture of `size`, rows and columns; -1 for none."""
    rows, columns = np.float32(size[0]), np.float32(size[1])
    if shape[at.BOUND] <= ZERO:
        return -1
    if shape[at.BOUND] >= at.UNBOUNDED:
        return packed(ZERO, columns, ZERO, rows, size)
    left, right, low, high = bounds_of(box_of(shape, eye))
    across, down = HALF * columns / np.float32(camera[HALF_WIDTH]), HALF * rows / np.float32(camera[HALF_HEIGHT])
    middle, centre = HALF * (columns - ONE), HALF * (rows - ONE)
    return packed(
        middle + across * left - MARGIN_PIXELS,
        middle + across * right + MARGIN_PIXELS,
        centre - down * high - MARGIN_PIXELS,
        centre - down * low + MARGIN_PIXELS,
        size,
    )


@part(error_model="numpy")
def covers(tiles: Integer, across: Integer, down: Integer) -> bool:
    """Return whether `packed` tiles have one among them."""
    within = (tiles & 255) <= across <= (tiles >> 8 & 255)
    return within and (tiles >> 16 & 255) <= down <= (tiles >> 24)
