"""A collision-free path through a lane: velocity commands found by a deterministic beam search.

The search predicts positions with a linear model of SimpleFlight's response to a velocity command, per axis

    tilt_goal = VELOCITY_TO_TILT (u - v) / (1 + VELOCITY_TO_TILT * height)
    tilt'     = (tilt_goal - tilt) / TILT_TIME_S
    v'        = g * tilt - DRAG_1_S * v

Height matters because AirSim's moveByVelocityZ rotates the height goal together with the velocity goal: the higher
the flight, the slower the response (time constant 0.9 s near the ground, 1.9 s at 10 m).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import ceil

import numpy as np
from numpy.typing import NDArray

from uavaccel.errors import UserError
from uavaccel.sim.lane import LENGTH_M, FloatArray, LaneLayout, clearance_m

GRAVITY_M_S2 = 9.80665
VELOCITY_TO_TILT = 0.2 * np.pi / 5.5  # SimpleFlight's velocity gain times its tilt limit, rad per m/s
TILT_TIME_S = 0.2  # of the attitude loop, fitted to velocity steps of the full simulation
DRAG_1_S = 0.008  # at 1 m/s, fitted likewise

SPEED_M_S = 1.0
HEADINGS_DEG = (0.0, 30.0, -30.0, 60.0, -60.0)
COMMAND_S = 1.0
LEAST_STEP_S = 0.5  # of the search: what two headings change in less is less than it tells apart
CHECKS_PER_COMMAND = 5  # points in time at which the clearance is checked
BEAM_WIDTH = 48
MAX_COMMANDS = 400
AMPLE_CLEARANCE_M = 0.6  # beyond which more clearance is worth nothing

VelocityCommand = tuple[float, float]


@dataclass(frozen=True)
class _Beam:
    """The partial paths that are still extended, best first."""

    state: FloatArray  # (n, 2 axes, 3): position, velocity, tilt
    cost: FloatArray  # (n,)
    parent: NDArray[np.int64]  # (n,) index of the path in the previous beam
    action: NDArray[np.int64]  # (n,) index of the command appended to it


def plan_path(
    layout: LaneLayout, height_m: float = 10.0, margin_m: float = 0.25, command_s: float = COMMAND_S
) -> list[VelocityCommand]:
    """Find velocity commands (north, east) in m/s, of `command_s` each, from a hover at the start to the lane's end.

    Shorter ones than LEAST_STEP_S are repeated. The hull stays `margin_m` away from everything. Raises UserError if no
    such path is found.
    """
    repeats = ceil(LEAST_STEP_S / command_s)
    transition, input_response = _response(height_m, repeats * command_s / CHECKS_PER_COMMAND)
    headings = np.radians(HEADINGS_DEG)
    actions = SPEED_M_S * np.stack([np.cos(headings), np.sin(headings)], axis=1)
    forced = actions[:, None, :, None] * input_response[None, :, None, :]  # (action, check, axis, 3)
    root = np.zeros(1, np.int64)
    beams = [_Beam(np.zeros((1, 2, 3)), np.zeros(1), root, root)]
    while len(beams) <= MAX_COMMANDS and len(beams[-1].cost):
        beams.append(_extend(beams[-1], layout, margin_m, transition, forced, actions))
        arrived = np.flatnonzero(beams[-1].state[:, 0, 0] >= LENGTH_M)
        if len(arrived):
            path, taken = int(arrived[0]), list[VelocityCommand]()
            for beam in reversed(beams[1:]):
                north, east = actions[beam.action[path]].tolist()
                path, taken = int(beam.parent[path]), [(north, east)] * repeats + taken
            return taken
    raise UserError(f"no path through this lane keeps {margin_m:g} m from its obstacles: widen a gap or the spacing")


def _response(height_m: float, step_s: float) -> tuple[FloatArray, FloatArray]:
    """Return transition H (3, 3 n) and input response P (n, 3) for the n checks of a command.

    The states at the checks are state @ H + P * velocity command.
    """
    gain = VELOCITY_TO_TILT / (1 + VELOCITY_TO_TILT * height_m) / TILT_TIME_S
    continuous = np.array(
        [[0, 1, 0, 0], [0, -DRAG_1_S, GRAVITY_M_S2, 0], [0, -gain, -1 / TILT_TIME_S, gain], [0, 0, 0, 0]]
    )
    check = _exponential(continuous * step_s)
    steps = np.array([np.linalg.matrix_power(check, count + 1) for count in range(CHECKS_PER_COMMAND)])
    return steps[:, :3, :3].reshape(-1, 3).T, steps[:, :3, 3]


def _exponential(matrix: FloatArray) -> FloatArray:
    """Return the matrix exponential (n, n) of an n x n matrix by Taylor's series of a 2**10th of it."""
    term = result = np.eye(len(matrix))
    for power in range(1, 12):
        term = term @ matrix / (power * 2**10)
        result = result + term
    return np.linalg.matrix_power(result, 2**10)


def _extend(
    beam: _Beam, layout: LaneLayout, margin_m: float, transition: FloatArray, forced: FloatArray, actions: FloatArray
) -> _Beam:
    """Append each command to each path, drop those too near to something, and keep the best of each cell."""
    free = (beam.state.reshape(-1, 3) @ transition).reshape(-1, 2, CHECKS_PER_COMMAND, 3).swapaxes(1, 2)
    flown = free[:, None] + forced
    places, north = flown[..., 0], flown[..., 0, 0]
    near = (layout.x_m > north.min() - 3.0) & (layout.x_m < north.max() + 3.0)
    by_obstacle = ("x_m", "y_m", "half_width_m", "round", "texture")
    nearby = replace(layout, **{name: getattr(layout, name)[near] for name in by_obstacle})
    clearance = clearance_m(nearby, places).min(axis=2)
    parent, action = np.nonzero(clearance >= margin_m)
    closeness = np.maximum(AMPLE_CLEARANCE_M - clearance[parent, action], 0.0)
    state = flown[parent, action, -1]
    cost = beam.cost[parent] + closeness + 0.05 * np.abs(actions[action, 1])
    # the best of each cell of lateral position, velocity and progress
    best = np.argsort(cost - state[:, 0, 0], kind="stable")
    cells = np.round(state[best][:, [1, 1, 0], [0, 1, 0]] / (0.25, 0.25, 1.0)) @ (1.0, 1e3, 1e6)
    kept = best[np.sort(np.unique(cells, return_index=True)[1])[:BEAM_WIDTH]]
    return _Beam(state[kept], cost[kept], parent[kept], action[kept])
