"""Collision test of a vehicle's hull with the shapes of any still scene, and a bound on the distance to them.

As in `kernels.touching`, which does the same for what is upright in a lane, and calls these functions for a scene.
"""

from __future__ import annotations

import math
from typing import Any, TypeAlias

from uavaccel.kernels import scene as at
from uavaccel.kernels.fields import BOX, CYLINDER, PLANE, Vector
from uavaccel.kernels.rays import cross, dot, minus, plus
from uavaccel.kernels.scene import Scene, Shape, into
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
UPRIGHT = 1e-20  # of a direction: less of it beside a hull's axis is rounding, and may be along that axis
NO_CELL = -1
O = (0.0, 0.0, 0.0)  # noqa: E741


@part(error_model="numpy")
def farthest_of_hull(hull: Hull, d: Vector) -> Vector:
    """Return the point of a hull that is farthest in a direction."""
    centre, axis, radius, half = hull
    lift = dot(axis, d)
    flat = plus(d, axis, -lift)
    flat = plus(flat, axis, -dot(axis, flat))  # again, for directions that are along the axis but for rounding
    length = math.sqrt(dot(flat, flat))
    point = plus(centre, axis, half if lift >= 0.0 else -half)
    return plus(point, flat, radius / length) if length > UPRIGHT * abs(lift) else point


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


Share: TypeAlias = tuple[int, int]
"""A thread's share of what may be touched: its index among the threads of the lane, and their number."""

NOTHING = -1
RINGS = 4  # of cells around the vehicle, in which the nearest shape is searched
WINDOW = 3  # cells of a height field in each direction
MET_M = 1.5e-7  # MuJoCo finds contacts of most shapes at distances of up to 1e-6 m, half of them from this one on
LESS_M = 0.02  # metres by which a hull shrinks, to find which of several shapes it is in most deeply


@part(error_model="numpy")
def seen_from(shape: Shape, place: Any) -> Vector:
    """Return a place in a shape's axes, from its centre."""
    c = at.CENTRE
    return into(shape, (place[0] - shape[c], place[1] - shape[c + 1], place[2] - shape[c + 2]))


@part(error_model="numpy")
def reach_beyond(p: float, half: float) -> float:
    return max(abs(p) - half, 0.0)


@part(inline=False, error_model="numpy")
def above_ground(scene: Scene, shape: Shape, p: Vector) -> float:
    """Return a lower bound of the distance from a point to a height field: from its heights nearby."""
    columns, lines = int(shape[at.COUNT]), int(shape[at.LINES])
    wide, high = 2.0 * shape[at.HALF] / (columns - 1), 2.0 * shape[at.HALF + 1] / (lines - 1)
    beside, across = reach_beyond(p[0], shape[at.HALF]), reach_beyond(p[1], shape[at.HALF + 1])
    middle = 0.5 * (shape[at.HALF + 2] - shape[at.BASE])
    lift = reach_beyond(p[2] - middle, 0.5 * (shape[at.HALF + 2] + shape[at.BASE]))
    boxed = math.sqrt(beside * beside + across * across + lift * lift)
    if boxed > WINDOW * min(wide, high):
        return boxed
    u, v = at.whole((p[0] + shape[at.HALF]) / wide), at.whole((p[1] + shape[at.HALF + 1]) / high)
    top, first = -shape[at.BASE], int(shape[at.DATA])
    for row in range(max(v - WINDOW, 0), min(v + WINDOW + 2, lines)):
        for column in range(max(u - WINDOW, 0), min(u + WINDOW + 2, columns)):
            top = max(top, scene.heights[first + row * columns + column])
    return max(boxed, min(max(p[2] - top, -p[2] - shape[at.BASE]), WINDOW * min(wide, high)))


