"""The segmentation IDs of objects and their colours: AirSim's, derived from the name until a client sets another.

Sources: AirSim v1.8.1, AirBlueprintLib.cpp (IDs of names), docs/seg_rgbs.txt (colours).
"""

from __future__ import annotations

import csv
from collections.abc import Iterable
from functools import cache

import numpy as np
from numpy.typing import NDArray

from uavaccel.resources import asset
from uavaccel.sim.camera.view import GeomImage
from uavaccel.sim.scene.objects import SceneObjects
from uavaccel.sim.world import World

NOT_RENDERED, NO_OBJECT = -1, 0
HIGHEST_ID = 255


class Segmentation:
    """The IDs of one world's objects, and of its vehicles."""

    def __init__(self, world: World, objects: SceneObjects) -> None:
        self._world, self._objects = world, objects
        self._given: dict[int, int] = {}  # by geom
        self._table = np.zeros(0, np.int64)

    def ids(self, geoms: GeomImage) -> NDArray[np.int64]:
        """Return the IDs of an image of geoms; 0 for the sky and for objects that are not drawn."""
        return np.asarray(np.maximum(self._all(), NO_OBJECT)[geoms])

    def _all(self) -> NDArray[np.int64]:
        """Return the IDs of all geoms, and last that of the sky, geom -1."""
        model = self._world.model
        if len(self._table) != model.ngeom + 1:  # at first, or after a vehicle was added
            names = [self._world.name_of(geom) for geom in range(model.ngeom)]
            self._table = np.array([*map(id_of_name, names), NO_OBJECT])
            for geom, number in self._given.items():
                self._table[geom] = number
        return self._table

    def _give(self, geoms: list[int], number: int) -> None:
        self._all()[geoms] = number
        self._given |= dict.fromkeys(geoms, number)

    def set_id(self, names: Iterable[str], number: int) -> bool:
        """Set the ID of the objects and vehicles of these names; returns whether there are any."""
        if not NOT_RENDERED <= number <= HIGHEST_ID:
            raise ValueError(f"object_id must be {NOT_RENDERED} to {HIGHEST_ID}, not {number}")
        geoms = [geom for name in names for geom in self._geoms(name)]
        self._give(geoms, number)
        return bool(geoms)

    def id(self, names: Iterable[str]) -> int:
        """Return the ID of the first of these objects and vehicles; -1 if there is none."""
        geoms = [geom for name in names for geom in self._geoms(name)]
        return int(self._all()[geoms[0]]) if geoms else NOT_RENDERED

    def spawned(self, name: str) -> None:
        """Give a new object the ID of its name."""
        self._give(self._geoms(name), id_of_name(name))

    def _geoms(self, name: str) -> list[int]:
        geom = self._objects.geom(name)
        for vehicle in self._world.vehicles if geom is None else []:
            if name == vehicle.name:
                own = np.flatnonzero(self._world.model.geom_bodyid == vehicle.body_id)
                return [int(part) for part in own]
        return [] if geom is None else [geom]


def id_of_name(name: str) -> int:
    """AirSim's ID of an object at the start: the sum of its name's letters."""
    return (5 + sum(ord(letter) for letter in name.lower() if ord(letter) >= ord("a"))) % (HIGHEST_ID + 1)


@cache
def colours() -> NDArray[np.uint8]:
    """Return the red, green and blue (256, 3) of each ID."""
    with asset("airsim/segmentation_colours.csv").open(encoding="ascii", newline="") as file:
        rows = [list(map(int, row.values())) for row in csv.DictReader(file)]
    return np.array(rows, np.uint8)
