"""Draws pictures of many lanes on the CPU: what `sim.camera.Camera` draws with OpenGL, for a drone in each of them.

Without the GIL and with arrays of its own, so that threads may draw at the same time. Poses are those of
`sim.quadrotor.FLIGHT_DTYPE`: position NED in metres, (D, 3), and quaternion wxyz, FRD to NED, (D, 4), both float64.
`lanes`, (D,) int32: the row of `Scenes` that each drone is in. The top row of a picture comes first.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from uavaccel.kernels import fields as at
from uavaccel.kernels.fields import Looks, Scenes
from uavaccel.kernels.operands import Operand
from uavaccel.kernels.project import project
from uavaccel.kernels.spans import draw_channels, draw_depths, make_desk, turn_colour, turn_gray
from uavaccel.sim.vehicle.hotloop import sources

Poses = NDArray[np.float64]
Lanes = NDArray[np.int32]


def draw_gray(
    looks: Looks,
    scenes: Scenes,
    lanes: Lanes,
    positions: Poses,
    quaternions: Poses,
    out: NDArray[np.uint8] | None = None,
) -> NDArray[np.uint8]:
    """Luma, (D, ROWS, COLUMNS) uint8, as OpenCV makes it of the colours; into `out` where there is one."""
    out = np.empty((len(lanes), at.ROWS, at.COLUMNS), np.uint8) if out is None else out
    _gray(looks, scenes, lanes, positions, quaternions, out)
    return out


def draw_colour(
    looks: Looks,
    scenes: Scenes,
    lanes: Lanes,
    positions: Poses,
    quaternions: Poses,
    out: NDArray[np.uint8] | None = None,
) -> NDArray[np.uint8]:
    """Red, green, blue, (D, ROWS, COLUMNS, 3) uint8; into `out` where there is one."""
    out = np.empty((len(lanes), at.ROWS, at.COLUMNS, 3), np.uint8) if out is None else out
    _colour(looks, scenes, lanes, positions, quaternions, out)
    return out


def draw_depth(
    looks: Looks,
    scenes: Scenes,
    lanes: Lanes,
    positions: Poses,
    quaternions: Poses,
    out: NDArray[np.float32] | None = None,
) -> NDArray[np.float32]:
    """Metres along the optical axis, the far plane's for the sky, (D, ROWS, COLUMNS) float32; into `out` if given."""
    out = np.empty((len(lanes), at.ROWS, at.COLUMNS), np.float32) if out is None else out
    _depth(looks, scenes, lanes, positions, quaternions, out)
    return out


def _compile(stamp: int) -> tuple[Any, Any, Any]:
    """The loops over drones, from numba's cache if they are there.

    numba looks for changes in this file alone; that they close over `stamp` makes it see those in the others.
    """
    entry_point = njit(cache=True, nogil=True, error_model="numpy")

    @entry_point
    def gray(
        looks: Operand,
        scenes: Operand,
        lanes: Operand,
        positions: Operand,
        quaternions: Operand,
        out: Operand,
    ) -> None:
        desk = make_desk()
        for drone in range(len(lanes) * (stamp != 0)):
            project(looks, scenes, lanes[drone], positions[drone], quaternions[drone], True, desk.faces)
            draw_channels(looks, desk, False)
            turn_gray(desk.channels, out[drone])

    @entry_point
    def colour(
        looks: Operand,
        scenes: Operand,
        lanes: Operand,
        positions: Operand,
        quaternions: Operand,
        out: Operand,
    ) -> None:
        desk = make_desk()
        for drone in range(len(lanes) * (stamp != 0)):
            project(looks, scenes, lanes[drone], positions[drone], quaternions[drone], True, desk.faces)
            draw_channels(looks, desk, True)
            turn_colour(desk.channels, out[drone])

    @entry_point
    def depth(
        looks: Operand,
        scenes: Operand,
        lanes: Operand,
        positions: Operand,
        quaternions: Operand,
        out: Operand,
    ) -> None:
        desk = make_desk()
        for drone in range(len(lanes) * (stamp != 0)):
            project(looks, scenes, lanes[drone], positions[drone], quaternions[drone], False, desk.faces)
            draw_depths(desk, out[drone])

    return gray, colour, depth


_gray, _colour, _depth = _compile(sources(__name__))