@part(error_model="numpy")
def distance_lower_bound(scene: Scene, shape: Shape, place: Any) -> float:
    """Return a lower bound of the distance from a point to a shape; 0 or less inside."""
    kind, p = int(shape[at.KIND]), seen_from(shape, place)
    if kind == PLANE:
        return p[2]
    if kind == at.HEIGHTS:
        return above_ground(scene, shape, p)
    x, y, z = shape[at.HALF], shape[at.HALF + 1], shape[at.HALF + 2]
    above = reach_beyond(p[2], z)
    if kind == CYLINDER or kind == at.CAPSULE:
        aside = math.sqrt(p[0] * p[0] + p[1] * p[1])
        if kind == at.CAPSULE:
            return math.sqrt(aside * aside + above * above) - x
        aside = max(aside - x, 0.0)
        return math.sqrt(aside * aside + above * above)
    beside, across = reach_beyond(p[0], x), reach_beyond(p[1], y)
    boxed = math.sqrt(beside * beside + across * across + above * above)
    if kind == at.ELLIPSOID:
        scaled = math.sqrt((p[0] / x) ** 2 + (p[1] / y) ** 2 + (p[2] / z) ** 2)
        return max(boxed, (scaled - 1.0) * min(x, y, z))
    return max(boxed, math.sqrt(dot(p, p)) - shape[at.BOUND])


@part(error_model="numpy")
def nearest_in_cell(scene: Scene, world: int, column: int, row: int, place: Any, share: Share) -> float:
    """Return a lower bound of the distance from a point to the shapes of a cell."""
    frame, best = scene.frame[world], math.inf
    if 0 <= column < int(frame[at.COLUMNS]) and 0 <= row < int(frame[at.ROWS]):
        cell, (mine, threads) = row * int(frame[at.COLUMNS]) + column, share
        for entry in range(scene.start[world, cell] + mine, scene.start[world, cell + 1], threads):
            shape = scene.shapes[world, scene.items[world, entry]]
            best = min(best, distance_lower_bound(scene, shape, place))
    return best


@part(inline=False, error_model="numpy")
def nearest_shape(scene: Scene, world: int, place: Any, share: Share) -> float:
    """Return a lower bound of the distance from a point to a thread's `share` of the shapes of a world."""
    frame, (mine, threads) = scene.frame[world], share
    best = math.inf
    for loose in range(mine, int(frame[at.LOOSE]), threads):
        best = min(best, distance_lower_bound(scene, scene.shapes[world, loose], place))
    cell = frame[at.CELL]
    x, y = (place[0] - frame[at.LEFT]) / cell, (place[1] - frame[at.LOW]) / cell
    column, row = at.whole(x), at.whole(y)
    u, v = x - column, y - row
    edge = cell * min(u, v, 1.0 - u, 1.0 - v)
    for ring in range(RINGS):
        for up in range(-ring, ring + 1):
            whole = up == -ring or up == ring
            for right in range(-ring, ring + 1, 1 if whole else max(2 * ring, 1)):
                best = min(best, nearest_in_cell(scene, world, column + right, row + up, place, share))
        clear = edge + ring * cell
        if best <= clear:
            return best
    return min(best, edge + (RINGS - 1) * cell)


@part(error_model="numpy")
def reach_of(hull: Hull, axis: int) -> float:
    """Return a hull's reach from its centre along an axis of the shape."""
    tilt = hull[1][axis]
    return hull[2] * math.sqrt(max(1.0 - tilt * tilt, 0.0)) + hull[3] * abs(tilt)


@part(inline=False, error_model="numpy")
def over_ground(scene: Scene, shape: Shape, hull: Hull, near_m: float, far_m: float) -> float:
    """Return the distance between a hull and a height field, as `gjk.distance` does."""
    columns, lines = int(shape[at.COUNT]), int(shape[at.LINES])
    (x, y, z), best = hull[0], math.inf
    wide, high = 2.0 * shape[at.HALF] / (columns - 1), 2.0 * shape[at.HALF + 1] / (lines - 1)
    reach_x, reach_y, reach_z = reach_of(hull, 0), reach_of(hull, 1), reach_of(hull, 2)
    first_x, last_x = at.cell_range(x, reach_x, -shape[at.HALF], wide, columns - 1)
    first_y, last_y = at.cell_range(y, reach_y, -shape[at.HALF + 1], high, lines - 1)
    if z + reach_z < -shape[at.BASE]:
        return best
    for row in range(first_y, last_y):
        for column in range(first_x, last_x):
            first = int(shape[at.DATA]) + row * columns + column
            top = max(scene.heights[first], scene.heights[first + columns + 1])
            top = max(top, scene.heights[first + 1], scene.heights[first + columns])
            if z - reach_z > top:
                continue
            cell = 2 * (row * (columns - 1) + column)
            for triangle in range(2):
                best = min(best, distance(scene, shape, cell + triangle, hull, near_m, far_m))
    return best


