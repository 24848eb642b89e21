"""Whether a vehicle's hull meets convex shapes, turned as they are: Gilbert, Johnson and Keerthi's distance in float64.

The hull is a flat cylinder in the body frame. Of hull and shape the vectors from the latter's points to the former's
form a convex set; the bodies meet if that contains 0. The set is known by its farthest point in each direction, and is
searched by simplices of up to four of these points. The search ends as soon as a direction separates the bodies.
"""

from __future__ import annotations

import math
from typing import TypeAlias

from uavaccel.kernels import scene as at
from uavaccel.kernels.fields import BOX, CYLINDER
from uavaccel.kernels.operands import Vector, cross, dot, plus
from uavaccel.kernels.scene import Scene, Shape
from uavaccel.sim.parts import part

Simplex: TypeAlias = tuple[Vector, Vector, Vector, Vector]
Nearest: TypeAlias = tuple[Vector, int, Simplex]
"""The point of a simplex next to 0, and the smallest simplex that has it: its number of corners, and these."""
Hull: TypeAlias = tuple[Vector, Vector, float, float]
"""A flat cylinder: its centre and its axis, in the axes of a shape and from its centre; radius and half height."""

ROUNDS = 64
ENOUGH = 1e-13  # relative: what the square of a distance can still lose
NOTHING_M = 1e-12
FLAT = 1e-20  # of a triangle: the square of the sine of its angle
NO_CELL = -1
O = (0.0, 0.0, 0.0)  # noqa: E741


@part(error_model="numpy")
def minus(a: Vector, b: Vector) -> Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@part(error_model="numpy")
def farthest_of_hull(hull: Hull, d: Vector) -> Vector:
    """Return the point of a hull that is farthest in a direction."""
    centre, axis, radius, half = hull
    lift = dot(axis, d)
    flat = plus(d, axis, -lift)
    flat = plus(flat, axis, -dot(axis, flat))  # again, for directions that are along the axis but for rounding
    length = math.sqrt(dot(flat, flat))
    point = plus(centre, axis, half if lift >= 0.0 else -half)
    return plus(point, flat, radius / length) if length > 1e-300 else point


@part(error_model="numpy")
def farthest(scene: Scene, shape: Shape, cell: int, d: Vector) -> Vector:
    """Return the point of a shape, in its axes, that is farthest in a direction; a CAPSULE without its radius.

    Of height fields it is that of the prism under half a cell, `cell`.
    """
    kind = int(shape[at.KIND])
    x, y, z = shape[at.HALF], shape[at.HALF + 1], shape[at.HALF + 2]
    if kind == BOX:
        return x if d[0] >= 0.0 else -x, y if d[1] >= 0.0 else -y, z if d[2] >= 0.0 else -z
    if kind == CYLINDER:
        length = math.sqrt(d[0] * d[0] + d[1] * d[1])
        scale = x / length if length > 1e-300 else 0.0
        return d[0] * scale, d[1] * scale, z if d[2] >= 0.0 else -z
    if kind == at.CAPSULE:
        return 0.0, 0.0, z if d[2] >= 0.0 else -z
    if kind == at.ELLIPSOID:
        u, v, w = x * d[0], y * d[1], z * d[2]
        length = math.sqrt(u * u + v * v + w * w)
        scale = 1.0 / length if length > 1e-300 else 0.0
        return x * u * scale, y * v * scale, z * w * scale
    if kind == at.HEIGHTS:
        return farthest_of_prism(scene, shape, cell, d)
    return farthest_of_corners(scene, int(shape[at.DATA]), int(shape[at.COUNT]), d)


@part(inline=False, error_model="numpy")
def farthest_of_corners(scene: Scene, first: int, count: int, d: Vector) -> Vector:
    """Return the farthest of several vertices."""
    found, most = first, -math.inf
    for corner in range(first, first + count):
        vertices = scene.vertices
        reach = vertices[corner, 0] * d[0] + vertices[corner, 1] * d[1] + vertices[corner, 2] * d[2]
        if reach > most:
            found, most = corner, reach
    return scene.vertices[found, 0], scene.vertices[found, 1], scene.vertices[found, 2]


@part(inline=False, error_model="numpy")
def farthest_of_prism(scene: Scene, shape: Shape, cell: int, d: Vector) -> Vector:
    """Return the farthest of a prism's six corners: under a triangle of a height field, down to its base."""
    columns, lines = int(shape[at.COUNT]), int(shape[at.LINES])
    wide, high = 2.0 * shape[at.HALF] / (columns - 1), 2.0 * shape[at.HALF + 1] / (lines - 1)
    place, upper = cell // 2, cell % 2
    column, row = place % (columns - 1), place // (columns - 1)
    first, most, found = int(shape[at.DATA]), -math.inf, O
    for corner in range(3):
        # (0, 0) and (1, 1), and of the lower triangle (1, 0), of the upper (0, 1)
        x = column + (1 if corner == 1 or (corner == 2 and upper == 0) else 0)
        y = row + (1 if corner == 1 or (corner == 2 and upper == 1) else 0)
        z = scene.heights[first + y * columns + x] if d[2] >= 0.0 else -shape[at.BASE]
        point = x * wide - shape[at.HALF], y * high - shape[at.HALF + 1], z
        if dot(point, d) > most:
            found, most = point, dot(point, d)
    return found


