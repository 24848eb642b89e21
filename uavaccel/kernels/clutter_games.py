"""Games of Navigate sampled as arithmetic, as kernels/lane_games does it for the obstacle lane: goals, and worlds."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit

from uavaccel.kernels import scene as at
from uavaccel.kernels.fields import Operand
from uavaccel.kernels.lane_games import INDICES, OF_LAYOUT, OWN, STREAMS, deal_index, deal_seeds
from uavaccel.kernels.lanes import Games
from uavaccel.kernels.scene import CELLS_A_SHAPE, Scene, as_seen, empty_scene, list_shapes
from uavaccel.sim import clutter as of
from uavaccel.sim.clutter import CLUTTER_FIELDS, Clutter, reach_of
from uavaccel.sim.parts import part, times
from uavaccel.sim.pcg64 import STREAM_FIELDS, pool_of, start, unit
from uavaccel.sim.vehicle.hotloop import sources


def clutter_worlds(clutter: Clutter, always: Scene, worlds: int) -> tuple[Scene, Scene]:
    """Allocate worlds for layouts of a distribution, with the shapes of a scene's only world: to touch, and to see.

    The two have the same cells, in the same memory.
    """
    large, first = clutter.half_m[1], always.shapes.shape[1]
    reach = math.sqrt(2.0) * large + at.LISTING_MARGIN_M  # of a turned box
    wide, high = of.NORTH_M[1] - of.NORTH_M[0] + 2 * reach, 2 * (of.ASIDE_M + reach)
    cell = max(math.sqrt(wide * high / (CELLS_A_SHAPE * max(clutter.shapes, 1))), 1.0)
    columns, rows = math.ceil(wide / cell), math.ceil(high / cell)
    entries = clutter.shapes * (math.floor(2 * (reach + at.LISTING_MARGIN_M) / cell) + 2) ** 2
    scene = empty_scene(worlds, first + clutter.shapes, columns * rows, entries, seen=False)
    frame = np.zeros(at.FRAME_FIELDS)
    frame[[at.LEFT, at.LOW, at.CELL]] = of.NORTH_M[0] - reach, -of.ASIDE_M - reach, cell
    frame[[at.COLUMNS, at.ROWS, at.LOOSE, at.SHAPES]] = columns, rows, first, first + clutter.shapes
    frame[[at.BOTTOM, at.TOP]] = -large, max(2 * of.PILLAR_HALF_M, of.CENTRES_M[1] + large)
    scene.frame[:], scene.shapes[:, :first] = frame, always.shapes[0]
    scene.shapes[:, first:, at.GEOM] = np.arange(first, first + clutter.shapes)
    scene.shapes[:, first:, at.MATERIAL] = -1
    return scene, as_seen(scene)


@part
def put_shape(row: Any, shape: Any) -> None:
    """Write a row of a layout as a shape; a parked one has no extent."""
    shape[at.KIND], shape[at.BOUND], shape[at.REACH] = row[of.KIND], 0.0, reach_of(row) + at.LISTING_MARGIN_M
    for axis in range(3):
        shape[at.CENTRE + axis], shape[at.HALF + axis] = row[of.X + axis], row[of.HALF_X + axis]
        shape[at.RGB + axis] = row[of.GREY]
    shape[at.AXES], shape[at.AXES + 1], shape[at.AXES + 2] = row[of.COS], -row[of.SIN], 0.0
    shape[at.AXES + 3], shape[at.AXES + 4], shape[at.AXES + 5] = row[of.SIN], row[of.COS], 0.0
    shape[at.AXES + 6], shape[at.AXES + 7], shape[at.AXES + 8] = 0.0, 0.0, 1.0
    if row[of.Z] > of.PARKED_Z_M:
        across, tall = reach_of(row), row[of.HALF_Z]
        round_ = int(row[of.KIND]) in (at.ELLIPSOID, at.CAPSULE)
        shape[at.BOUND] = max(across, tall) if round_ else math.sqrt(times(across, across) + times(tall, tall))


@part
def put_in_both(rows: Any, number: int, scene: Scene, seen: Scene, world: int) -> None:
    """Write one row of a layout into a world to touch, and if there are any, into one to see."""
    shape = int(scene.frame[world, at.LOOSE]) + number
    put_shape(rows[number], scene.shapes[world, shape])
    if world < len(seen.shapes):
        for field in range(at.GEOM):
            seen.shapes[world, shape, field] = scene.shapes[world, shape, field]


def _compile(stamp: int) -> Any:
    """Compile the entry point, or load it from numba's cache; `stamp` as in kernels/pictures."""

    @njit(cache=True, nogil=True)
    def put(rows, scene, seen, world):  # type: ignore[no-untyped-def]
        for number in range(len(rows) * (stamp != 0)):
            put_in_both(rows, number, scene, seen, world)
        list_shapes(scene, world)

    return put


put_clutter = _compile(sources(__name__))
"""`put_clutter(rows, scene, seen, world)` writes a layout (n, CLUTTER_FIELDS) into worlds to touch and to see."""


# Numbers of a distribution, float64.
FIRST_SEED, NOISY_EVENTS, NEAR_M, SPAN_M, ASIDE_RAD, ALTITUDE_M = range(6)
NUMBERS = 6


class Distribution(NamedTuple):
    """The distribution of a task's games."""

    numbers: Operand
    """(NUMBERS,) float64."""
    clutter: Operand
    """(sim/clutter.NUMBERS,) float64: Clutter.numbers()."""


class Deals(NamedTuple):
    """What is sampled from and written beside the games' rows, for L lanes."""

    streams: Operand
    given: Operand
    indices: Operand
    """As in kernels/lane_games, of worlds."""
    goals: Operand
    """(L, 3) float64: goals of the latest games, NED, m."""
    layouts: Operand
    """(L, n, CLUTTER_FIELDS) float64: their worlds (sim/clutter)."""


def deals(lanes: int, shapes: int) -> Deals:
    """Allocate deals for `lanes` lanes with worlds of `shapes` shapes."""
    streams, layouts = np.zeros((lanes, STREAMS, STREAM_FIELDS), np.uint64), np.zeros((lanes, shapes, CLUTTER_FIELDS))
    return Deals(streams, np.full(lanes, -1), np.zeros(lanes, np.int64), np.zeros((lanes, 3)), layouts)


@part
def deal(lane: int, distribution: Distribution, deals: Deals, games: Games) -> None:
    """Sample a lane's next goal, in the order in which the environment does, and start its layout's stream."""
    own, numbers, goal = deals.streams[lane, OWN], distribution.numbers, deals.goals[lane]
    index = deal_index(lane, deals, INDICES)
    far, aside = unit(own), unit(own)
    far_m = numbers[NEAR_M] + times(far, numbers[SPAN_M])
    bearing = times(numbers[ASIDE_RAD], times(2.0, aside) - 1.0)
    goal[0], goal[1], goal[2] = far_m * math.cos(bearing), far_m * math.sin(bearing), -numbers[ALTITUDE_M]
    deal_seeds(lane, deals, games, numbers[NOISY_EVENTS] > 0.0)
    stream = deals.streams[lane, OF_LAYOUT]
    start(stream, pool_of(np.uint64(index + np.int64(numbers[FIRST_SEED]))))
