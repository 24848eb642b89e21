"""Images of many lanes, rendered on the CPU: those that `sim.camera.Camera` renders with OpenGL.

The functions hold no GIL and share no memory, so threads may call them concurrently. Poses are those of
`sim.vehicle.quadrotor.FLIGHT_DTYPE`: positions NED in metres (D, 3), and quaternions wxyz, FRD to NED, (D, 4), both
float64. `lanes` (D,) int32 has the row of `Scenes` that each drone is in. Row 0 of an image is its top.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from uavaccel.kernels import fields as at
from uavaccel.kernels.fields import Appearance, Scenes
from uavaccel.kernels.operands import Launchable
from uavaccel.kernels.project import project
from uavaccel.kernels.spans import make_scratch, render_channels, render_depths, transpose_colour, transpose_gray
from uavaccel.sim.vehicle.hotloop import sources

Poses = NDArray[np.float64]
Lanes = NDArray[np.int32]


def render_gray(
    appearance: Appearance,
    scenes: Scenes,
    lanes: Lanes,
    positions: Poses,
    quaternions: Poses,
    out: NDArray[np.uint8] | None = None,
) -> NDArray[np.uint8]:
    """Render luma (D, ROWS, COLUMNS) uint8, which OpenCV would compute from the colours; into `out` if given."""
    out = np.empty((len(lanes), at.ROWS, at.COLUMNS), np.uint8) if out is None else out
    _gray(appearance, scenes, lanes, positions, quaternions, out)
    return out


def render_colour(
    appearance: Appearance,
    scenes: Scenes,
    lanes: Lanes,
    positions: Poses,
    quaternions: Poses,
    out: NDArray[np.uint8] | None = None,
) -> NDArray[np.uint8]:
    """Render red, green and blue (D, ROWS, COLUMNS, 3) uint8; into `out` if given."""
    out = np.empty((len(lanes), at.ROWS, at.COLUMNS, 3), np.uint8) if out is None else out
    _colour(appearance, scenes, lanes, positions, quaternions, out)
    return out


def render_depth(
    appearance: Appearance,
    scenes: Scenes,
    lanes: Lanes,
    positions: Poses,
    quaternions: Poses,
    out: NDArray[np.float32] | None = None,
) -> NDArray[np.float32]:
    """Render depth (D, ROWS, COLUMNS) float32, metres along the optical axis; the sky is at the far plane."""
    out = np.empty((len(lanes), at.ROWS, at.COLUMNS), np.float32) if out is None else out
    _depth(appearance, scenes, lanes, positions, quaternions, out)
    return out


def _compile(stamp: int) -> tuple[Launchable, Launchable, Launchable]:
    """Compile the loops over drones, or load them from numba's cache.

    numba checks this file alone for changes. The loops close over `stamp`, a digest of the other sources, so that a
    change there makes it compile anew.
    """
    entry_point = njit(cache=True, nogil=True, error_model="numpy")

    @entry_point
    def gray(appearance, scenes, lanes, positions, quaternions, out):  # type: ignore[no-untyped-def]
        scratch = make_scratch()
        for drone in range(len(lanes) * (stamp != 0)):
            project(appearance, scenes, lanes[drone], positions[drone], quaternions[drone], True, scratch.faces)
            render_channels(appearance, scratch, False)
            transpose_gray(scratch.channels, out[drone])

    @entry_point
    def colour(appearance, scenes, lanes, positions, quaternions, out):  # type: ignore[no-untyped-def]
        scratch = make_scratch()
        for drone in range(len(lanes) * (stamp != 0)):
            project(appearance, scenes, lanes[drone], positions[drone], quaternions[drone], True, scratch.faces)
            render_channels(appearance, scratch, True)
            transpose_colour(scratch.channels, out[drone])

    @entry_point
    def depth(appearance, scenes, lanes, positions, quaternions, out):  # type: ignore[no-untyped-def]
        scratch = make_scratch()
        for drone in range(len(lanes) * (stamp != 0)):
            project(appearance, scenes, lanes[drone], positions[drone], quaternions[drone], False, scratch.faces)
            render_depths(scratch, out[drone])

    return gray, colour, depth


_gray, _colour, _depth = _compile(sources(__name__))
