"""Rays through a scene: what they meet first, and pictures made of them; all arithmetic is float32.

A ray is followed from cell to cell of the scene's grid, and meets shapes exactly: no shape is made of faces. Distances
along it are taken from the point nearest to a shape's centre or axis, where float32 loses least. As for MuJoCo's rays,
the inside of a shape is visible from within, and planes are seen from above only.

The functions take and return scalars or tuples, allocate nothing and raise nothing.
"""

from __future__ import annotations

import math
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from uavaccel.kernels import scene as at
from uavaccel.kernels.faces import SKY_SHARE, axes_of
from uavaccel.kernels.fields import (
    AMBIENT,
    BASE,
    CYLINDER,
    DIFFUSE,
    EMISSION,
    FAR_M,
    HALF_HEIGHT,
    HALF_WIDTH,
    LOG2_SIZE,
    PLANE,
    REPEAT,
    TEXTURE_ID,
    TOWARDS,
    UNIFORM,
    Float,
    Integer,
    Looks,
    Vector,
)  # fmt: skip
from uavaccel.kernels.rays import Colour, cross, dot, level_of, lit, minus, sky_index, texel_index
from uavaccel.kernels.scene import Scene, Shape, into, triple
from uavaccel.sim.parts import part

Span: TypeAlias = tuple[Float, Float]
Eye: TypeAlias = tuple[Vector, tuple[Vector, Vector, Vector], Float]
Met: TypeAlias = tuple[Float, Integer]
"""A distance, and the index of the shape there."""

ZERO, HALF, ONE, TWO = (np.float32(number) for number in (0.0, 0.5, 1.0, 2.0))
HUGE, TINY = np.float32(1e30), np.float32(1e-12)
WIDER = np.float32(1.00001)  # of bounding spheres, for rounding
CORNER = np.float32(1e-6)  # by which neighbouring triangles overlap, relative to their sides
SKY, WHITE = np.float32(SKY_SHARE), np.int32(0xFFFFFF)
EYE_FIELDS = 13
NOTHING, NONE = -1, (ZERO, ZERO, ZERO)


@part(error_model="numpy")
def along(origin: Vector, direction: Vector, distance: Float) -> Vector:
    """Return the point at a distance along a ray."""
    x, y, z = origin
    return x + distance * direction[0], y + distance * direction[1], z + distance * direction[2]


@part(error_model="numpy")
def reciprocal(number: Float) -> Float:
    """Return 1 / number, and something finite for 0."""
    return ONE / (number if abs(number) > TINY else TINY)


@part(error_model="numpy")
def common(a: Span, b: Span) -> Span:
    """Return the overlap of two ranges; its end comes before its beginning if there is none."""
    return max(a[0], b[0]), min(a[1], b[1])


@part(error_model="numpy")
def slab(place: Float, direction: Float, half: Float) -> Span:
    """Return the range in which place + t * direction is within [-half, half]."""
    back = reciprocal(direction)
    near, far = (-half - place) * back, (half - place) * back
    return min(near, far), max(near, far)


@part(error_model="numpy")
def in_ball(p: Vector, d: Vector, radius: Float) -> Span:
    """Return the range in which a ray, whose direction has any length, is within a radius around 0."""
    speed = dot(d, d)
    middle = -dot(p, d) / max(speed, TINY)
    nearest = along(p, d, middle)
    inside = radius * radius - dot(nearest, nearest)
    if inside < ZERO:
        return HUGE, -HUGE
    half = math.sqrt(inside / max(speed, TINY))
    return middle - half, middle + half


@part(error_model="numpy")
def in_box(p: Vector, d: Vector, half: Vector) -> Span:
    """Return the range in which a ray is within a box around 0."""
    return common(common(slab(p[0], d[0], half[0]), slab(p[1], d[1], half[1])), slab(p[2], d[2], half[2]))


