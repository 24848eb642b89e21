"""A chase view: a flight through a lane, rendered afterwards from behind and above its poses."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from uavaccel.sim.camera.mounted import Lens
from uavaccel.sim.lane.layout import LaneLayout
from uavaccel.sim.poses import Pose, from_degrees
from uavaccel.sim.profile import PROFILES
from uavaccel.sim.world import World

EYE = Pose((-2.2, 0.0, -0.9), from_degrees(0.0, -14.0, 0.0))  # relative to the vehicle's position and heading
FOV_DEG = 80.0
FINER = 2  # supersampling factor, in place of MuJoCo's antialiasing


class ChaseView:
    """Renders n poses, `position_m` (n, 3) NED and `orientation_wxyz` (n, 4). Raises UserError without OpenGL."""

    def __init__(
        self,
        layout: LaneLayout,
        position_m: NDArray[np.float64],
        orientation_wxyz: NDArray[np.float64],
        size: tuple[int, int],
    ) -> None:
        self._position_m, self._orientation_wxyz = position_m, orientation_wxyz
        self._width, self._height = size
        self._world = World("lane", PROFILES["native"])
        self._world.set_lane(layout)
        self._lens = Lens(FINER * self._width, FINER * self._height, FOV_DEG)

    def __call__(self, number: int) -> NDArray[np.uint8]:
        """Render pose `number`: (height, width, 3) red, green, blue."""
        north, east, down = self._position_m[number].tolist()
        w, x, y, z = self._orientation_wxyz[number].tolist()
        self._world.teleport(self._world.lead, (north, east, down), (w, x, y, z))
        heading = math.degrees(math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))
        camera = self._world.mounted_camera(self._lens.width, self._lens.height)
        camera.point(Pose((north, east, down), from_degrees(0.0, 0.0, heading)).of(EYE), self._lens)
        drawn = camera.colour(self._world.data)
        return np.asarray(
            cv2.resize(drawn, (self._width, self._height), interpolation=cv2.INTER_AREA), np.uint8
        )

    def close(self) -> None:
        """Free what OpenGL holds."""
        self._world.close()
