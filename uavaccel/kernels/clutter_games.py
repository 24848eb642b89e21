"""Games of Navigate sampled as arithmetic, as kernels/lane_games does it for the obstacle lane: goals, and worlds."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from uavaccel.kernels.lane_games import INDICES, OF_LAYOUT, OWN, STREAMS, deal_index, deal_seeds
from uavaccel.kernels.lanes import Games
from uavaccel.kernels.operands import Operand
from uavaccel.sim.clutter import CLUTTER_FIELDS
from uavaccel.sim.parts import part, times
from uavaccel.sim.pcg64 import STREAM_FIELDS, pool_of, start, unit

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