@part(error_model="numpy")
def in_capsule(p: Vector, d: Vector, radius: Float, half: Float) -> Span:
    """Return the range in which a ray is within a capsule around 0."""
    near, far = in_ball((p[0], p[1], p[2] - half), d, radius)
    if half > ZERO:
        low, lower = in_ball((p[0], p[1], p[2] + half), d, radius)
        side, beyond = common(in_ball((p[0], p[1], ZERO), (d[0], d[1], ZERO), radius), slab(p[2], d[2], half))
        near, far = min(near, low), max(far, lower)
        if side <= beyond:
            near, far = min(near, side), max(far, beyond)
    return near, far


@part(error_model="numpy")
def within(shape: Shape, kind: int, p: Vector, d: Vector) -> Span:
    """Return the range in which a ray, in a shape's axes, is within it; for shapes with an inside."""
    half = triple(shape, at.HALF)
    if kind == CYLINDER:
        return common(in_ball((p[0], p[1], ZERO), (d[0], d[1], ZERO), half[0]), slab(p[2], d[2], half[2]))
    if kind == at.CAPSULE:
        return in_capsule(p, d, half[0], half[2])
    if kind == at.ELLIPSOID:
        x, y, z = ONE / half[0], ONE / half[1], ONE / half[2]
        return in_ball((p[0] * x, p[1] * y, p[2] * z), (d[0] * x, d[1] * y, d[2] * z), ONE)
    return in_box(p, d, half)


@part(error_model="numpy")
def meet_triangle(p: Vector, d: Vector, corner: Vector, one: Vector, two: Vector) -> Float:
    """Return where a ray meets a triangle from either side, HUGE for nowhere (Moeller and Trumbore)."""
    across = cross(d, two)
    back = reciprocal(dot(one, across))
    from_corner = p[0] - corner[0], p[1] - corner[1], p[2] - corner[2]
    u = dot(from_corner, across) * back
    turned = cross(from_corner, one)
    v = dot(d, turned) * back
    if u < -CORNER or v < -CORNER or u + v > ONE + CORNER:
        return HUGE
    return dot(two, turned) * back


@part(error_model="numpy")
def meet_plane(shape: Shape, origin: Vector, direction: Vector) -> Float:
    """Return where a ray meets a plane from above, HUGE for nowhere."""
    centre = triple(shape, at.CENTRE)
    p = into(shape, (origin[0] - centre[0], origin[1] - centre[1], origin[2] - centre[2]))
    d = into(shape, direction)
    if d[2] >= ZERO or p[2] < ZERO:
        return HUGE
    distance, half = -p[2] / d[2], triple(shape, at.HALF)
    x, y, _ = along(p, d, distance)
    seen = (half[0] <= ZERO or abs(x) <= half[0]) and (half[1] <= ZERO or abs(y) <= half[1])
    return distance if seen else HUGE


@part(error_model="numpy")
def height_of(scene: Scene, shape: Shape, column: int, row: int) -> Float:
    return scene.heights[int(shape[at.DATA]) + row * int(shape[at.COUNT]) + column]


@part(error_model="numpy")
def steps_of(shape: Shape) -> Span:
    """Return the distances between a height field's columns and rows."""
    columns, rows = shape[at.COUNT] - ONE, shape[at.LINES] - ONE
    return TWO * shape[at.HALF] / columns, TWO * shape[at.HALF + 1] / rows


@part(error_model="numpy")
def corner_of(scene: Scene, shape: Shape, column: int, row: int, p: Vector) -> Vector:
    """Return a point of a height field from p, in its axes."""
    wide, high = steps_of(shape)
    x, y = np.float32(column) * wide - shape[at.HALF], np.float32(row) * high - shape[at.HALF + 1]
    return x - p[0], y - p[1], height_of(scene, shape, column, row) - p[2]


