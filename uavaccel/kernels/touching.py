"""Collision test of a vehicle's hull with the solids around it, and a bound on the time until one is possible.

Where `solids` is a `Scene`, `kernels.scene_touching` does the test, and `count` is the world; what follows is about
arrays of solids. The hull is a flat upright cylinder in the body frame; the solids are axis-aligned boxes, upright
cylinders, and planes facing up. Two convex bodies are disjoint if and only if some direction separates them. Over the
horizontal directions the separation is concave along a chord, so golden-section search finds its maximum. Only at the
rim of a post's top, where hull and post meet edge to edge, does MuJoCo report slightly fewer contacts.

All quantities are in metres and in MuJoCo's axes: x north, y west, z up.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import types
from numba.extending import overload
from numpy.typing import NDArray

from uavaccel.kernels.fields import CYLINDER, PLANE, Operand
from uavaccel.kernels.scene import world_of
from uavaccel.kernels.scene_touching import NOTHING, Share, deepest_shape, nearest_shape
from uavaccel.sim.parts import part
from uavaccel.sim.vehicle.clearance import MARGIN_M, free_s
from uavaccel.sim.vehicle.quadrotor import Record

SOLID_FIELDS = 7  # centre x, y, z; half sizes x, y, z, for a cylinder radius, radius, half height; kind
SEARCH_STEPS = 40
SHRINK = 0.6180339887498949  # golden section

Solids = NDArray[np.float64]
Pair = tuple[float, float, float, float, Solids, float, float]
"""A hull's offset and its axis, x and y each, from a solid; the solid; the hull's radius and half height."""

ALL: Share = (0, 1)


@part
def distance_to(solid: Solids, x: float, y: float, z: float) -> float:
    """Return a lower bound of the distance from a point to a solid: that to its bounding box, or to the plane."""
    if solid[6] == PLANE:
        return z - solid[2]
    beside = max(abs(x - solid[0]) - solid[3], 0.0)
    across = max(abs(y - solid[1]) - solid[4], 0.0)
    above = max(abs(z - solid[2]) - solid[5], 0.0)
    return math.sqrt(beside * beside + across * across + above * above)


def least_of_all(distance_m: float, threads: int) -> float:
    """Return the least distance that any thread of a lane has found; on the CPU a lane has one (kernels/cuda)."""
    return distance_m


def deepest_of_all(found: int, depth_m: float, threads: int) -> int:
    """Return the solid with the lowest `depth_m` that any thread of a lane has found; on a tie the later one."""
    return found


@overload(least_of_all)
def _least_of_one(distance_m, threads):  # type: ignore[no-untyped-def]  # numba compares it with the lambda
    return lambda distance_m, threads: distance_m


@overload(deepest_of_all)
def _deepest_of_one(found, depth_m, threads):  # type: ignore[no-untyped-def]
    return lambda found, depth_m, threads: found


@part
def nearest_solid(solids: Solids, count: int, place: NDArray[np.float64], share: Share) -> float:
    """Return a lower bound of the distance from a point to a thread's share of solids."""
    distance_m, (first, threads) = np.inf, share
    for solid in range(first, count, threads):
        distance_m = min(distance_m, distance_to(solids[solid], place[0], place[1], place[2]))
    return distance_m


def nearest(solids: Operand, count: int, place: NDArray[np.float64], share: Share) -> float:  # type: ignore[empty-body]
    """Return `nearest_solid`, or `nearest_shape` of a scene's world."""


def deepest(  # type: ignore[empty-body]
    solids: Operand, count: int, place: NDArray[np.float64], radius_m: float, half_height_m: float, share: Share
) -> tuple[int, float]:
    """Return `deepest_solid`, or `deepest_shape` in a scene's world."""


def around(solids: Operand, counts: Operand, game: int) -> tuple[Any, int]:  # type: ignore[empty-body]
    """Return a game's solids and their number, or the scene and the game's world in it."""


@part(inline=False)
def free_ticks(
    parameters: Record,
    state: Record,
    place: NDArray[np.float64],
    solids: Operand,
    count: int,
    reach_m: float,
    share: Share,
) -> int:
    """Return the ticks for which no collision is possible, whatever the autopilot does.

    `reach_m` is the radius of the hull's bounding sphere.
    """
    gap_m = least_of_all(nearest(solids, count, place, share), share[1]) - reach_m - MARGIN_M
    return int(free_s(parameters, state, gap_m) / parameters.tick_s)


@part
def reach(along: float, length: float, radius_m: float, half_height_m: float) -> float:
    """Return the hull's support in a direction of this length, whose dot product with the hull's axis is `along`."""
    across = math.sqrt(max(length * length - along * along, 0.0))
    return radius_m * across + half_height_m * abs(along)


