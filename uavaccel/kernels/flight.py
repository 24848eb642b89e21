"""One lane's flight over ticks: what the hot loop does for one vehicle, without MuJoCo.

Autopilot, rotors, forces and the step of a free body are the simulation's own functions. A lane's flight ends at the
first touch, as in the lane's scene, so what is touched never pushes back.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from uavaccel.kernels.touching import NOTHING, Solids, free_ticks, touched
from uavaccel.sim.autopilot import control
from uavaccel.sim.free_body import free_step
from uavaccel.sim.hotloop import kick, read_pose
from uavaccel.sim.quadrotor import NEVER, Record, turn_rotors

HULL_RADIUS, HULL_HALF_HEIGHT, HULL_REACH = range(3)  # metres; the reach is that of a ball around the hull
NEXT_LOOK, TOUCHED = range(2)  # tick of the next look at the surroundings; the solid that ended the flight
BODY_FIELDS = 25  # MuJoCo's qpos (7,), qvel (6,), qfrc_applied (6,) and qacc (6,), in its axes

Floats = NDArray[np.float64]


@njit
def look_around(
    parameters: Record,
    state: Record,
    pose: Floats,
    solids: Solids,
    count: int,
    hull: Floats,
    watch: NDArray[np.int64],
) -> None:
    """Note what the hull touches at this tick, if anything, else when to look again."""
    free = free_ticks(parameters, state, pose, solids, count, hull[HULL_REACH])
    watch[NEXT_LOOK] = state.tick + max(free, 1)
    if free > 0:
        return
    watch[TOUCHED] = touched(pose, solids, count, hull[HULL_RADIUS], hull[HULL_HALF_HEIGHT])
    if watch[TOUCHED] == NOTHING:
        return
    state.collision_tick = state.contact_tick = state.tick
    for axis in range(3):
        state.contact_position[axis] = state.position[axis]


@njit
def fly_ticks(
    parameters: Record,
    state: Record,
    body: tuple[Floats, Floats, Floats, Floats],
    solids: Solids,
    count: int,
    hull: Floats,
    watch: NDArray[np.int64],
    ticks: int,
) -> None:
    """Fly so many ticks; from the one after a touch on the vehicle stands still while time passes.

    `body`: pose (7,), velocity (6,), force (6,) and acceleration (6,) as `free_step` takes them.
    """
    pose, motion, force, acceleration = body
    for _ in range(ticks):
        if state.collision_tick == NEVER:
            if state.tick >= watch[NEXT_LOOK]:
                look_around(parameters, state, pose, solids, count, hull, watch)
            free_step(parameters, pose, motion, force, acceleration)
            kick(parameters, state, motion, force)
            turn_rotors(parameters, state)
            read_pose(state, pose)
            state.tick += 1
            control(parameters, state)
        else:
            state.tick += 1