@part(error_model="numpy")
def meet_cell(scene: Scene, shape: Shape, column: int, row: int, p: Vector, d: Vector) -> Float:
    """Return where a ray meets the two triangles of a height field's cell."""
    corner, far = corner_of(scene, shape, column, row, p), corner_of(scene, shape, column + 1, row + 1, p)
    right, up = corner_of(scene, shape, column + 1, row, p), corner_of(scene, shape, column, row + 1, p)
    one, two, three = minus(far, corner), minus(right, corner), minus(up, corner)
    below = meet_triangle(NONE, d, corner, one, two)
    above = meet_triangle(NONE, d, corner, one, three)
    below, above = below if below >= -CORNER else HUGE, above if above >= -CORNER else HUGE
    return min(below, above)


@part(error_model="numpy")
def cell_at(place: Float, step: Float, count: int) -> int:
    return min(max(at.whole(place / step), 0), count - 1)


@part(error_model="numpy")
def height_at(scene: Scene, shape: Shape, x: Float, y: Float) -> Float:
    """Return the height of a field at a place in its axes."""
    wide, high = steps_of(shape)
    x, y = x + shape[at.HALF], y + shape[at.HALF + 1]
    column, row = cell_at(x, wide, int(shape[at.COUNT]) - 1), cell_at(y, high, int(shape[at.LINES]) - 1)
    u, v = x / wide - np.float32(column), y / high - np.float32(row)
    corner, far = height_of(scene, shape, column, row), height_of(scene, shape, column + 1, row + 1)
    if u > v:
        right = height_of(scene, shape, column + 1, row)
        return corner + u * (right - corner) + v * (far - right)
    up = height_of(scene, shape, column, row + 1)
    return corner + v * (up - corner) + u * (far - up)


@part(inline=False, error_model="numpy")
def meet_heights(scene: Scene, shape: Shape, origin: Vector, direction: Vector, best: Float) -> Float:
    """Return where a ray meets a height field, its sides or its base; HUGE if that is not before `best`."""
    p, d = into(shape, minus(origin, triple(shape, at.CENTRE))), into(shape, direction)
    half_x, half_y, top, base = shape[at.HALF], shape[at.HALF + 1], shape[at.HALF + 2], shape[at.BASE]
    middle = HALF * (top - base)
    near, far = in_box((p[0], p[1], p[2] - middle), d, (half_x, half_y, HALF * (top + base)))
    if far < near or far < ZERO or near > best:
        return HUGE
    wide, high = steps_of(shape)
    columns, rows = int(shape[at.COUNT]) - 1, int(shape[at.LINES]) - 1
    near = max(near, ZERO)
    x, y, z = along(p, d, near)
    if near > ZERO and z <= height_at(scene, shape, x, y):
        return near
    column, row = cell_at(x + half_x, wide, columns), cell_at(y + half_y, high, rows)
    back_x, back_y = reciprocal(d[0]), reciprocal(d[1])
    way_x, way_y = 1 if d[0] > ZERO else -1, 1 if d[1] > ZERO else -1
    to_x = (np.float32(column + (way_x > 0)) * wide - half_x - p[0]) * back_x
    to_y = (np.float32(row + (way_y > 0)) * high - half_y - p[1]) * back_y
    enter = near
    while 0 <= column < columns and 0 <= row < rows and enter <= far and enter <= best:
        found = enter + meet_cell(scene, shape, column, row, along(p, d, enter), d)
        if found <= best:
            return max(found, ZERO)
        if to_x < to_y:
            enter, to_x, column = to_x, to_x + abs(wide * back_x), column + way_x
        else:
            enter, to_y, row = to_y, to_y + abs(high * back_y), row + way_y
    return HUGE


