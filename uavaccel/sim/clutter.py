"""Clutter: a world of shapes sampled from a seed, as arithmetic that is the same on a CPU, on a GPU and for MuJoCo.

Pillars, boxes and cylinders, stand on the ground; spheres and ellipsoids hang in the air. Start and goal are clear.
Metres, MuJoCo's axes (x north, y west, z up). There is no sine in it, only IEEE arithmetic with products that are
rounded before a sum (sim/parts), so that every machine samples the same bits.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any, Literal, Self, get_args

import mujoco
import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from uavaccel.config import Config, Share
from uavaccel.errors import UserError
from uavaccel.sim.lane import named
from uavaccel.sim.parts import njit, part, times
from uavaccel.sim.pcg64 import STREAM_FIELDS, pool_of, start, unit
from uavaccel.sim.scene import refit_bounding_boxes
from uavaccel.sim.vehicle.hotloop import sources

Numbers = NDArray[np.float64]
Kind = Literal["box", "cylinder", "ellipsoid", "sphere"]

BOX, CYLINDER, ELLIPSOID, CAPSULE = 0, 1, 3, 4
"""Kinds of shapes, as the kernels number them. A sphere is a CAPSULE without length."""

# A shape: a row of a layout. Half sizes of a round shape: radius, radius, half length. Yaw turns x towards y.
KIND, X, Y, Z, HALF_X, HALF_Y, HALF_Z, COS, SIN, GREY = range(10)
CLUTTER_FIELDS = 10

# A distribution as numbers, float64. SHARES: ends of the kinds' parts of 0 to 1, in the order of `Kind`.
SHAPES, LEFT, LONG, LOW, WIDE, SMALL, LARGER, LEVEL, HIGHER = range(9)
SHARES, CLEAR_START, CLEAR_GOAL, DARK, BRIGHTER, GAP = 9, 12, 13, 14, 15, 16
NUMBERS = 17
DRAWS = 9  # of a stream, that a shape takes

MOST_SHAPES = 256  # as many as clutter.xml provides
NORTH_M, ASIDE_M = (-4.0, 44.0), 24.0  # the area: from, to; half its width
PILLAR_HALF_M = 5.0
CENTRES_M = (0.5, 5.0)  # heights of the centres of what hangs in the air
PARKED_Z_M = -100.0
GREYS = (0.25, 0.95)
TURN = 0.41421356237309503  # the tangent of a sixteenth of a turn: yaw is at most an eighth of a turn

HalfSize = Annotated[float, Field(gt=0.0, le=5.0)]
Clear = Annotated[float, Field(ge=0.5, le=20.0)]


class Clutter(Config):
    """The distribution that worlds are sampled from."""

    shapes: Annotated[int, Field(ge=0, le=MOST_SHAPES)] = 128
    """Number of shapes in 48 m x 48 m; those that reach into the start or the goal are left out."""
    half_m: tuple[HalfSize, HalfSize] = (0.2, 0.8)
    """Range of half sizes and radii, metres."""
    boxes: Share = 0.35
    """Share of boxes, turned about the vertical, 10 m high; shares need not add up to 1."""
    cylinders: Share = 0.35
    """Share of upright cylinders, 10 m high."""
    ellipsoids: Share = 0.15
    """Share of ellipsoids in the air, turned about the vertical."""
    spheres: Share = 0.15
    """Share of spheres in the air."""
    clear_start_m: Clear = 2.0
    """Horizontal distance from the start, in metres, within which there is nothing."""
    clear_goal_m: Clear = 1.5
    """Horizontal distance from the goal, in metres, within which there is nothing."""
    gap_m: Annotated[float, Field(ge=0.0, le=20.0)] = 0.0
    """Least distance of shapes from each other, in metres, seen from above: one nearer to another is left out. With 0
    they may overlap."""

    @model_validator(mode="after")
    def _has_sizes_and_kinds(self) -> Self:
        if self.half_m[0] > self.half_m[1]:
            raise ValueError(f"half_m = {list(self.half_m)}: must be a range, from the smaller to the larger")
        if not sum(self.shares()) > 0.0:
            raise ValueError("boxes, cylinders, ellipsoids or spheres must be more than 0")
        return self

    def shares(self) -> tuple[float, float, float, float]:
        """Return the shares, in the order of `Kind`."""
        return self.boxes, self.cylinders, self.ellipsoids, self.spheres

    def numbers(self) -> Numbers:
        """Return what `sample_clutter` takes (NUMBERS,)."""
        (small, large), (left, right), (low, high), (dark, bright) = self.half_m, NORTH_M, CENTRES_M, GREYS
        ends = np.cumsum(self.shares())  # Python 3.12 changed how sum() rounds
        sizes = (small, large - small, low, high - low)
        area = (left, right - left, -ASIDE_M, 2 * ASIDE_M)
        clear = (self.clear_start_m, self.clear_goal_m)
        return np.array([self.shapes, *area, *sizes, *(ends[:3] / ends[3]), *clear, dark, bright - dark, self.gap_m])


@part
def sample_clutter(numbers: Any, stream: Any, goal_x: float, goal_y: float, rows: Any) -> int:
    """Sample a world from a stream (sim/pcg64) into rows (n, CLUTTER_FIELDS); return how many shapes stand.

    `numbers` are Clutter.numbers(). The first `numbers[SHAPES]` rows are written, at most n; each takes nine numbers
    of the stream. A shape that reaches into the start, at (0, 0), or into the goal, or that is too near to one before,
    is parked below the ground.
    """
    for number in range(min(int(numbers[SHAPES]), rows.shape[0])):
        sample_shape(numbers, stream, goal_x, goal_y, rows[number])
    return keep_gaps(numbers, rows)


@part
def sample_shape(numbers: Any, stream: Any, goal_x: float, goal_y: float, row: Any) -> None:
    """Sample one shape, which takes DRAWS numbers of the stream, and park it if it reaches into start or goal."""
    share = unit(stream)
    kind = CAPSULE
    if share < numbers[SHARES]:
        kind = BOX
    elif share < numbers[SHARES + 1]:
        kind = CYLINDER
    elif share < numbers[SHARES + 2]:
        kind = ELLIPSOID
    row[KIND] = float(kind)
    row[X] = numbers[LEFT] + times(numbers[LONG], unit(stream))
    row[Y] = numbers[LOW] + times(numbers[WIDE], unit(stream))
    for axis in range(3):
        row[HALF_X + axis] = numbers[SMALL] + times(numbers[LARGER], unit(stream))
    row[Z] = numbers[LEVEL] + times(numbers[HIGHER], unit(stream))
    if kind in (BOX, CYLINDER):
        row[Z] = row[HALF_Z] = PILLAR_HALF_M
    if kind in (CYLINDER, CAPSULE):
        row[HALF_Y] = row[HALF_X]
    if kind == CAPSULE:
        row[HALF_Z] = 0.0
    half = times(TURN, times(2.0, unit(stream)) - 1.0)  # the tangent of half the yaw
    squared = times(half, half)
    row[COS], row[SIN] = (1.0 - squared) / (1.0 + squared), times(2.0, half) / (1.0 + squared)
    if kind in (CYLINDER, CAPSULE):
        row[COS], row[SIN] = 1.0, 0.0
    row[GREY] = numbers[DARK] + times(numbers[BRIGHTER], unit(stream))
    if not (_away(row, 0.0, 0.0, numbers[CLEAR_START]) and _away(row, goal_x, goal_y, numbers[CLEAR_GOAL])):
        row[Z] = PARKED_Z_M


@part
def keep_gaps(numbers: Any, rows: Any) -> int:
    """Park shapes that are too near to one before, and return how many stand."""
    stand = 0
    for number in range(min(int(numbers[SHAPES]), rows.shape[0])):
        if rows[number, Z] > PARKED_Z_M and not _apart(rows, number, numbers[GAP]):
            rows[number, Z] = PARKED_Z_M
        stand += rows[number, Z] > PARKED_Z_M
    return stand


@part
def _away(row: Any, x: float, y: float, clear: float) -> bool:
    """Return whether no part of a shape, seen from above, is within `clear` of a place."""
    right, up = x - row[X], y - row[Y]
    along = abs(times(row[COS], right) + times(row[SIN], up))
    across = abs(times(row[COS], up) - times(row[SIN], right))
    if int(row[KIND]) == BOX:
        along, across = max(along - row[HALF_X], 0.0), max(across - row[HALF_Y], 0.0)
        return bool(times(along, along) + times(across, across) >= times(clear, clear))
    reach = clear + max(row[HALF_X], row[HALF_Y])
    return bool(times(along, along) + times(across, across) >= times(reach, reach))


@part
def _apart(rows: Any, number: int, gap: float) -> bool:
    """Return whether circles around a shape and those before it, seen from above, keep a gap; always without one."""
    row, reach = rows[number], reach_of(rows[number]) + gap
    for other in range(number if gap > 0.0 else 0):
        right, up, far = row[X] - rows[other, X], row[Y] - rows[other, Y], reach + reach_of(rows[other])
        if rows[other, Z] > PARKED_Z_M and times(right, right) + times(up, up) < times(far, far):
            return False
    return True


@part
def reach_of(row: Any) -> float:
    """Return the radius of a circle around a shape, seen from above."""
    if int(row[KIND]) == BOX:
        return math.sqrt(times(row[HALF_X], row[HALF_X]) + times(row[HALF_Y], row[HALF_Y]))
    return max(float(row[HALF_X]), float(row[HALF_Y]))


@dataclass(frozen=True)
class ClutterLayout:
    """The shapes of a world (n, CLUTTER_FIELDS), parked ones included."""

    rows: Numbers

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def standing(self) -> NDArray[np.bool_]:
        """Whether each shape (n,) stands, and is not parked."""
        found: NDArray[np.bool_] = self.rows[:, Z] > PARKED_Z_M
        return found

    def names(self) -> list[str]:
        """Return the kind of each shape."""
        kinds = dict(zip((BOX, CYLINDER, ELLIPSOID, CAPSULE), get_args(Kind), strict=True))
        return [kinds[int(kind)] for kind in self.rows[:, KIND]]


def sample_world(seed: int, clutter: Clutter, goal_m: tuple[float, float, float]) -> ClutterLayout:
    """Sample the world of a seed around a goal, NED; the same arguments give the same bits on every machine."""
    rows = np.zeros((clutter.shapes, CLUTTER_FIELDS))
    _sample(clutter.numbers(), np.uint64(seed), goal_m[0], -goal_m[1], rows)
    return ClutterLayout(rows)


def _compile(stamp: int) -> Callable[[Numbers, np.uint64, float, float, Numbers], int]:
    """Compile the entry point, or load it from numba's cache; `stamp` as in hotloop."""

    @njit(cache=True)
    def sample(numbers, seed, goal_x, goal_y, rows):  # type: ignore[no-untyped-def]
        stream = np.zeros(STREAM_FIELDS * (stamp != 0), np.uint64)
        start(stream, pool_of(seed))
        return sample_clutter(numbers, stream, goal_x, goal_y, rows)

    return sample


