"""Lanes as arrays: what each flies now, and the games that they can begin. One row of code for the CPU and for a GPU.

A game's row holds what stays as it is while it is flown; a lane points at its game's, so that beginning a game copies a
flight's record and nothing else. `L` lanes with `K` games each have L * K rows, lane after lane.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from uavaccel.kernels.events import CAMERA_FIELDS
from uavaccel.kernels.fields import SOLIDS, Scenes
from uavaccel.kernels.flight import BODY_FIELDS, NEXT_LOOK, TOUCHED, fly_ticks
from uavaccel.kernels.operands import Operand
from uavaccel.kernels.touching import ALL, NOTHING, SOLID_FIELDS
from uavaccel.parts import part
from uavaccel.sim.vehicle.autopilot import POSITION, RATE, VELOCITY
from uavaccel.sim.vehicle.hotloop import kick, read_pose
from uavaccel.sim.vehicle.quadrotor import FLIGHT_DTYPE, NEVER, PARAMETERS_DTYPE

SPEED, HELD_Z = range(2)  # of a game's commands: m/s, and the NED height that they hold, NaN for none
PICTURE_SEED, EVENT_SEED = range(2)  # of a game's noise
POSE, MOTION, FORCE, ACCELERATION = 0, 7, 13, 19  # places in a body's row


class Games(NamedTuple):
    """What games are: rows (S, ...)."""

    parameters: Operand
    """PARAMETERS_DTYPE."""
    start: Operand
    """FLIGHT_DTYPE: a settled hover, in the game's wind."""
    body: Operand
    """(S, BODY_FIELDS) float64: MuJoCo's pose, velocity, force and acceleration, there."""
    solids: Operand
    """(S, n, SOLID_FIELDS) float64: what can be touched (kernels/touching)."""
    counts: Operand
    """(S,) int32 of them."""
    scenes: Scenes
    """What is seen (kernels/looks)."""
    cameras: Operand
    """(S, CAMERA_FIELDS) float64 (kernels/events)."""
    seeds: Operand
    """(S, 2) int64."""
    commands: Operand
    """(S, 2) float64: SPEED, HELD_Z."""


class Flights(NamedTuple):
    """What L lanes fly now."""

    state: Operand
    """(L,) FLIGHT_DTYPE."""
    body: Operand
    """(L, BODY_FIELDS) float64."""
    watch: Operand
    """(L, 2) int64 (kernels/flight)."""
    game: Operand
    """(L,) int64: the row in Games."""


def game_rows(rows: int, solids: int, empty: Operand = np.zeros) -> Games:
    """Room for games; `empty` makes an array of a shape and a type."""
    f8, i8 = np.float64, np.int64
    scenes = Scenes(
        empty((rows, SOLIDS, 8), np.float32), empty((rows,), np.int32), empty((rows, 9), np.float32)
    )
    return Games(
        empty((rows,), PARAMETERS_DTYPE),
        empty((rows,), FLIGHT_DTYPE),
        empty((rows, BODY_FIELDS), f8),
        empty((rows, solids, SOLID_FIELDS), f8),
        empty((rows,), np.int32),
        scenes,
        empty((rows, CAMERA_FIELDS), f8),
        empty((rows, 2), i8),
        empty((rows, 2), f8),
    )


def flights(lanes: int, empty: Operand = np.zeros) -> Flights:
    """Room for lanes."""
    return Flights(
        empty((lanes,), FLIGHT_DTYPE),
        empty((lanes, BODY_FIELDS), np.float64),
        empty((lanes, 2), np.int64),
        empty((lanes,), np.int64),
    )


@part
def look(parameters: Operand, state: Operand, body: Operand) -> None:
    """Read the pose, and compute the next kick, after the wind was set (hotloop's `look`)."""
    read_pose(state, body[POSE:MOTION])
    kick(parameters, state, body[MOTION:FORCE], body[FORCE:ACCELERATION])


@part
def begin(lane: int, game: int, games: Games, now: Flights) -> None:
    """Let a lane begin a game."""
    now.state[lane] = games.start[game]
    for field in range(BODY_FIELDS):
        now.body[lane, field] = games.body[game, field]
    now.watch[lane, NEXT_LOOK], now.watch[lane, TOUCHED] = 0, NOTHING
    now.game[lane] = game


@part
def command(lane: int, directions: Operand, games: Games, now: Flights) -> None:
    """Take a direction (L, 3) for a goal: moveByVelocity, or moveByVelocityZ where a height is held (vehicle/goal)."""
    state, told = now.state[lane], games.commands[now.game[lane]]
    for axis in range(3):
        state.goal[axis] = directions[lane, axis] * told[SPEED]
    state.goal[3] = 0.0
    state.xy_mode, state.z_mode, state.yaw_mode = VELOCITY, VELOCITY, RATE
    if told[HELD_Z] == told[HELD_Z]:
        state.goal[2], state.z_mode = told[HELD_Z], POSITION
    state.hover_tick = NEVER


@part(inline=False)
def fly(lane: int, ticks: int, games: Games, now: Flights, hull: Operand) -> None:
    """Let a lane fly so many ticks."""
    game, row = now.game[lane], now.body[lane]
    body = row[POSE:MOTION], row[MOTION:FORCE], row[FORCE:ACCELERATION], row[ACCELERATION:]
    solids, count = games.solids[game], games.counts[game]
    state, watch = now.state[lane], now.watch[lane]
    fly_ticks(games.parameters[game], state, body, solids, count, hull, watch, ticks, True, ALL)


@part
def touched(lane: int, now: Flights) -> bool:
    """Whether a lane's flight is over."""
    return now.state[lane].collision_tick != NEVER
