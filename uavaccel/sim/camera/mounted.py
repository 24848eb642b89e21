"""Cameras of any pose, size and field of view with one OpenGL context: AirSim's cameras of a vehicle."""

from __future__ import annotations

import ctypes
from typing import NamedTuple

import mujoco
import numpy as np

from uavaccel.sim.camera.camera import Camera
from uavaccel.sim.camera.view import FOV_DEG, HEIGHT, WIDTH, DepthImage, Image, ray_lengths, to_metres
from uavaccel.sim.poses import Pose

MOST_LENSES = 8  # whose ray lengths are cached
SKY_M = 65504.0  # AirSim's depth of the sky: the largest half-precision number
FRONT_CENTER = Pose((0.46, 0.0, 0.0))  # quadrotor.xml's own camera


class Lens(NamedTuple):
    """Size of a picture in pixels, and its horizontal field of view in degrees."""

    width: int = WIDTH
    height: int = HEIGHT
    fov_deg: float = FOV_DEG


class MountedCamera(Camera):
    """A camera that is pointed for each picture, of at most `width` x `height` pixels.

    The vehicle that carries it is visible. Raises UserError if OpenGL is missing.
    """

    def __init__(self, model: mujoco.MjModel, width: int = WIDTH, height: int = HEIGHT) -> None:
        super().__init__(model, width, height)
        self.width_most, self.height_most = width, height
        self._lens = Lens(width, height)
        self._view.show_everything()
        self._rays: dict[Lens, DepthImage] = {}

    def point(self, eye: Pose | None, lens: Lens) -> None:
        """Take the next pictures from `eye`, NED, or from the model's own camera if None, through `lens`."""
        self._view.look_from(eye, lens.width, lens.height, lens.fov_deg)
        if lens != self._lens:
            self._lens = lens
            self.width, self.height = lens.width, lens.height
            self._rectangle = mujoco.MjrRect(0, 0, lens.width, lens.height)
            self._pixels: Image = np.empty((lens.height, lens.width, 4), np.uint8)
            self._address = self._pixels.ctypes.data_as(ctypes.c_void_p)

    def depth(self, data: mujoco.MjData) -> DepthImage:
        """Render metres along the optical axis, SKY_M for the sky; (height, width) float32."""
        picture = self._read_depths(data)
        sky = picture == 0.0
        depth = to_metres(self.model, picture)
        depth[sky] = SKY_M
        return depth

    def depth_perspective(self, data: mujoco.MjData) -> DepthImage:
        """Render metres along each pixel's ray, SKY_M for the sky; (height, width) float32."""
        depth = self.depth(data)
        if self._lens not in self._rays:
            half_width = float(np.tan(np.radians(self._lens.fov_deg) / 2))
            if len(self._rays) >= MOST_LENSES:  # clients may set any field of view
                self._rays.clear()
            self._rays[self._lens] = ray_lengths(self.width, self.height, half_width)
        np.minimum(depth * self._rays[self._lens], np.float32(SKY_M), out=depth)
        return depth
