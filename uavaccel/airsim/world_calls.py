"""The calls of AirSim's clients about the world: objects, weather, lines of sight, plots. Poses are of the world."""

# ruff: noqa: N802  the names are AirSim's

from __future__ import annotations

from collections.abc import Sequence

from uavaccel.airsim.calls import Calls, remote
from uavaccel.airsim.types import GeoPoint, MeshPositionVertexBuffersResponse, Pose, Vector3r

RED = (1.0, 0.0, 0.0, 1.0)


class WorldCalls(Calls):
    # --- objects ----------------------------------------------------------------------------------

    @remote
    def simListSceneObjects(self, name_regex: str = ".*") -> list[str]:
        """Names of the objects that the regular expression matches."""

    @remote
    def simGetObjectPose(self, object_name: str) -> Pose:
        """NaN where there is no such object."""

    @remote
    def simSetObjectPose(self, object_name: str, pose: Pose, teleport: bool = True) -> bool: ...

    @remote
    def simGetObjectScale(self, object_name: str) -> Vector3r: ...

    @remote
    def simSetObjectScale(self, object_name: str, scale_vector: Vector3r) -> bool: ...

    @remote
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

    @remote
    def simDestroyObject(self, object_name: str) -> bool: ...

    @remote
    def simListAssets(self) -> list[str]: ...

    @remote
    def simLoadLevel(self, level_name: str) -> bool: ...

    @remote
    def simSetSegmentationObjectID(self, mesh_name: str, object_id: int, is_name_regex: bool = False) -> bool:
        """IDs are 0 to 255; returns whether an object was found."""

    @remote
    def simGetSegmentationObjectID(self, mesh_name: str) -> int:
        """-1 where there is no such object."""

    @remote
    def simSwapTextures(
        self, tags: str, tex_id: int = 0, component_id: int = 0, material_id: int = 0
    ) -> list[str]: ...

    @remote
    def simSetObjectMaterial(self, object_name: str, material_name: str, component_id: int = 0) -> bool: ...

    @remote
    def simSetObjectMaterialFromTexture(
        self, object_name: str, texture_path: str, component_id: int = 0
    ) -> bool: ...

    @remote
    def simSetLightIntensity(self, light_name: str, intensity: float) -> bool: ...

    @remote
    def simGetMeshPositionVertexBuffers(self) -> list[MeshPositionVertexBuffersResponse]: ...

    # --- sky and weather ------------------------------------------------------------------------

    @remote
    def simSetTimeOfDay(
        self,
        is_enabled: bool,
        start_datetime: str = "",
        is_start_datetime_dst: bool = False,
        celestial_clock_speed: float = 1,
        update_interval_secs: float = 60,
        move_sun: bool = True,
    ) -> None: ...

    @remote
    def simEnableWeather(self, enable: bool) -> None: ...

    @remote
    def simSetWeatherParameter(self, param: int, val: float) -> None:
        """A WeatherParameter, and 0 to 1."""

    # --- geometry -------------------------------------------------------------------------------

    @remote
    def simTestLineOfSightToPoint(self, point: GeoPoint, vehicle_name: str = "") -> bool: ...

    @remote
    def simTestLineOfSightBetweenPoints(self, point1: GeoPoint, point2: GeoPoint) -> bool: ...

    @remote
    def simGetWorldExtents(self) -> list[GeoPoint]:
        """Two opposite corners."""

    @remote
    def simCreateVoxelGrid(self, position: Vector3r, x: int, y: int, z: int, res: float, of: str) -> bool: ...

    # --- display --------------------------------------------------------------------------------

    @remote
    def simRunConsoleCommand(self, command: str) -> bool: ...

    @remote
    def simPrintLogMessage(self, message: str, message_param: str = "", severity: int = 0) -> None: ...

    @remote
    def simSetTraceLine(
        self, color_rgba: Sequence[float], thickness: float = 1.0, vehicle_name: str = ""
    ) -> None: ...

    @remote
    def simFlushPersistentMarkers(self) -> None: ...

    @remote
    def simPlotPoints(
        self,
        points: Sequence[Vector3r],
        color_rgba: Sequence[float] = RED,
        size: float = 10.0,
        duration: float = -1.0,
        is_persistent: bool = False,
    ) -> None: ...

    @remote
    def simPlotLineStrip(
        self,
        points: Sequence[Vector3r],
        color_rgba: Sequence[float] = RED,
        thickness: float = 5.0,
        duration: float = -1.0,
        is_persistent: bool = False,
    ) -> None: ...

    @remote
    def simPlotLineList(
        self,
        points: Sequence[Vector3r],
        color_rgba: Sequence[float] = RED,
        thickness: float = 5.0,
        duration: float = -1.0,
        is_persistent: bool = False,
    ) -> None: ...

    @remote
    def simPlotArrows(
        self,
        points_start: Sequence[Vector3r],
        points_end: Sequence[Vector3r],
        color_rgba: Sequence[float] = RED,
        thickness: float = 5.0,
        arrow_size: float = 2.0,
        duration: float = -1.0,
        is_persistent: bool = False,
    ) -> None: ...

    @remote
    def simPlotStrings(
        self,
        strings: Sequence[str],
        positions: Sequence[Vector3r],
        scale: float = 5,
        color_rgba: Sequence[float] = RED,
        duration: float = -1.0,
    ) -> None: ...

    @remote
    def simPlotTransforms(
        self,
        poses: Sequence[Pose],
        scale: float = 5.0,
        thickness: float = 5.0,
        duration: float = -1.0,
        is_persistent: bool = False,
    ) -> None: ...

    @remote
    def simPlotTransformsWithNames(
        self,
        poses: Sequence[Pose],
        names: Sequence[str],
        tf_scale: float = 5.0,
        tf_thickness: float = 5.0,
        text_scale: float = 10.0,
        text_color_rgba: Sequence[float] = RED,
        duration: float = -1.0,
    ) -> None: ...
