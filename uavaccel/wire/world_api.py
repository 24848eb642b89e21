"""AirSim's calls about the world: environment, wind, lines of sight, extents, weather.

Sources: AirSim v1.8.1, Environment.hpp, WorldSimApi.cpp, PawnSimApi.cpp.
"""

from __future__ import annotations

import numpy as np

from uavaccel.kinematics import Vector
from uavaccel.sim.scene.objects import sees
from uavaccel.sim.sensors.earth import GRAVITY_M_S2, GeoPoint, atmosphere, geographic, local
from uavaccel.sim.vehicle.vehicle import BODY
from uavaccel.wire import types
from uavaccel.wire.arguments import Point, VehicleName, Wind, coordinate
from uavaccel.wire.calls import Calls, call, without_effect


class WorldApi(Calls, title="World"):
    @call("simGetGroundTruthEnvironment")
    def environment(self, vehicle: VehicleName = "") -> dict[str, object]:
        """Return the environment at a vehicle, in SI units."""
        position = self.scenery.truth(vehicle).position_m
        place = geographic(position, self.scenery.settings.home)
        air = atmosphere(place.altitude)
        return {
            "position": types.vector_map(self.scenery.vehicle(vehicle).local(position)),
            "geo_point": types.geo_map(place),
            "gravity": types.vector_map((0.0, 0.0, GRAVITY_M_S2)),
            "air_pressure": air.pressure_pa,
            "temperature": air.temperature_k,
            "air_density": air.density,
        }

    @call("getHomeGeoPoint")
    def home(self, vehicle: VehicleName = "") -> dict[str, float]:
        """Return the geographic position of the vehicle's NED origin."""
        return types.geo_map(geographic(self.scenery.vehicle(vehicle).origin_m, self.scenery.settings.home))

    @call("simSetWind")
    def set_wind(self, wind: Wind) -> None:
        """Set the wind in m/s NED, until it is set again."""
        self.simulation.world.set_wind(wind)

    @call("simTestLineOfSightToPoint")
    def has_line_of_sight_to(self, point: Point, vehicle: VehicleName = "") -> bool:
        """Return whether the line of sight from the vehicle to a point is free."""
        own = self.scenery.vehicle(vehicle).body
        return self._sees(self.scenery.truth(vehicle).position_m, self._local(point), own)

    @call("simTestLineOfSightBetweenPoints")
    def has_line_of_sight(self, point1: Point, point2: Point) -> bool:
        return self._sees(self._local(point1), self._local(point2), BODY)

    def _sees(self, start_m: Vector, end_m: Vector, exclude: str) -> bool:
        world = self.simulation.world
        return sees(world.model, world.data, start_m, end_m, exclude=exclude)

    def _local(self, point: GeoPoint | Vector) -> Vector:
        """Return a point in the world's frame, which a Vector3r is in already: AirSim reads that as 0 degrees."""
        if not isinstance(point, GeoPoint):
            return point
        north, east, down = local(point, self.scenery.settings.home)
        return coordinate(north, "point"), coordinate(east, "point"), coordinate(down, "point")

    @call("simGetWorldExtents")
    def extents(self) -> list[dict[str, float]]:
        """Return the lowest south-western and the highest north-eastern corner of all objects."""
        objects = self.scenery.objects
        corners = np.vstack([objects.corners(name) for name in objects.names()])
        low, high = corners.min(axis=0), corners.max(axis=0)
        lowest = geographic((float(low[0]), float(low[1]), float(high[2])), self.scenery.settings.home)
        highest = geographic((float(high[0]), float(high[1]), float(low[2])), self.scenery.settings.home)
        return [types.geo_map(lowest), types.geo_map(highest)]

    ignored = (
        *without_effect("simSetTimeOfDay", "simEnableWeather", "simSetWeatherParameter"),
        *without_effect("simSetLightIntensity", "simRunConsoleCommand", answer=True),
    )
