"""What the calls about cameras, images and objects share, made when first asked for: games do not pay for it."""

from __future__ import annotations

import re
from functools import cached_property
from typing import Any

from uavaccel.sim.scene_objects import SceneObjects
from uavaccel.sim.simulation import Simulation
from uavaccel.wire.cameras import Cameras
from uavaccel.wire.pictures import Pictures
from uavaccel.wire.segmentation import Segmentation
from uavaccel.wire.settings import Settings


class Scenery:
    """The surroundings of one simulation, and its vehicle's cameras. `render` False refuses images."""

    def __init__(self, simulation: Simulation, settings: Settings, render: bool) -> None:
        self.simulation = simulation
        self.settings = settings
        self.render = render

    def cameras(self, vehicle: Any = "", external: Any = False) -> Cameras:
        """A vehicle's cameras, or those of ExternalCameras."""
        return self._external_cameras if external else self._cameras

    def largest_picture(self) -> tuple[int, int]:
        """Width and height within which all pictures fit."""
        lenses = [*self._cameras.lenses(), *self._external_cameras.lenses()]
        return max(lens.width for lens in lenses), max(lens.height for lens in lenses)

    @cached_property
    def _cameras(self) -> Cameras:
        vehicle = self.settings.vehicles.get(self.settings.vehicle)
        return Cameras(self.settings.camera_defaults, vehicle.cameras if vehicle else {})

    def _names(self) -> list[str]:
        return [vehicle.name for vehicle in self.simulation.world.vehicles]

    def vehicles_matching(self, pattern: str) -> list[str]:
        """Names of the vehicles that a regular expression matches, whatever its case."""
        return [name for name in self._names() if re.fullmatch(pattern, name, re.IGNORECASE)]

    @cached_property
    def _external_cameras(self) -> Cameras:
        return Cameras(self.settings.camera_defaults, self.settings.external_cameras, external=True)

    @cached_property
    def objects(self) -> SceneObjects:
        return SceneObjects(self.simulation.world)

    @cached_property
    def segmentation(self) -> Segmentation:
        return Segmentation(self.simulation.world, self.objects, self.settings.vehicle)

    @cached_property
    def pictures(self) -> Pictures:
        return Pictures(self.simulation, self.largest_picture(), self.segmentation, self.render)
