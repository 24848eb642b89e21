"""The surroundings of a simulation that its calls share: vehicles, cameras, objects, images; each made at first use."""

from __future__ import annotations

from functools import cached_property

from uavaccel.kinematics import Kinematics
from uavaccel.sim.objects import SceneObjects, matching
from uavaccel.sim.simulation import Pilot, Simulation
from uavaccel.sim.vehicle.vehicle import Vehicle
from uavaccel.wire.cameras import Cameras
from uavaccel.wire.pictures import Pictures, Segmentation, can_render
from uavaccel.wire.settings import Settings


class Scenery:
    """The vehicles, cameras and objects of one simulation. With `render` False images are refused."""

    def __init__(self, simulation: Simulation, settings: Settings, render: bool) -> None:
        self.simulation = simulation
        self.settings = settings
        self.render = render
        self._cameras: dict[int, Cameras] = {}

    def cameras(self, vehicle: str = "", external: bool = False) -> Cameras:
        """Return the cameras of a vehicle or of the scene. Raises ValueError for an unknown vehicle either way."""
        number = self.number_of(vehicle)
        if external:
            return self._external_cameras
        if number not in self._cameras:
            name = self.simulation.world.vehicles[number].name
            given = self.settings.vehicles.get(name)
            cameras = given.cameras if given else {}
            self._cameras[number] = Cameras(self.settings.camera_defaults, cameras, carrier=number)
        return self._cameras[number]

    def number_of(self, name: str) -> int:
        """Return the number of the vehicle with this name; "" is the first vehicle.

        Raises ValueError, in AirSim's words, for an unknown name.
        """
        for number, vehicle in enumerate(self.simulation.world.vehicles):
            if name in ("", vehicle.name):
                return number
        raise self._not_there(name)

    def vehicle(self, name: str = "") -> Vehicle:
        """Return the vehicle with this name. Raises ValueError as number_of does."""
        return self.simulation.world.vehicles[self.number_of(name)]

    def truth(self, vehicle: str = "") -> Kinematics:
        """Return a vehicle's state in the world's frame. Raises ValueError as number_of does."""
        return self.vehicle(vehicle).kinematics(self.simulation.time0_ns, in_world=True)

    def pilot(self, name: str = "") -> Pilot:
        """Return the pilot of a vehicle. Raises ValueError as number_of does."""
        return self.simulation.pilots[self.number_of(name)]

    def flying_pilot(self, name: str) -> Pilot:
        """Return the pilot of a flying vehicle. Raises ValueError as number_of does, and in SimMode ComputerVision."""
        if self.settings.flightless:
            raise self._not_there(name)
        return self.pilot(name)

    def _not_there(self, name: str) -> ValueError:
        known = ", ".join(f"'{known}'" for known in self._names())
        return ValueError(
            f"Vehicle API for '{name}' is not available. This could either because this is simulation"
            f"-only API or this vehicle does not exist; there is {known}"
        )

    def largest_picture(self) -> tuple[int, int]:
        """Return the width and height in which every picture fits that can be drawn."""
        own = [lens for name in self._names() for lens in self.cameras(name).lenses()]
        lenses = [lens for lens in (*own, *self._external_cameras.lenses()) if can_render(lens)]
        return max(lens.width for lens in lenses), max(lens.height for lens in lenses)

    def _names(self) -> list[str]:
        return [vehicle.name for vehicle in self.simulation.world.vehicles]

    def named(self, name: str) -> list[str]:
        """Return the objects, then the vehicles, with this name in any case."""
        return [entry for entry in self._all_names() if entry.lower() == name.lower()]

    def named_like(self, pattern: str) -> list[str]:
        """List the objects, then the vehicles, whose whole name matches. Raises ValueError for a wrong pattern."""
        return matching(pattern, self._all_names())

    def _all_names(self) -> list[str]:
        return [*self.objects.names(), *self._names()]

    @cached_property
    def _external_cameras(self) -> Cameras:
        return Cameras(self.settings.camera_defaults, self.settings.external_cameras, external=True)

    def forget(self) -> None:
        """Forget objects, segmentation and pictures: the world has a new model."""
        for name in ("objects", "segmentation", "pictures"):
            self.__dict__.pop(name, None)

    @cached_property
    def objects(self) -> SceneObjects:
        return SceneObjects(self.simulation.world)

    @cached_property
    def segmentation(self) -> Segmentation:
        return Segmentation(self.simulation.world, self.objects)

    @cached_property
    def pictures(self) -> Pictures:
        return Pictures(self.simulation, self.largest_picture(), self.segmentation, self.render)
