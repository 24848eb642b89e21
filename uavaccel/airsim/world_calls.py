"""The calls of AirSim's clients about the world: objects, weather, lines of sight, plots. Poses are of the world."""

# ruff: noqa: N802  the names are AirSim's

from __future__ import annotations

from collections.abc import Sequence

from uavaccel.airsim.calls import Calls
from uavaccel.airsim.types import GeoPoint, MeshPositionVertexBuffersResponse, Pose, Vector3r

RED = (1.0, 0.0, 0.0, 1.0)


class WorldCalls(Calls):
    # --- objects ----------------------------------------------------------------------------------

    def simListSceneObjects(self, name_regex: str = ".*") -> list[str]:
        """Names of the objects that the regular expression matches."""
        return list(self.client.call("simListSceneObjects", name_regex))

    def simGetObjectPose(self, object_name: str) -> Pose:
        """NaN where there is no such object."""
        return Pose.from_msgpack(self.client.call("simGetObjectPose", object_name))

    def simSetObjectPose(self, object_name: str, pose: Pose, teleport: bool = True) -> bool:
        return bool(self.client.call("simSetObjectPose", object_name, pose, teleport))

    def simGetObjectScale(self, object_name: str) -> Vector3r:
        return Vector3r.from_msgpack(self.client.call("simGetObjectScale", object_name))

    def simSetObjectScale(self, object_name: str, scale_vector: Vector3r) -> bool:
        return bool(self.client.call("simSetObjectScale", object_name, scale_vector))

    def simSpawnObject(
        self,
        object_name: str,
        asset_name: str,
        pose: Pose,
        scale: Vector3r,
        physics_enabled: bool = False,
        is_blueprint: bool = False,
    ) -> str:
        """Returns the name that the object was given."""
        return str(
            self.client.call(
                "simSpawnObject", object_name, asset_name, pose, scale, physics_enabled, is_blueprint
            )
        )

    def simDestroyObject(self, object_name: str) -> bool:
        return bool(self.client.call("simDestroyObject", object_name))

    def simListAssets(self) -> list[str]:
        return list(self.client.call("simListAssets"))

    def simLoadLevel(self, level_name: str) -> bool:
        return bool(self.client.call("simLoadLevel", level_name))

    def simSetSegmentationObjectID(self, mesh_name: str, object_id: int, is_name_regex: bool = False) -> bool:
        """IDs are 0 to 255; returns whether an object was found."""
        return bool(self.client.call("simSetSegmentationObjectID", mesh_name, object_id, is_name_regex))

    def simGetSegmentationObjectID(self, mesh_name: str) -> int:
        """-1 where there is no such object."""
        return int(self.client.call("simGetSegmentationObjectID", mesh_name))

    def simSwapTextures(
        self, tags: str, tex_id: int = 0, component_id: int = 0, material_id: int = 0
    ) -> list[str]:
        return list(self.client.call("simSwapTextures", tags, tex_id, component_id, material_id))

    def simSetObjectMaterial(self, object_name: str, material_name: str, component_id: int = 0) -> bool:
        return bool(self.client.call("simSetObjectMaterial", object_name, material_name, component_id))

    def simSetObjectMaterialFromTexture(
        self, object_name: str, texture_path: str, component_id: int = 0
    ) -> bool:
        return bool(
            self.client.call("simSetObjectMaterialFromTexture", object_name, texture_path, component_id)
        )

    def simSetLightIntensity(self, light_name: str, intensity: float) -> bool:
        return bool(self.client.call("simSetLightIntensity", light_name, intensity))

    def simGetMeshPositionVertexBuffers(self) -> list[MeshPositionVertexBuffersResponse]:
        meshes = self.client.call("simGetMeshPositionVertexBuffers")
        return [MeshPositionVertexBuffersResponse.from_msgpack(mesh) for mesh in meshes]

    # --- sky and weather ------------------------------------------------------------------------

    def simSetTimeOfDay(
        self,
        is_enabled: bool,
        start_datetime: str = "",
        is_start_datetime_dst: bool = False,
        celestial_clock_speed: float = 1,
        update_interval_secs: float = 60,
        move_sun: bool = True,
    ) -> None:
        self.client.call(
            "simSetTimeOfDay",
            is_enabled,
            start_datetime,
            is_start_datetime_dst,
            celestial_clock_speed,
            update_interval_secs,
            move_sun,
        )

    def simEnableWeather(self, enable: bool) -> None:
        self.client.call("simEnableWeather", enable)

    def simSetWeatherParameter(self, param: int, val: float) -> None:
        """A WeatherParameter, and 0 to 1."""
        self.client.call("simSetWeatherParameter", param, val)

    # --- geometry -------------------------------------------------------------------------------

    def simTestLineOfSightToPoint(self, point: GeoPoint, vehicle_name: str = "") -> bool:
        return bool(self.client.call("simTestLineOfSightToPoint", point, vehicle_name))

    def simTestLineOfSightBetweenPoints(self, point1: GeoPoint, point2: GeoPoint) -> bool:
        return bool(self.client.call("simTestLineOfSightBetweenPoints", point1, point2))

    def simGetWorldExtents(self) -> list[GeoPoint]:
        """Two opposite corners."""
        return [GeoPoint.from_msgpack(corner) for corner in self.client.call("simGetWorldExtents")]

    def simCreateVoxelGrid(self, position: Vector3r, x: int, y: int, z: int, res: float, of: str) -> bool:
        return bool(self.client.call("simCreateVoxelGrid", position, x, y, z, res, of))

    # --- display --------------------------------------------------------------------------------

    def simRunConsoleCommand(self, command: str) -> bool:
        return bool(self.client.call("simRunConsoleCommand", command))

    def simPrintLogMessage(self, message: str, message_param: str = "", severity: int = 0) -> None:
        self.client.call("simPrintLogMessage", message, message_param, severity)

    def simSetTraceLine(
        self, color_rgba: Sequence[float], thickness: float = 1.0, vehicle_name: str = ""
    ) -> None:
        self.client.call("simSetTraceLine", color_rgba, thickness, vehicle_name)

    def simFlushPersistentMarkers(self) -> None:
        self.client.call("simFlushPersistentMarkers")

    def simPlotPoints(
        self,
        points: Sequence[Vector3r],
        color_rgba: Sequence[float] = RED,
        size: float = 10.0,
        duration: float = -1.0,
        is_persistent: bool = False,
    ) -> None:
        self.client.call("simPlotPoints", points, color_rgba, size, duration, is_persistent)

    def simPlotLineStrip(
        self,
        points: Sequence[Vector3r],
        color_rgba: Sequence[float] = RED,
        thickness: float = 5.0,
        duration: float = -1.0,
        is_persistent: bool = False,
    ) -> None:
        self.client.call("simPlotLineStrip", points, color_rgba, thickness, duration, is_persistent)

    def simPlotLineList(
        self,
        points: Sequence[Vector3r],
        color_rgba: Sequence[float] = RED,
        thickness: float = 5.0,
        duration: float = -1.0,
        is_persistent: bool = False,
    ) -> None:
        self.client.call("simPlotLineList", points, color_rgba, thickness, duration, is_persistent)

    def simPlotArrows(
        self,
        points_start: Sequence[Vector3r],
        points_end: Sequence[Vector3r],
        color_rgba: Sequence[float] = RED,
        thickness: float = 5.0,
        arrow_size: float = 2.0,
        duration: float = -1.0,
        is_persistent: bool = False,
    ) -> None:
        self.client.call(
            "simPlotArrows",
            points_start,
            points_end,
            color_rgba,
            thickness,
            arrow_size,
            duration,
            is_persistent,
        )

    def simPlotStrings(
        self,
        strings: Sequence[str],
        positions: Sequence[Vector3r],
        scale: float = 5,
        color_rgba: Sequence[float] = RED,
        duration: float = -1.0,
    ) -> None:
        self.client.call("simPlotStrings", strings, positions, scale, color_rgba, duration)

    def simPlotTransforms(
        self,
        poses: Sequence[Pose],
        scale: float = 5.0,
        thickness: float = 5.0,
        duration: float = -1.0,
        is_persistent: bool = False,
    ) -> None:
        self.client.call("simPlotTransforms", poses, scale, thickness, duration, is_persistent)

    def simPlotTransformsWithNames(
        self,
        poses: Sequence[Pose],
        names: Sequence[str],
        tf_scale: float = 5.0,
        tf_thickness: float = 5.0,
        text_scale: float = 10.0,
        text_color_rgba: Sequence[float] = RED,
        duration: float = -1.0,
    ) -> None:
        self.client.call(
            "simPlotTransformsWithNames",
            poses,
            names,
            tf_scale,
            tf_thickness,
            text_scale,
            text_color_rgba,
            duration,
        )
