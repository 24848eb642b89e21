"""AirSim's calls about the world at large: environment, wind, lines of sight, extents; and those without effect here.

Sources: AirSim v1.8.1, Environment.hpp, WorldSimApi.cpp, PawnSimApi.cpp.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from uavaccel.kinematics import Vector
from uavaccel.sim.scene.rays import sees
from uavaccel.sim.sensors.earth import GRAVITY_M_S2, atmosphere, geographic, local
from uavaccel.wire import types
from uavaccel.wire.method import Method
from uavaccel.wire.notices import Notices
from uavaccel.wire.scenery import Scenery

MOST_ARGUMENTS = 16  # of a call without effect, whose arguments nobody looks at
NO_LENS = "cameras here are pinholes; simSetCameraFov sets what they see"
NO_EDITOR = "there is no Unreal engine"
# Answered as AirSim would, and without effect: the answer.
ACCEPTED: dict[str, Any] = {
    "simEnableWeather": None,
    "simFlushPersistentMarkers": None,
    "simPlotArrows": None,
    "simPlotLineList": None,
    "simPlotLineStrip": None,
    "simPlotPoints": None,
    "simPlotStrings": None,
    "simPlotTransforms": None,
    "simPlotTransformsWithNames": None,
    "simPrintLogMessage": None,
    "simRunConsoleCommand": True,
    "simSetLightIntensity": True,
    "simSetTimeOfDay": None,
    "simSetTraceLine": None,
    "simSetWeatherParameter": None,
    "simSwapTextures": [],  # of the objects whose textures were swapped
}
REFUSED: dict[str, str] = {
    "simCreateVoxelGrid": "a client does not write files on the server",
    "simGetMeshPositionVertexBuffers": NO_EDITOR,
    "simSetObjectMaterial": NO_EDITOR,
    "simSetObjectMaterialFromTexture": NO_EDITOR,
    **dict.fromkeys(
        (
            "simGetPresetLensSettings",
            "simGetLensSettings",
            "simSetPresetLensSettings",
            "simGetPresetFilmbackSettings",
            "simSetPresetFilmbackSettings",
            "simGetFilmbackSettings",
            "simSetFilmbackSettings",
            "simGetFocalLength",
            "simSetFocalLength",
            "simEnableManualFocus",
            "simGetFocusDistance",
            "simSetFocusDistance",
            "simGetFocusAperture",
            "simSetFocusAperture",
            "simEnableFocusPlane",
            "simGetCurrentFieldOfView",
        ),
        NO_LENS,
    ),
}


class WorldApi:
    """The calls about the world of one simulation."""

    def __init__(self, scenery: Scenery, check_vehicle: Callable[[Any], None], notices: Notices) -> None:
        self._scenery = scenery
        self._simulation = scenery.simulation
        self._home = scenery.settings.home
        self._check_vehicle = check_vehicle
        self._notices = notices

    def methods(self) -> dict[str, Method]:
        """By wire name."""
        return {
            "simGetGroundTruthEnvironment": Method(self.environment, 0, 1),
            "getHomeGeoPoint": Method(self.home, 0, 1),
            "simSetWind": Method(self.set_wind, 1),
            "simTestLineOfSightToPoint": Method(self.sees_point, 1, 1),
            "simTestLineOfSightBetweenPoints": Method(self.sees_between, 2),
            "simGetWorldExtents": Method(self.extents, 0),
            "simLoadLevel": Method(self.load_level, 1),
        } | {name: Method(handler, 0, MOST_ARGUMENTS) for name, handler in self._without_effect().items()}

    def environment(self, vehicle: Any = "") -> dict[str, Any]:
        """simGetGroundTruthEnvironment: SI units."""
        self._check_vehicle(vehicle)
        position = self._scenery.truth(vehicle).position_m
        place = geographic(position, self._home)
        air = atmosphere(place.altitude)
        return {
            "position": types.vector_map(self._scenery.vehicle(vehicle).local(position)),
            "geo_point": types.geo_map(place),
            "gravity": types.vector_map((0.0, 0.0, GRAVITY_M_S2)),
            "air_pressure": air.pressure_pa,
            "temperature": air.temperature_k,
            "air_density": air.density,
        }

    def home(self, vehicle: Any = "") -> dict[str, float]:
        """getHomeGeoPoint: of the vehicle's NED origin."""
        self._check_vehicle(vehicle)
        return types.geo_map(geographic(self._scenery.vehicle(vehicle).origin_m, self._home))

    def set_wind(self, wind: Any) -> None:
        """simSetWind: m/s NED, until it is set anew."""
        self._simulation.world.set_wind(types.wind(types.vector(wind, "wind")))

    def sees_point(self, point: Any, vehicle: Any = "") -> bool:
        """simTestLineOfSightToPoint: from the vehicle."""
        self._check_vehicle(vehicle)
        return self._sees(self._scenery.truth(vehicle).position_m, self._local(point))

    def sees_between(self, start: Any, end: Any) -> bool:
        """simTestLineOfSightBetweenPoints."""
        return self._sees(self._local(start), self._local(end))

    def _sees(self, start_m: Vector, end_m: Vector) -> bool:
        world = self._simulation.world
        return sees(world.model, world.data, start_m, end_m)

    def _local(self, value: Any) -> Vector:
        position = local(types.geo_point(value), self._home)
        return tuple(types.coordinate(part, "point") for part in position)  # type: ignore[return-value]

    def extents(self) -> list[dict[str, float]]:
        """simGetWorldExtents: the south-western lowest and the north-eastern highest corner of all objects."""
        objects = self._scenery.objects
        corners = np.vstack([objects.corners(name) for name in objects.names()])
        low, high = corners.min(axis=0), corners.max(axis=0)
        lowest = geographic((float(low[0]), float(low[1]), float(high[2])), self._home)
        highest = geographic((float(high[0]), float(high[1]), float(low[2])), self._home)
        return [types.geo_map(lowest), types.geo_map(highest)]

    def load_level(self, name: Any) -> bool:
        """simLoadLevel: true for the scene that is there. Raises ValueError for another."""
        scene = self._simulation.world.scene
        if name != scene:
            raise ValueError(
                f"the scene is {scene!r} and stays; another is chosen as the simulation is started"
            )
        return True

    def _without_effect(self) -> Mapping[str, Callable[..., Any]]:
        """Handlers of what is accepted and of what is refused; either is named once."""
        accepted = {name: self._accept(name, answer) for name, answer in ACCEPTED.items()}
        return accepted | {name: self._refuse(name, reason) for name, reason in REFUSED.items()}

    def _accept(self, name: str, answer: Any) -> Callable[..., Any]:
        def handler(*_: Any) -> Any:
            self._notices.once(f"{name}: accepted, without effect")
            return answer

        return handler

    def _refuse(self, name: str, reason: str) -> Callable[..., Any]:
        def handler(*_: Any) -> Any:
            self._notices.once(f"{name}: refused: {reason}")
            raise ValueError(f"{name} is not available: {reason}")

        return handler