@part(error_model="numpy")
def meet(scene: Scene, shape: Shape, origin: Vector, direction: Vector, best: Float) -> Float:
    """Return the distance at which a ray of unit direction meets a shape; HUGE for nowhere, or surely after `best`."""
    kind: Integer = np.int32(shape[at.KIND])
    bound = shape[at.BOUND]
    if kind == PLANE:
        return meet_plane(shape, origin, direction)
    if kind == at.HEIGHTS:
        return meet_heights(scene, shape, origin, direction, best)
    away = minus(triple(shape, at.CENTRE), origin)
    aside, reach = away[0] * direction[1] - away[1] * direction[0], shape[at.REACH]
    if aside * aside > reach * reach * (direction[0] * direction[0] + direction[1] * direction[1]):
        return HUGE
    middle = dot(away, direction)
    p = along((-away[0], -away[1], -away[2]), direction, middle)
    if dot(p, p) > bound * bound * WIDER or middle - bound * WIDER > best or middle + bound < ZERO:
        return HUGE
    if kind == at.TRIANGLE:
        corner, one, two = triple(shape, at.AXES), triple(shape, at.AXES + 3), triple(shape, at.AXES + 6)
        found = middle + meet_triangle(p, direction, corner, one, two)
        return found if found >= ZERO else HUGE
    near, far = within(shape, kind, into(shape, p), into(shape, direction))
    if near > far:
        return HUGE
    found = middle + near
    if found < ZERO:
        found = middle + far
    return found if found >= ZERO else HUGE


@part(error_model="numpy")
def nearer(met: Met, other: Met) -> Met:
    """Return what is met first; of two at the same distance that of the lower index, in whatever order they are met."""
    return other if other[0] < met[0] or (other[0] == met[0] and other[1] < met[1]) else met


@part(error_model="numpy")
def outwards(shape: Shape, kind: int, p: Vector) -> Vector:
    """Return the normal, of any length, at a point of a shape's surface, both in its axes."""
    half = triple(shape, at.HALF)
    if kind == at.ELLIPSOID:
        return p[0] / (half[0] * half[0]), p[1] / (half[1] * half[1]), p[2] / (half[2] * half[2])
    if kind == at.CAPSULE:
        return p[0], p[1], p[2] - min(max(p[2], -half[2]), half[2])
    if kind == CYLINDER:
        round_ = math.sqrt(p[0] * p[0] + p[1] * p[1])
        if half[0] - round_ < half[2] - abs(p[2]):
            return p[0], p[1], ZERO
        return ZERO, ZERO, p[2]
    x, y, z = half[0] - abs(p[0]), half[1] - abs(p[1]), half[2] - abs(p[2])
    if x < y and x < z:
        return p[0], ZERO, ZERO
    return (ZERO, p[1], ZERO) if y < z else (ZERO, ZERO, p[2])


@part(error_model="numpy")
def slope(scene: Scene, shape: Shape, p: Vector) -> Vector:
    """Return the normal, of any length, at a point of a height field."""
    wide, high = steps_of(shape)
    x, y = p[0] + shape[at.HALF], p[1] + shape[at.HALF + 1]
    column, row = cell_at(x, wide, int(shape[at.COUNT]) - 1), cell_at(y, high, int(shape[at.LINES]) - 1)
    below, above = height_at(scene, shape, p[0], p[1]) - p[2], p[2] + shape[at.BASE]
    to_x, to_y = shape[at.HALF] - abs(p[0]), shape[at.HALF + 1] - abs(p[1])
    if below > max(min(above, to_x, to_y), ZERO):
        if above < min(to_x, to_y):
            return ZERO, ZERO, -ONE
        return (p[0], ZERO, ZERO) if to_x < to_y else (ZERO, p[1], ZERO)
    u, v = x / wide - np.float32(column), y / high - np.float32(row)
    corner, far = height_of(scene, shape, column, row), height_of(scene, shape, column + 1, row + 1)
    if u > v:
        right = height_of(scene, shape, column + 1, row)
        return (corner - right) / wide, (right - far) / high, ONE
    up = height_of(scene, shape, column, row + 1)
    return (up - far) / wide, (corner - up) / high, ONE


