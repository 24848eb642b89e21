"""Lanes as arrays: the flights in progress, and the games that lanes can begin; for the CPU and for a GPU.

A game's row holds what is constant during the game. A lane refers to the row of its game, so that beginning a game
copies no more than a flight's state. `L` lanes with `K` games each have L * K rows, ordered by lane.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavaccel.kernels import touching
from uavaccel.kernels.events import CAMERA_FIELDS
from uavaccel.kernels.fields import Operand, empty_scenes
from uavaccel.kernels.scene import Scene
from uavaccel.kernels.touching import ALL, NOTHING, SOLID_FIELDS, Share, around
from uavaccel.sim.parts import part
from uavaccel.sim.vehicle.autopilot import control
from uavaccel.sim.vehicle.free_body import free_step, move, normalised
from uavaccel.sim.vehicle.hotloop import kick, level_out, read_pose
from uavaccel.sim.vehicle.quadrotor import FLIGHT_DTYPE, NEVER, PARAMETERS_DTYPE, Record, accelerate, turn_rotors

HULL_RADIUS, HULL_HALF_HEIGHT, HULL_REACH = range(3)  # metres; HULL_REACH is the radius of the bounding sphere
NEXT_CHECK, TOUCHED = range(2)  # tick of the next collision test; the solid that ended the flight, or NOTHING
BODY_FIELDS = 25  # MuJoCo's qpos (7,), qvel (6,), qfrc_applied (6,) and qacc (6,), in its axes

Floats = NDArray[np.float64]
Body = tuple[Floats, Floats, Floats, Floats]
Near = tuple[Operand, int, Floats, Share]  # solids and their number, the hull, the thread's share of them


@part
def step(parameters: Record, state: Record, body: Body) -> None:
    """Advance by a tick exactly as the exact simulator does, to the last bit."""
    pose, motion, force, acceleration = body
    free_step(parameters, pose, motion, force, acceleration)
    kick(parameters, state, motion, force)
    turn_rotors(parameters, state)
    level_out(parameters, pose)
    read_pose(state, pose)
    state.tick += 1
    control(parameters, state)


@part
def short_step(parameters: Record, state: Record, body: Body) -> None:
    """Advance by a tick as `step` does but for rounding, with two thirds of the operations.

    `kick` turns accelerations into forces, and MuJoCo turns these into accelerations again; here both are left out.
    """
    pose, motion, _, acceleration = body
    for axis in range(3):
        side = 1.0 if axis == 0 else -1.0  # units.py's half turn about x
        acceleration[axis] = side * state.acceleration[axis]
        acceleration[3 + axis] = side * state.angular_acceleration[axis]
    attitude = normalised(pose[3], pose[4], pose[5], pose[6])
    move(pose, motion, acceleration, attitude, parameters.tick_s)
    velocity, rate = (motion[0], -motion[1], -motion[2]), (motion[3], -motion[4], -motion[5])
    accelerate(parameters, state, velocity, rate)
    half = 0.5 * parameters.tick_s
    for axis in range(3):
        state.velocity[axis] = velocity[axis] + half * state.acceleration[axis]
        state.rate[axis] = rate[axis] + half * state.angular_acceleration[axis]
    turn_rotors(parameters, state)
    read_pose(state, pose)
    state.tick += 1
    control(parameters, state)


@part
def fly_ticks(
    parameters: Record, state: Record, body: Body, near: Near, watch: NDArray[np.int64], ticks: int, exact: bool
) -> None:
    """Fly for `ticks`; after a collision, which is noted in `watch` and `state`, it stands still while time passes.

    `body` has pose (7,), velocity (6,), force (6,) and acceleration (6,), as `free_step` takes them. A tick is a `step`
    if `exact`, else a `short_step`.
    """
    solids, count, hull, share = near
    for left in range(ticks, 0, -1):
        if state.collision_tick != NEVER:
            state.tick += left
            return
        if state.tick >= watch[NEXT_CHECK]:
            pose = body[0]
            free = touching.free_ticks(parameters, state, pose, solids, count, hull[HULL_REACH], share)
            watch[NEXT_CHECK] = state.tick + max(free, 1)
            if free <= 0:
                radius_m, half_m = hull[HULL_RADIUS], hull[HULL_HALF_HEIGHT]
                watch[TOUCHED] = touching.touched(pose, solids, count, radius_m, half_m, share)
                if watch[TOUCHED] != NOTHING:
                    state.collision_tick = state.contact_tick = state.tick
                    for axis in range(3):
                        state.contact_position[axis] = state.position[axis]
        if exact:
            step(parameters, state, body)
        else:
            short_step(parameters, state, body)


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
    """(L, 2) int64: NEXT_CHECK, TOUCHED."""
    game: Operand
    """(L,) int64: rows of Games."""


def game_rows(rows: int, solids: int | Scene, seen: Scene | None = None) -> Games:
    """Allocate rows for games with up to `solids` solids, or in a scene, of which they see another unless in a lane."""
    return Games(
        np.zeros((rows,), PARAMETERS_DTYPE),
        np.zeros((rows,), FLIGHT_DTYPE),
        np.zeros((rows, BODY_FIELDS)),
        solids if isinstance(solids, Scene) else np.zeros((rows, solids, SOLID_FIELDS)),
        np.zeros((rows,), np.int32),
        seen or empty_scenes(rows),
        np.zeros((rows, CAMERA_FIELDS)),
        np.zeros((rows, 2), np.int64),
    )


def flights(lanes: int) -> Flights:
    """Allocate the flights of `lanes` lanes."""
    body, watch = np.zeros((lanes, BODY_FIELDS)), np.zeros((lanes, 2), np.int64)
    return Flights(np.zeros((lanes,), FLIGHT_DTYPE), body, watch, np.zeros((lanes,), np.int64))


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
    fly_ticks(games.parameters[game], now.state[lane], body, (solids, count, hull, ALL), now.watch[lane], ticks, True)


@part
def touched(lane: int, now: Flights) -> bool:
    """Return whether a lane's vehicle has collided, which ends its flight."""
    return now.state[lane].collision_tick != NEVER
