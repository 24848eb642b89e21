"""One lane's flight, tick by tick: what the hot loop does for one vehicle, without MuJoCo.

Autopilot, rotors, forces and the step of a free body are the exact simulator's own functions. A flight ends at the
first contact, as in the lane's scene, so contact forces are never needed.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from uavaccel.kernels.operands import Operand
from uavaccel.kernels.touching import NOTHING, Share, free_ticks, touched
from uavaccel.sim.parts import part
from uavaccel.sim.vehicle.autopilot import control
from uavaccel.sim.vehicle.free_body import free_step, move, normalised
from uavaccel.sim.vehicle.hotloop import kick, level_out, read_pose
from uavaccel.sim.vehicle.quadrotor import NEVER, Record, accelerate, turn_rotors

HULL_RADIUS, HULL_HALF_HEIGHT, HULL_REACH = range(3)  # metres; HULL_REACH is the radius of the bounding sphere
NEXT_CHECK, TOUCHED = range(2)  # tick of the next collision test; the solid that ended the flight, or NOTHING
BODY_FIELDS = 25  # MuJoCo's qpos (7,), qvel (6,), qfrc_applied (6,) and qacc (6,), in its axes

Floats = NDArray[np.float64]
Body = tuple[Floats, Floats, Floats, Floats]


@part
def check_contact(
    parameters: Record,
    state: Record,
    pose: Floats,
    solids: Operand,
    count: int,
    hull: Floats,
    watch: NDArray[np.int64],
    share: Share,
) -> None:
    """Test the hull for a collision at this tick, and schedule the next test.

    On contact, record the solid in `watch`, and tick and position in `state`.
    """
    free = free_ticks(parameters, state, pose, solids, count, hull[HULL_REACH], share)
    watch[NEXT_CHECK] = state.tick + max(free, 1)
    if free > 0:
        return
    watch[TOUCHED] = touched(pose, solids, count, hull[HULL_RADIUS], hull[HULL_HALF_HEIGHT], share)
    if watch[TOUCHED] == NOTHING:
        return
    state.collision_tick = state.contact_tick = state.tick
    for axis in range(3):
        state.contact_position[axis] = state.position[axis]


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
    parameters: Record,
    state: Record,
    body: Body,
    solids: Operand,
    count: int,
    hull: Floats,
    watch: NDArray[np.int64],
    ticks: int,
    exact: bool,
    share: Share,
) -> None:
    """Fly for `ticks`; after a collision the vehicle stands still while time passes.

    `body` has pose (7,), velocity (6,), force (6,) and acceleration (6,), as `free_step` takes them. A tick is a `step`
    if `exact`, else a `short_step`.
    """
    for left in range(ticks, 0, -1):
        if state.collision_tick != NEVER:
            state.tick += left
            return
        if state.tick >= watch[NEXT_CHECK]:
            check_contact(parameters, state, body[0], solids, count, hull, watch, share)
        if exact:
            step(parameters, state, body)
        else:
            short_step(parameters, state, body)