@part(inline=False, error_model="numpy")
def normal_at(scene: Scene, world: int, item: int, point: Vector, direction: Vector) -> Vector:
    """Return the unit normal at a point of a shape, on the side from which a ray comes."""
    shape = scene.shapes[world, item]
    kind = int(shape[at.KIND])
    if kind == at.TRIANGLE:
        normal = cross(triple(shape, at.AXES + 3), triple(shape, at.AXES + 6))
    else:
        p, normal = into(shape, minus(point, triple(shape, at.CENTRE))), (ZERO, ZERO, ONE)
        if kind == at.HEIGHTS:
            normal = slope(scene, shape, p)
        elif kind != PLANE:
            normal = outwards(shape, kind, p)
        a = at.AXES  # and back into those of the world
        normal = dot(triple(shape, a), normal), dot(triple(shape, a + 3), normal), dot(triple(shape, a + 6), normal)
    scale = ONE / math.sqrt(max(dot(normal, normal), TINY))
    if dot(normal, direction) > ZERO:
        scale = -scale
    return normal[0] * scale, normal[1] * scale, normal[2] * scale


@part(error_model="numpy")
def first_met(scene: Scene, world: int, origin: Vector, direction: Vector, far_m: Float) -> Met:
    """Return what a ray of unit direction meets first; `far_m` and NOTHING if nothing is.

    The shapes in no cell come first, then those of cell after cell; a GPU's compiler copies what is called twice.
    """
    frame, met = scene.frame[world], (far_m, NOTHING)
    cell, columns, rows = frame[at.CELL], int(frame[at.COLUMNS]), int(frame[at.ROWS])
    half = HALF * cell * np.float32(columns), HALF * cell * np.float32(rows), HALF * (frame[at.TOP] - frame[at.BOTTOM])
    p = (
        origin[0] - frame[at.LEFT] - half[0],
        origin[1] - frame[at.LOW] - half[1],
        origin[2] - frame[at.BOTTOM] - half[2],
    )
    enter, leave = in_box(p, direction, half)
    enter = max(enter, ZERO)
    x, y, _ = along(p, direction, enter)
    column, row = cell_at(x + half[0], cell, columns), cell_at(y + half[1], cell, rows)
    back_x, back_y = reciprocal(direction[0]), reciprocal(direction[1])
    way_x, way_y = 1 if direction[0] > ZERO else -1, 1 if direction[1] > ZERO else -1
    to_x = (np.float32(column + (way_x > 0)) * cell - half[0] - p[0]) * back_x
    to_y = (np.float32(row + (way_y > 0)) * cell - half[1] - p[1]) * back_y
    first, last, listed = 0, int(frame[at.LOOSE]), False
    while True:
        for entry in range(first, last):
            found = int(scene.items[world, entry]) if listed else entry
            met = nearer(met, (meet(scene, scene.shapes[world, found], origin, direction, met[0]), found))
        if listed and to_x < to_y:
            enter, to_x, column = to_x, to_x + abs(cell * back_x), column + way_x
        elif listed:
            enter, to_y, row = to_y, to_y + abs(cell * back_y), row + way_y
        if not (0 <= column < columns and 0 <= row < rows and enter <= met[0] and enter <= leave):
            return met
        place = row * columns + column
        first, last, listed = int(scene.start[world, place]), int(scene.start[world, place + 1]), True


@part(error_model="numpy")
def narrow(v: tuple[float, float, float]) -> Vector:
    return np.float32(v[0]), np.float32(v[1]), np.float32(v[2])


@part(error_model="numpy")
def ray_through(camera: Any, axes: Any, row: int, column: int, rows: int, columns: int) -> tuple[Vector, Float]:
    """Return a pixel's ray to a metre of depth, and the square of its length."""
    u = np.float32(camera[HALF_WIDTH]) * (np.float32(np.int32(2 * column + 1)) / np.float32(np.int32(columns)) - ONE)
    v = np.float32(camera[HALF_HEIGHT]) * (ONE - np.float32(np.int32(2 * row + 1)) / np.float32(np.int32(rows)))
    right, up, back = axes
    ray = u * right[0] + v * up[0] - back[0], u * right[1] + v * up[1] - back[1], u * right[2] + v * up[2] - back[2]
    return ray, ONE + u * u + v * v


