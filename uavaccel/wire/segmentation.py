"""Which segmentation ID each object has, and its colour: AirSim's, by the letters of its name until a client sets it.

Sources: AirSim v1.8.1, AirBlueprintLib.cpp (IDs of names), docs/seg_rgbs.txt (colours).
"""

from __future__ import annotations

import csv
import re
from functools import cache

import numpy as np
from numpy.typing import NDArray

from uavaccel.resources import asset
from uavaccel.sim.lane.scene import object_name
from uavaccel.sim.scene_objects import SceneObjects
from uavaccel.sim.view import GeomImage
from uavaccel.sim.world import World

NOT_DRAWN, NO_OBJECT = -1, 0
HIGHEST_ID = 255


class Segmentation:
    """The IDs of one world's objects, and of its `vehicle`."""

    def __init__(self, world: World, objects: SceneObjects, vehicle: str) -> None:
        self._objects = objects
        model = world.model
        names = [object_name(model, geom) for geom in range(model.ngeom)]
        self._ids = np.array([id_of_name(name) for name in names] + [NO_OBJECT])  # the last is the sky's, -1
        self._of_vehicle = {vehicle: [geom for geom, name in enumerate(names) if "quadrotor" in name]}
        self._ids[self._of_vehicle[vehicle]] = id_of_name(vehicle)

    def ids(self, geoms: GeomImage) -> NDArray[np.int64]:
        """The ID of each geom of an image of geoms; 0 for the sky and for what is not to be drawn."""
        ids: NDArray[np.int64] = np.maximum(self._ids, NO_OBJECT)[geoms]
        return ids

    def set_id(self, name: str, number: int, is_pattern: bool) -> bool:
        """Whether an object of that name, or any that a regular expression matches, has got the ID."""
        if not NOT_DRAWN <= number <= HIGHEST_ID:
            raise ValueError(f"object_id must be {NOT_DRAWN} to {HIGHEST_ID}, not {number}")
        geoms = [geom for found in self._matching(name, is_pattern) for geom in self._geoms(found)]
        self._ids[geoms] = number
        return bool(geoms)

    def id(self, name: str) -> int:
        """An object's ID; -1 without one of that name."""
        geoms = [geom for found in self._matching(name, False) for geom in self._geoms(found)]
        return int(self._ids[geoms[0]]) if geoms else NOT_DRAWN

    def spawned(self, name: str) -> None:
        """A new object has the ID of its name."""
        self._ids[self._geoms(name)] = id_of_name(name)

    def _matching(self, name: str, is_pattern: bool) -> list[str]:
        return [
            *self._objects.matching(name if is_pattern else re.escape(name)),
            *self._vehicles(name, is_pattern),
        ]

    def _vehicles(self, name: str, is_pattern: bool) -> list[str]:
        pattern = name if is_pattern else re.escape(name)
        return [own for own in self._of_vehicle if re.fullmatch(pattern, own, re.IGNORECASE)]

    def _geoms(self, name: str) -> list[int]:
        if name in self._of_vehicle:
            return self._of_vehicle[name]
        geom = self._objects.geom(name)
        return [] if geom is None else [geom]


def id_of_name(name: str) -> int:
    """AirSim's ID of an object at the start: the sum of its name's letters."""
    return (5 + sum(ord(letter) for letter in name.lower() if ord(letter) >= ord("a"))) % (HIGHEST_ID + 1)


@cache
def colours() -> NDArray[np.uint8]:
    """Red, green and blue (256, 3) of each ID."""
    with asset("airsim/segmentation_colours.csv").open(encoding="ascii", newline="") as file:
        rows = [list(map(int, row.values())) for row in csv.DictReader(file)]
    return np.array(rows, np.uint8)