@part
def gap_along(turned: bool, t: float, pair: Pair) -> float:
    """Return the separation of hull and solid along (1, t), or (t, 1) where `turned`, times that vector's length."""
    x, y, ax, ay, solid, radius_m, half_m = pair
    u, v = (t, 1.0) if turned else (1.0, t)
    length = math.sqrt(u * u + v * v)
    half = solid[3] * length if solid[6] == CYLINDER else solid[3] * abs(u) + solid[4] * abs(v)
    return x * u + y * v - half - reach(ax * u + ay * v, length, radius_m, half_m)


@part(inline=False)
def widest_gap(turned: bool, pair: Pair) -> float:
    """Return the largest `gap_along` for t in [-1, 1], or the first positive one, which proves the bodies disjoint."""
    low, high = -1.0, 1.0
    best = gap_along(turned, 0.0, pair)
    for _ in range(SEARCH_STEPS):
        if best > 0.0:
            break
        a, b = high - SHRINK * (high - low), low + SHRINK * (high - low)
        left, right = gap_along(turned, a, pair), gap_along(turned, b, pair)
        best = max(best, left, right)
        if left > right:
            high = b
        else:
            low = a
    return best


@part
def separation(place: NDArray[np.float64], solid: Solids, radius_m: float, half_height_m: float) -> float:
    """Return a number that is positive if the hull at a pose (7,) and a solid are disjoint, and falls with depth."""
    w, i, j, k = place[3], place[4], place[5], place[6]
    ax, ay, az = 2 * (i * k + w * j), 2 * (j * k - w * i), w * w - i * i - j * j + k * k
    vertical = reach(az, 1.0, radius_m, half_height_m)
    if solid[6] == PLANE:
        return place[2] - solid[2] - vertical
    above = abs(place[2] - solid[2]) - solid[5] - vertical
    if above > 0.0:
        return above
    x, y = place[0] - solid[0], place[1] - solid[1]
    if x < 0.0:
        x, ax = -x, -ax
    if y < 0.0:
        y, ay = -y, -ay
    pair = x, y, ax, ay, solid, radius_m, half_height_m
    ahead = widest_gap(False, pair)
    return ahead if ahead > 0.0 else max(above, ahead, widest_gap(True, pair))


@part
def deepest_solid(
    solids: Solids, count: int, place: NDArray[np.float64], radius_m: float, half_height_m: float, share: Share
) -> tuple[int, float]:
    """Return that of a thread's share of solids which the hull penetrates most deeply, and a measure of that."""
    found, deepest_m, (first, threads) = NOTHING, 0.0, share
    reach_m = math.sqrt(radius_m * radius_m + half_height_m * half_height_m)
    for solid in range(first, count, threads):
        if distance_to(solids[solid], place[0], place[1], place[2]) > reach_m:
            continue
        apart = separation(place, solids[solid], radius_m, half_height_m)
        if apart <= deepest_m:
            found, deepest_m = solid, apart
    return found, deepest_m


@part(inline=False)
def touched(
    place: NDArray[np.float64], solids: Operand, count: int, radius_m: float, half_height_m: float, share: Share
) -> int:
    """Return the solid, or shape, that the hull at a pose (7,) penetrates most deeply, or NOTHING."""
    found, depth_m = deepest(solids, count, place, radius_m, half_height_m, share)
    return deepest_of_all(found, depth_m, share[1])


def _nearest(solids, count, place, share):  # type: ignore[no-untyped-def]
    function = nearest_shape if isinstance(solids, types.BaseTuple) else nearest_solid
    return lambda solids, count, place, share: function(solids, count, place, share)


def _deepest(solids, count, place, radius_m, half_height_m, share):  # type: ignore[no-untyped-def]
    function = deepest_shape if isinstance(solids, types.BaseTuple) else deepest_solid

    def chosen(solids, count, place, radius_m, half_height_m, share):  # type: ignore[no-untyped-def]
        return function(solids, count, place, radius_m, half_height_m, share)

    return chosen


def _around(solids, counts, game):  # type: ignore[no-untyped-def]
    if isinstance(solids, types.BaseTuple):
        return lambda solids, counts, game: (solids, world_of(solids, game))
    return lambda solids, counts, game: (solids[game], counts[game])


BY_TYPE = ((nearest, _nearest), (deepest, _deepest), (around, _around))
"""Functions whose implementation depends on what is around, with what chooses it by type, for numba's `overload`."""

for _function, _chosen in BY_TYPE:
    overload(_function)(_chosen)