@part(error_model="numpy")
def ray_of(camera: Any, axes: Any, row: int, column: int, rows: int, columns: int) -> tuple[Vector, Float]:
    """Return a pixel's ray, of unit length, and how many metres of depth it gains per metre."""
    ray, squared = ray_through(camera, axes, row, column, rows, columns)
    scale = ONE / math.sqrt(squared)
    return (ray[0] * scale, ray[1] * scale, ray[2] * scale), scale


@part(error_model="numpy")
def eye_of(camera: NDArray[np.float64], position: NDArray[np.float64], quaternion: NDArray[np.float64]) -> Eye:
    """Return where a camera is, its axes right, up and back, and its far plane.

    `camera` (16,) is that of `fields.Looks`; the pose is the vehicle's, NED, wxyz.
    """
    eye, right, up, back = axes_of(camera, position, quaternion)
    return narrow(eye), (narrow(right), narrow(up), narrow(back)), np.float32(camera[FAR_M])


@part(error_model="numpy")
def put_eye(row: Any, eye: Eye) -> None:
    """Write an eye to a row (EYE_FIELDS,) float32."""
    for axis in range(3):
        row[axis], row[3 + axis] = eye[0][axis], eye[1][0][axis]
        row[6 + axis], row[9 + axis] = eye[1][1][axis], eye[1][2][axis]
    row[12] = eye[2]


@part(error_model="numpy")
def get_eye(row: Any) -> Eye:
    """Return the eye that `put_eye` wrote."""
    return triple(row, 0), (triple(row, 3), triple(row, 6), triple(row, 9)), row[12]


@part(error_model="numpy")
def seen_by(lane: int, looks: Looks, games: Any, now: Any) -> tuple[int, Eye]:
    """Return a lane's world, and the eye of its vehicle's camera (kernels/lanes)."""
    state = now.state[lane]
    return at.world_of(games.scenes, now.game[lane]), eye_of(looks.camera, state.position, state.quaternion)


@part(error_model="numpy")
def depth_at(scene: Scene, world: int, looks: Looks, eye: Eye, row: int, column: int, size: tuple[int, int]) -> Float:
    """Return a pixel's depth, metres along the optical axis; the sky is at the far plane. `size`: rows, columns."""
    origin, axes, far_m = eye
    ray, scale = ray_of(looks.camera, axes, row, column, size[0], size[1])
    return first_met(scene, world, origin, ray, far_m / scale)[0] * scale


@part(error_model="numpy")
def shade(shape: Shape, looks: Looks, normal: Vector, material: int) -> Vector:
    """Return red, green and blue (0 to 1) of a shape in the light, without a texture."""
    light, glow = looks.light, looks.materials[material, EMISSION] if material >= 0 else ZERO
    facing = max(dot(normal, triple(light, TOWARDS)), ZERO)
    return (
        min(shape[at.RGB] * (light[AMBIENT] + glow + light[DIFFUSE] * facing), ONE),
        min(shape[at.RGB + 1] * (light[AMBIENT + 1] + glow + light[DIFFUSE + 1] * facing), ONE),
        min(shape[at.RGB + 2] * (light[AMBIENT + 2] + glow + light[DIFFUSE + 2] * facing), ONE),
    )


@part(error_model="numpy")
def texels_at(
    shape: Shape, looks: Looks, material: int, side: tuple[int, Float], eye: Eye, pixel: tuple[int, int], size: Any
) -> Span:
    """Return where a pixel's ray meets the plane of a side (axis, place), in texels of level 0 (kernels/faces)."""
    (axis, place), (origin, axes, _) = side, eye
    ray, _ = ray_through(looks.camera, axes, pixel[0], pixel[1], size[0], size[1])
    p, d = into(shape, minus(origin, triple(shape, at.CENTRE))), into(shape, ray)
    found = along(p, d, (place - p[axis]) / (d[axis] if abs(d[axis]) > TINY else TINY))
    row, log2_size = looks.materials[material], looks.textures[int(looks.materials[material, TEXTURE_ID]), LOG2_SIZE]
    across, down = (1 if axis == 0 else 0), (1 if axis == 2 else 2)
    return (
        coordinate(row, 0, shape[at.HALF], shape[at.HALF + across], found[across], log2_size),
        coordinate(row, 1, shape[at.HALF + 1], shape[at.HALF + down], -found[down], log2_size),
    )


