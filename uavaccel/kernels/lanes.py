"""Lanes as arrays: the flights in progress, and the games that lanes can begin; for the CPU and for a GPU.

A game's row holds what is constant during the game. A lane refers to the row of its game, so that beginning a game
copies no more than a flight's state. `L` lanes with `K` games each have L * K rows, ordered by lane.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from uavaccel.kernels.events import CAMERA_FIELDS
from uavaccel.kernels.fields import SOLIDS, Scenes
from uavaccel.kernels.flight import BODY_FIELDS, NEXT_CHECK, TOUCHED, fly_ticks
from uavaccel.kernels.operands import Operand
from uavaccel.kernels.scene import Scene
from uavaccel.kernels.touching import ALL, NOTHING, SOLID_FIELDS, around
from uavaccel.sim.parts import part
from uavaccel.sim.vehicle.hotloop import kick, read_pose
from uavaccel.sim.vehicle.quadrotor import FLIGHT_DTYPE, NEVER, PARAMETERS_DTYPE

XY_MODE, Z_MODE, YAW_MODE = range(3)  # what the numbers of goals are: the autopilot's modes
PICTURE_SEED, EVENT_SEED = range(2)  # columns of Games.seeds
POSE, MOTION, FORCE, ACCELERATION = 0, 7, 13, 19  # offsets in a body's row


class Games(NamedTuple):
    """What is constant during a game: rows (S, ...)."""

    parameters: Operand
    """PARAMETERS_DTYPE."""
    start: Operand
    """FLIGHT_DTYPE: a settled hover in the game's wind."""
    body: Operand
    """(S, BODY_FIELDS) float64: MuJoCo's pose, velocity, force and acceleration at the start."""
    solids: Operand
    """(S, n, SOLID_FIELDS) float64: collision geometry (kernels/touching); or a `Scene` of S worlds, or of one."""
    counts: Operand
    """(S,) int32: number of solids in use."""
    scenes: Operand
    """Visible geometry: `Scenes` (kernels/appearance); or a `Scene` to see, of S worlds, or of one."""
    cameras: Operand
    """(S, CAMERA_FIELDS) float64: camera parameters (kernels/events)."""
    seeds: Operand
    """(S, 2) int64: PICTURE_SEED, EVENT_SEED, of the cameras' noise."""


class Flights(NamedTuple):
    """The flights in progress in L lanes."""

    state: Operand
    """(L,) FLIGHT_DTYPE."""
    body: Operand
    """(L, BODY_FIELDS) float64."""
    watch: Operand
    """(L, 2) int64: NEXT_CHECK, TOUCHED (kernels/flight)."""
    game: Operand
    """(L,) int64: rows of Games."""


def game_rows(rows: int, solids: int | Scene, seen: Scene | None = None) -> Games:
    """Allocate rows for games with up to `solids` solids, or in a scene, of which they see another unless in a lane."""
    f8, i8 = np.float64, np.int64
    scenes = seen or Scenes(
        np.zeros((rows, SOLIDS, 8), np.float32), np.zeros((rows,), np.int32), np.zeros((rows, 9), np.float32)
    )
    return Games(
        np.zeros((rows,), PARAMETERS_DTYPE),
        np.zeros((rows,), FLIGHT_DTYPE),
        np.zeros((rows, BODY_FIELDS), f8),
        solids if isinstance(solids, Scene) else np.zeros((rows, solids, SOLID_FIELDS), f8),
        np.zeros((rows,), np.int32),
        scenes,
        np.zeros((rows, CAMERA_FIELDS), f8),
        np.zeros((rows, 2), i8),
    )


def flights(lanes: int) -> Flights:
    """Allocate the flights of `lanes` lanes."""
    return Flights(
        np.zeros((lanes,), FLIGHT_DTYPE),
        np.zeros((lanes, BODY_FIELDS), np.float64),
        np.zeros((lanes, 2), np.int64),
        np.zeros((lanes,), np.int64),
    )


@part
def refresh(parameters: Operand, state: Operand, body: Operand) -> None:
    """Update state and acceleration from the pose after the wind was set (`refresh` of sim/vehicle/hotloop)."""
    read_pose(state, body[POSE:MOTION])
    kick(parameters, state, body[MOTION:FORCE], body[FORCE:ACCELERATION])


@part
def begin(lane: int, game: int, games: Games, now: Flights) -> None:
    """Begin a game in a lane."""
    now.state[lane] = games.start[game]
    for field in range(BODY_FIELDS):
        now.body[lane, field] = games.body[game, field]
    now.watch[lane, NEXT_CHECK], now.watch[lane, TOUCHED] = 0, NOTHING
    now.game[lane] = game


@part
def command(lane: int, goals: Operand, modes: Operand, now: Flights) -> None:
    """Give the autopilot its goal of `goals` (L, 4), whose numbers are what `modes` (3,) says."""
    state = now.state[lane]
    for number in range(4):
        state.goal[number] = goals[lane, number]
    state.xy_mode, state.z_mode, state.yaw_mode = modes[XY_MODE], modes[Z_MODE], modes[YAW_MODE]
    state.hover_tick = NEVER


@part
def resume(lane: int, row: int, before: Operand, bodies: Operand, share: float, games: Games, now: Flights) -> None:
    """Let a lane's vehicle fly on from where it is as it did in this `row` of states and bodies, its motion scaled."""
    if touched(lane, now):
        return
    tick, body = now.state[lane].tick, now.body[lane]
    now.state[lane] = before[row]
    now.state[lane].tick = tick
    for field in range(3, BODY_FIELDS):
        body[field] = bodies[row, field]
    for field in range(MOTION, FORCE):
        body[field] *= share
    now.watch[lane, NEXT_CHECK] = 0
    refresh(games.parameters[now.game[lane]], now.state[lane], body)


@part(inline=False)
def fly(lane: int, ticks: int, games: Games, now: Flights, hull: Operand) -> None:
    """Fly a lane for `ticks`."""
    game, row = now.game[lane], now.body[lane]
    body = row[POSE:MOTION], row[MOTION:FORCE], row[FORCE:ACCELERATION], row[ACCELERATION:]
    solids, count = around(games.solids, games.counts, game)
    state, watch = now.state[lane], now.watch[lane]
    fly_ticks(games.parameters[game], state, body, solids, count, hull, watch, ticks, True, ALL)


@part
def touched(lane: int, now: Flights) -> bool:
    """Return whether a lane's vehicle has collided, which ends its flight."""
    return now.state[lane].collision_tick != NEVER