@part(error_model="numpy")
def gap(scene: Scene, shape: Shape, hull: Hull, near_m: float, far_m: float) -> float:
    """Return the distance between a hull and a shape, 0 or less if they meet, as `gjk.distance` does."""
    kind = int(shape[at.KIND])
    if kind == PLANE:
        return hull[0][2] - reach_of(hull, 2)
    if kind == at.HEIGHTS:
        return over_ground(scene, shape, hull, near_m, far_m)
    core = shape[at.HALF] if kind == at.CAPSULE else 0.0
    return distance(scene, shape, NO_CELL, hull, near_m + core, far_m + core) - core


@part(inline=False, error_model="numpy")
def depth_in(scene: Scene, shape: Shape, place: Any, radius_m: float, half_m: float) -> float:
    """Return a negative number if a hull at a pose (7,) meets a shape, the lower the deeper, else inf."""
    w, i, j, k = place[3], place[4], place[5], place[6]
    axis = 2 * (i * k + w * j), 2 * (j * k - w * i), w * w - i * i - j * j + k * k
    hull = seen_from(shape, place), into(shape, axis), radius_m, half_m
    x, y, z = hull[0]
    reach_m = math.sqrt(radius_m * radius_m + half_m * half_m) + shape[at.BOUND]
    if x * x + y * y + z * z > reach_m * reach_m:
        return math.inf
    kind, less_m, apart_m = int(shape[at.KIND]), min(LESS_M, 0.5 * half_m, 0.5 * radius_m), 0.0
    met_m = 0.0 if kind == at.CAPSULE or kind == PLANE else MET_M
    for shrunk in range(2):  # one call, since a GPU's compiler copies what it calls
        small = hull[0], hull[1], radius_m - less_m * shrunk, half_m - less_m * shrunk
        apart_m = gap(scene, shape, small, 0.0 if shrunk else met_m, math.inf if shrunk else met_m)
        if not shrunk and apart_m > met_m:
            return math.inf
    return min(apart_m, less_m) - 2.0 * less_m


@part(inline=False, error_model="numpy")
def deepest_shape(
    scene: Scene, world: int, place: Any, radius_m: float, half_m: float, share: Share
) -> tuple[int, float]:
    """Return that of a thread's `share` of shapes which a hull at a pose (7,) is in most deeply, and how deep.

    It is NOTHING, and 0, if there is none.
    """
    frame, (mine, threads) = scene.frame[world], share
    found, deepest, reach_m = NOTHING, 0.0, math.sqrt(radius_m * radius_m + half_m * half_m)
    columns, rows = int(frame[at.COLUMNS]), int(frame[at.ROWS])
    first_x, last_x = at.cell_range(place[0], reach_m, frame[at.LEFT], frame[at.CELL], columns)
    first_y, last_y = at.cell_range(place[1], reach_m, frame[at.LOW], frame[at.CELL], rows)
    wide = max(last_x - first_x, 0)
    for number in range(-1, wide * max(last_y - first_y, 0)):  # -1: what is in no cell
        cell = (first_y + number // max(wide, 1)) * columns + first_x + number % max(wide, 1)
        first = 0 if number < 0 else scene.start[world, cell]
        last = int(frame[at.LOOSE]) if number < 0 else scene.start[world, cell + 1]
        for entry in range(first + mine, last, threads):
            item = entry if number < 0 else scene.items[world, entry]
            depth = depth_in(scene, scene.shapes[world, item], place, radius_m, half_m)
            if depth < deepest:
                found, deepest = item, depth
    return found, deepest
