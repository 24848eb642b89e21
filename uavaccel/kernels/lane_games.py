"""Games of the obstacle lane sampled as arithmetic, in loops on the CPU or by CUDA kernels: no Python a game.

Numbers are drawn in the order in which the environment and sim/lane draw them, from NumPy's own streams
(sim/pcg64), so that a game is the one that the exact simulator flies. Only what differs from game to game is
written; the rest of a row is that of any game of the task.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from uavaccel.kernels import fields as at
from uavaccel.kernels.fields import Operand
from uavaccel.kernels.lanes import EVENT_SEED, PICTURE_SEED, Games
from uavaccel.sim.lane import AMBIENT, DAYLIGHT, SPLIT_SIZE, SUN_ELEVATION_RAD, WIDTH_M
from uavaccel.sim.parts import part, times
from uavaccel.sim.pcg64 import ONE, STREAM_FIELDS, below, first_word, pool_of, spawned, start, unit, word
from uavaccel.vision.noise import APART

OWN, OF_LAYOUT, BEFORE = range(
    3
)  # streams of a lane: its environment's, the layout's, and its own before the last game
STREAMS = 3

# Numbers of a distribution, float64.
FIRST_SEED, ROWS, PER_ROW, SLACK_M, PITCH_M, VARIED = range(6)
(LIGHT_LOW, LIGHT_SPAN, WIND_M_S, LIT, NOISY_EVENTS) = range(6, 11)
NUMBERS = 11

INDICES, TEXTURES, WALLS, GROUNDS = np.uint64(SPLIT_SIZE), np.uint64(4), np.uint64(2), np.uint64(2)
NOISE_KEY = np.uint64(APART)
LEVEL, DOWNWARDS = math.cos(SUN_ELEVATION_RAD), math.sin(SUN_ELEVATION_RAD)


class Distribution(NamedTuple):
    """The distribution of a task's lanes."""

    numbers: Operand
    """(NUMBERS,) float64."""
    wearing: Operand
    """(3, 4) int32: Appearance.wearing."""


class Deals(NamedTuple):
    """What is sampled from and written beside the games' rows, for L lanes."""

    streams: Operand
    """(L, STREAMS, STREAM_FIELDS) uint64."""
    given: Operand
    """(L,) int64: the lane's index that the next game is to have, -1 for a sampled one."""
    indices: Operand
    """(L,) int64: the lane's index of the latest game."""


def deals(lanes: int) -> Deals:
    """Allocate deals for `lanes` lanes."""
    streams = np.zeros((lanes, STREAMS, STREAM_FIELDS), np.uint64)
    return Deals(streams, np.full(lanes, -1), np.zeros(lanes, np.int64))


@part
def deal(lane: int, distribution: Distribution, deals: Deals, games: Games) -> None:
    """Sample a lane's next game into its row of `games`, which has the lane's number."""
    numbers, index = distribution.numbers, deal_index(lane, deals, INDICES)
    deal_seeds(lane, deals, games, numbers[NOISY_EVENTS] > 0.0)
    stream = deals.streams[lane, OF_LAYOUT]
    start(stream, pool_of(np.uint64(index + np.int64(numbers[FIRST_SEED]))))
    place_posts(lane, numbers, stream, games)
    direction = -math.pi + times(2.0 * math.pi, unit(stream))
    games.start[lane].wind[0] = numbers[WIND_M_S] * math.cos(direction)
    games.start[lane].wind[1] = numbers[WIND_M_S] * math.sin(direction)
    dress(lane, distribution, stream, games)


@part
def deal_index(lane: int, deals: Operand, count: np.uint64) -> np.int64:
    """Return the index, below `count`, of a lane's next lane or world: one that is given, or a sampled one."""
    own = deals.streams[lane, OWN]
    for field in range(STREAM_FIELDS):
        deals.streams[lane, BEFORE, field] = own[field]
    index = np.int64(below(own, count))
    if deals.given[lane] >= 0:
        index = deals.given[lane]
    deals.given[lane], deals.indices[lane] = -1, index
    return index


@part
def deal_seeds(lane: int, deals: Operand, games: Games, noisy_events: bool) -> None:
    """Sample the seeds of the noise of a lane's next game."""
    noise = np.int64(first_word(spawned(pool_of(word(deals.streams[lane, OWN]) >> ONE), NOISE_KEY)))
    games.seeds[lane, PICTURE_SEED] = noise
    games.seeds[lane, EVENT_SEED] = noise if noisy_events else 0


@part
def place_posts(lane: int, numbers: Operand, stream: Operand, games: Games) -> None:
    """Place the posts of a lane, row by row from the start (sim/lane)."""
    per_row, solids = int(numbers[PER_ROW]), games.solids[lane]
    for row in range(int(numbers[ROWS])):
        first = row * per_row
        for place in range(first, first + per_row):  # sorted as they come
            sampled, slot = times(numbers[SLACK_M], unit(stream)), place
            while slot > first and solids[slot - 1, 1] > sampled:
                solids[slot, 1] = solids[slot - 1, 1]
                slot -= 1
            solids[slot, 1] = sampled
        for place in range(per_row):
            east_m = (solids[first + place, 1] + times(numbers[PITCH_M], float(place))) - WIDTH_M / 2
            solids[first + place, 1] = -east_m


@part
def dress(lane: int, distribution: Distribution, stream: Operand, games: Games) -> None:
    """Sample textures and light, and write them to the visible scene, if there is one (kernels/appearance)."""
    numbers, wearing = distribution.numbers, distribution.wearing
    posts, scene = int(numbers[ROWS] * numbers[PER_ROW]), games.scenes.solids[lane]
    varied, lit = numbers[VARIED], numbers[LIT] > 0.0
    for post in range(posts):
        scene[post, at.MATERIAL] = np.float32(unit(stream) < varied)
    for post in range(posts):
        kind = np.int64(below(stream, TEXTURES))
        scene[post, at.MATERIAL] = np.float32(wearing[0, kind if scene[post, at.MATERIAL] > np.float32(0.0) else 0])
        scene[post, 1] = np.float32(games.solids[lane, post, 1])
    plain = unit(stream) >= varied
    sampled_wall = np.int64(below(stream, WALLS))
    wall = np.int64(0) if plain else sampled_wall
    plain = unit(stream) >= varied
    sampled_ground = np.int64(below(stream, GROUNDS))
    ground = np.int64(0) if plain else sampled_ground
    for solid in range(posts, games.scenes.counts[lane]):
        is_ground = scene[solid, at.KIND] == np.float32(at.PLANE)
        scene[solid, at.MATERIAL] = np.float32(wearing[2, ground] if is_ground else wearing[1, wall])
    level = numbers[LIGHT_LOW] + times(numbers[LIGHT_SPAN], unit(stream))
    azimuth = -1.0 + times(2.0, unit(stream))
    if lit:
        lights = games.scenes.lights[lane]
        for channel in range(3):
            lights[at.AMBIENT + channel] = np.float32(level * AMBIENT)
            lights[at.DIFFUSE + channel] = np.float32(level * DAYLIGHT)
        lights[at.TOWARDS] = np.float32(-(LEVEL * math.cos(azimuth)))
        lights[at.TOWARDS + 1] = np.float32(LEVEL * math.sin(azimuth))
        lights[at.TOWARDS + 2] = np.float32(DOWNWARDS)