@part(error_model="numpy")
def on_segment(a: Vector, b: Vector) -> Nearest:
    """Return the point of a segment next to 0."""
    ab = minus(b, a)
    t = -dot(a, ab)
    if t <= 0.0:
        return a, 1, (a, O, O, O)
    whole = dot(ab, ab)
    if t >= whole:
        return b, 1, (b, O, O, O)
    return plus(a, ab, t / whole), 2, (a, b, O, O)


@part(error_model="numpy")
def nearer(one: Nearest, two: Nearest) -> Nearest:
    return one if dot(one[0], one[0]) <= dot(two[0], two[0]) else two


@part(inline=False, error_model="numpy")
def on_triangle(a: Vector, b: Vector, c: Vector) -> Nearest:
    """Return the point of a triangle next to 0; one that is next to a line is taken for its edges."""
    ab, bc = minus(b, a), minus(c, b)
    normal = cross(ab, bc)
    whole = dot(normal, normal)
    if whole > FLAT * dot(ab, ab) * dot(bc, bc):
        of_a, of_b, of_c = dot(cross(b, c), normal), dot(cross(c, a), normal), dot(cross(a, b), normal)
        if of_a >= 0.0 and of_b >= 0.0 and of_c >= 0.0:
            scale = dot(a, normal) / whole
            return (normal[0] * scale, normal[1] * scale, normal[2] * scale), 3, (a, b, c, O)
    return nearer(nearer(on_segment(a, b), on_segment(b, c)), on_segment(c, a))


@part(error_model="numpy")
def beyond(a: Vector, b: Vector, c: Vector, d: Vector) -> bool:
    """Return whether 0 is on the other side of the plane of a, b and c than d."""
    normal = cross(minus(b, a), minus(c, a))
    return dot(a, normal) * dot(minus(d, a), normal) >= 0.0


@part(inline=False, error_model="numpy")
def on_tetrahedron(a: Vector, b: Vector, c: Vector, d: Vector) -> Nearest:
    """Return the point of a tetrahedron next to 0: 0 itself, with four corners, if it is inside.

    All four faces are considered otherwise, since sides of a flat one are all rounding.
    """
    if not (beyond(a, b, c, d) or beyond(a, b, d, c) or beyond(a, c, d, b) or beyond(b, c, d, a)):
        return O, 4, (a, b, c, d)
    one = nearer(on_triangle(a, b, c), on_triangle(a, b, d))
    return nearer(one, nearer(on_triangle(a, c, d), on_triangle(b, c, d)))


@part(error_model="numpy")
def with_corner(simplex: Simplex, count: int, corner: Vector) -> Nearest:
    """Return the point next to 0 of a simplex and another corner."""
    if count == 1:
        return on_segment(corner, simplex[0])
    if count == 2:
        return on_triangle(corner, simplex[0], simplex[1])
    return on_tetrahedron(corner, simplex[0], simplex[1], simplex[2])


@part(inline=False, error_model="numpy")
def distance(scene: Scene, shape: Shape, cell: int, hull: Hull, near_m: float, far_m: float) -> float:
    """Return the distance, m, between hull and shape, 0 if they meet; of a CAPSULE that from its core.

    What is known to be at most `near_m`, or more than `far_m`, may be returned too large within these.
    """
    v = hull[0]
    if dot(v, v) == 0.0:
        return 0.0
    count, simplex, last = 0, (O, O, O, O), math.inf
    for _ in range(ROUNDS):
        back = (-v[0], -v[1], -v[2])
        corner = minus(farthest_of_hull(hull, back), farthest(scene, shape, cell, v))
        square, lead = dot(v, v), dot(v, corner)
        if lead > 0.0 and lead * lead > far_m * far_m * square:
            return math.sqrt(square)
        if count > 0 and (square <= near_m * near_m or square - lead <= ENOUGH * square):
            break
        if count == 0:
            v, count, simplex = corner, 1, (corner, O, O, O)
        else:
            v, count, simplex = with_corner(simplex, count, corner)
        square = dot(v, v)
        if count == 4 or square <= NOTHING_M * NOTHING_M or square >= last:
            break
        last = square
    return 0.0 if count == 4 else math.sqrt(dot(v, v))