@part(error_model="numpy")
def coordinate(material: Shape, place: int, uniform: Float, half: Float, found: Float, log2_size: int) -> Float:
    """Return a texture coordinate in texels, counted from a side's left or upper edge, `half` from its middle."""
    repeat = material[REPEAT + place] if material[REPEAT + place] > ZERO else ONE
    if material[UNIFORM] > ZERO and uniform > ZERO:
        repeat *= uniform
    return (found + half) * (HALF / half * repeat * np.float32(1 << log2_size))


@part(error_model="numpy")
def texel_of(shape: Shape, looks: Looks, material: int, point: Vector, eye: Eye, pixel: Any, size: Any) -> Any:
    """Return the texel of a pixel, row and column, that shows a point of a plane or box; its quad has one level."""
    side, (row, column) = (2, ZERO), pixel
    if int(shape[at.KIND]) != PLANE:
        p = into(shape, minus(point, triple(shape, at.CENTRE)))
        x, y, z = shape[at.HALF] - abs(p[0]), shape[at.HALF + 1] - abs(p[1]), shape[at.HALF + 2] - abs(p[2])
        axis = 0 if x < y and x < z else (1 if y < z else 2)
        side = axis, shape[at.HALF + axis] if p[axis] > ZERO else -shape[at.HALF + axis]
    texture = int(looks.materials[material, TEXTURE_ID])
    u, v = texels_at(shape, looks, material, side, eye, (row, column), size)
    u0, v0 = texels_at(shape, looks, material, side, eye, (row | 1, column & ~1), size)
    ux, vx = texels_at(shape, looks, material, side, eye, (row | 1, column | 1), size)
    uy, vy = texels_at(shape, looks, material, side, eye, (row & ~1, column & ~1), size)
    level = level_of(ux - u0, vx - v0, uy - u0, vy - v0, looks.textures[texture, LOG2_SIZE])
    index = texel_index(u, v, level, looks.textures[texture, BASE], looks.textures[texture, LOG2_SIZE])
    return looks.texels[np.uint32(index)]


@part(error_model="numpy")
def colour_of(scene: Scene, world: int, looks: Looks, eye: Eye, pixel: Any, size: Any, ray: Vector, met: Met) -> Colour:
    """Return red, green and blue (0 to 255) of a pixel, row and column, whose ray has met something, or NOTHING."""
    distance, item = met
    if item == NOTHING:
        index = sky_index(ray[0], ray[1], ray[2], looks.textures[0, BASE], looks.textures[0, LOG2_SIZE])
        return lit(np.int32(looks.texels[np.uint32(index)]), ONE, ONE, ONE)
    shape, point = scene.shapes[world, item], along(eye[0], ray, distance)
    material = int(shape[at.MATERIAL])
    red, green, blue = shade(shape, looks, normal_at(scene, world, item, point, ray), material)
    kind = int(shape[at.KIND])
    flat = kind == PLANE or kind == at.BOX
    if not flat or material < 0 or looks.materials[material, TEXTURE_ID] <= ZERO:
        return lit(WHITE, red, green, blue)
    return lit(np.int32(texel_of(shape, looks, material, point, eye, pixel, size)), red, green, blue)


@part(error_model="numpy")
def colour_at(scene: Scene, world: int, looks: Looks, eye: Eye, row: int, column: int, size: tuple[int, int]) -> Colour:
    """Return red, green and blue (0 to 255) of a pixel. `size`: rows, columns."""
    origin, axes, far_m = eye
    ray, _ = ray_of(looks.camera, axes, row, column, size[0], size[1])
    met = first_met(scene, world, origin, ray, far_m * SKY)
    return colour_of(scene, world, looks, eye, (row, column), size, ray, met)