_sample = _compile(sources(__name__))


GEOMS = {
    BOX: mujoco.mjtGeom.mjGEOM_BOX,
    CYLINDER: mujoco.mjtGeom.mjGEOM_CYLINDER,
    ELLIPSOID: mujoco.mjtGeom.mjGEOM_ELLIPSOID,
    CAPSULE: mujoco.mjtGeom.mjGEOM_SPHERE,
}


def apply_clutter(model: mujoco.MjModel, data: mujoco.MjData, layout: ClutterLayout) -> None:
    """Place the layout's shapes in clutter.xml. Raises UserError if the scene has fewer, as all but the clutter do."""
    geoms, rows = named(model, "clutter_"), layout.rows
    if len(rows) > len(geoms):
        raise UserError(f"the clutter has {len(rows)} shapes, the scene {len(geoms)}: leave some out")
    used = geoms[: len(rows)]
    model.geom_pos[geoms, 2], model.geom_rgba[geoms, 3] = PARKED_Z_M, 0.0  # not drawn
    half, kind = rows[:, [HALF_X, HALF_Y, HALF_Z]], rows[:, KIND]
    round_, upright = kind == CAPSULE, kind == CYLINDER
    model.geom_type[used] = [int(GEOMS[int(each)]) for each in kind]
    boxes = np.where(round_[:, None], half[:, :1], half)
    model.geom_aabb[used, :3], model.geom_aabb[used, 3:] = 0.0, boxes
    model.geom_size[used] = np.where(upright[:, None], half[:, [0, 2, 2]], half)
    model.geom_size[used[round_], 1:] = 0.0
    model.geom_size[used[upright], 2] = 0.0
    across = np.where(kind == BOX, np.hypot(half[:, 0], half[:, 1]), np.maximum(half[:, 0], half[:, 1]))
    bound = np.where(kind == ELLIPSOID, np.maximum(across, half[:, 2]), np.hypot(across, half[:, 2]))
    model.geom_rbound[used] = bound
    model.geom_pos[used] = rows[:, X : Z + 1]
    cosine, sine = rows[:, COS], rows[:, SIN]
    along = np.sqrt((1.0 + cosine) / 2.0)  # the cosine of half the yaw, which is at most an eighth of a turn
    model.geom_quat[used] = np.stack([along, 0 * sine, 0 * sine, sine / (2.0 * along)], axis=1)
    model.geom_sameframe[used] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE  # else their turn goes unnoticed
    model.geom_rgba[used] = np.stack([*[rows[:, GREY]] * 3, layout.standing * 1.0], axis=1)
    refit_bounding_boxes(model, set(geoms.tolist()))
    mujoco.mj_kinematics(model, data)
