"""One lane's flight over ticks: what the hot loop does for one vehicle, without MuJoCo.

Autopilot, rotors, forces and the step of a free body are the simulation's own functions. A lane's flight ends at the
first touch, as in the lane's scene, so what is touched never pushes back.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from uavaccel.kernels.touching import NOTHING, Share, Solids, free_ticks, touched
from uavaccel.parts import part
from uavaccel.sim.vehicle.autopilot import control
from uavaccel.sim.vehicle.free_body import free_step, move, normalised
from uavaccel.sim.vehicle.hotloop import kick, read_pose
from uavaccel.sim.vehicle.quadrotor import NEVER, Record, accelerate, turn_rotors

HULL_RADIUS, HULL_HALF_HEIGHT, HULL_REACH = range(3)  # metres; the reach is that of a ball around the hull
NEXT_LOOK, TOUCHED = range(2)  # tick of the next look at the surroundings; the solid that ended the flight
BODY_FIELDS = 25  # MuJoCo's qpos (7,), qvel (6,), qfrc_applied (6,) and qacc (6,), in its axes

Floats = NDArray[np.float64]
Body = tuple[Floats, Floats, Floats, Floats]


@part
def look_around(
    parameters: Record,
    state: Record,
    pose: Floats,
    solids: Solids,
    count: int,
    hull: Floats,
    watch: NDArray[np.int64],
    share: Share,
) -> None:
    """Note what the hull touches at this tick, if anything, else when to look again."""
    free = free_ticks(parameters, state, pose, solids, count, hull[HULL_REACH], share)
    watch[NEXT_LOOK] = state.tick + max(free, 1)
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
    """A tick as the exact simulator flies it, to the last bit."""
    pose, motion, force, acceleration = body
    free_step(parameters, pose, motion, force, acceleration)
    kick(parameters, state, motion, force)
    turn_rotors(parameters, state)
    read_pose(state, pose)
    state.tick += 1
    control(parameters, state)


@part
def short_step(parameters: Record, state: Record, body: Body) -> None:
    """The same but for rounding, in two thirds of the operations.

    `kick` makes forces of the accelerations, and MuJoCo accelerations of the forces: here they go to it as they are.
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
    solids: Solids,
    count: int,
    hull: Floats,
    watch: NDArray[np.int64],
    ticks: int,
    exact: bool,
    share: Share,
) -> None:
    """Fly so many ticks; from the one after a touch on the vehicle stands still while time passes.

    `body`: pose (7,), velocity (6,), force (6,) and acceleration (6,) as `free_step` takes them. Where not `exact`,
    ticks are `short_step`s.
    """
    for left in range(ticks, 0, -1):
        if state.collision_tick != NEVER:
            state.tick += left
            return
        if state.tick >= watch[NEXT_LOOK]:
            look_around(parameters, state, body[0], solids, count, hull, watch, share)
        if exact:
            step(parameters, state, body)
        else:
            short_step(parameters, state, body)
