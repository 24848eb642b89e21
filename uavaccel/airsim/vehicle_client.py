"""AirSim's client of any vehicle: every call of a vehicle and of the world around it.

Source of names, defaults and parameter orders: AirSim v1.8.1, PythonClient/airsim/client.py. A camera's name may
also be its number, as in AirSim's scripts; `external` selects a camera that no vehicle carries. Poses of objects are in
the world's frame. An empty sensor name selects the first sensor of its kind.
"""

# ruff: noqa: N802, N815  the names are AirSim's

from __future__ import annotations

import logging
import math
import sys
from collections.abc import Mapping, Sequence
from typing import Annotated, Any

from uavaccel.airsim.connection import CameraName, Connection, Untyped, connect, remote
from uavaccel.airsim.types import (
    BarometerData,
    CameraInfo,
    CollisionInfo,
    DetectionInfo,
    DistanceSensorData,
    EnvironmentState,
    GeoPoint,
    GpsData,
    ImageRequest,
    ImageResponse,
    ImuData,
    KinematicsState,
    LidarData,
    MagnetometerData,
    MeshPositionVertexBuffersResponse,
    Pose,
    Quaternionr,
    Vector3r,
)
from uavaccel.wire.rpc import LOOPBACK, PORT

CLIENT_VERSION = MIN_SERVER_VERSION = 1
RED = (1.0, 0.0, 0.0, 1.0)
SHOWN_FOR: dict[str, Any] = {"duration": -1.0, "is_persistent": False}
OF_CAMERA: dict[str, Any] = {"vehicle_name": "", "external": False}


class VehicleClient:
    """The calls of every vehicle. Any number of threads may share a client.

    An answer may take `timeout_value` seconds. Raises ConnectionError if no server listens at the address; calls raise
    RpcError with the server's text.
    """

    def __init__(self, ip: str = "", port: int = PORT, timeout_value: float = 3600) -> None:
        self.client: Connection = connect(ip or LOOPBACK, port, timeout_value)

    # --- connection -------------------------------------------------------------------------------

    @remote
    def ping(self) -> bool: ...

    def getClientVersion(self) -> int:
        return CLIENT_VERSION

    @remote
    def getServerVersion(self) -> int: ...

    def getMinRequiredServerVersion(self) -> int:
        return MIN_SERVER_VERSION

    @remote
    def getMinRequiredClientVersion(self) -> int: ...

    def confirmConnection(self) -> None:
        """Ping the server, and print whether the versions match."""
        print("Connected!" if self.ping() else "Ping returned false!")
        server, client = self.getServerVersion(), self.getClientVersion()
        min_server, min_client = self.getMinRequiredServerVersion(), self.getMinRequiredClientVersion()
        versions = f"Client Ver:{client} (Min Req: {min_client}), Server Ver:{server} (Min Req: {min_server})"
        fits = server >= min_server and client >= min_client
        print(versions, file=sys.stdout if fits else sys.stderr)
        if not fits:
            print(f"{'AirSim server' if server < min_server else 'This client'} is too old. Please upgrade!")
        print()

    @remote
    def getSettingsString(self) -> str:
        """Return the server's settings.json as it is in effect."""

    # --- control ----------------------------------------------------------------------------------

    @remote
    def reset(self) -> None:
        """Reset every vehicle to its start; API control and arming have to be requested again."""

    @remote
    def enableApiControl(self, is_enabled: bool, vehicle_name: str = "") -> None:
        """Take or release API control; without it commands have no effect."""

    @remote
    def isApiControlEnabled(self, vehicle_name: str = "") -> bool: ...
    @remote
    def armDisarm(self, arm: bool, vehicle_name: str = "") -> bool: ...
    @remote
    def cancelLastTask(self, vehicle_name: str = "") -> None:
        """Cancel the running command."""

    @remote
    def simAddVehicle(self, vehicle_name: str, vehicle_type: str, pose: Pose, pawn_path: str = "") -> bool: ...
    @remote
    def listVehicles(self) -> list[str]: ...

    # --- clock ------------------------------------------------------------------------------------

    @remote
    def simPause(self, is_paused: bool) -> None: ...

    def simIsPause(self) -> bool:
        return bool(self.client.call("simIsPaused"))

    @remote
    def simContinueForTime(self, seconds: float) -> None:
        """Run for `seconds` of wall time, which is ClockSpeed times as much simulated time, then pause."""

    @remote
    def simContinueForFrames(self, frames: int) -> None:
        """Run for this number of rendered frames, then pause."""

    # --- state ------------------------------------------------------------------------------------

    @remote
    def getHomeGeoPoint(self, vehicle_name: str = "") -> GeoPoint: ...
    @remote
    def simGetCollisionInfo(self, vehicle_name: str = "") -> CollisionInfo:
        """Return the last collision; reading it resets has_collided."""

    @remote
    def simGetVehiclePose(self, vehicle_name: str = "") -> Pose: ...
    @remote
    def simSetVehiclePose(self, pose: Pose, ignore_collision: bool, vehicle_name: str = "") -> None:
        """Put the vehicle at a pose; parts of it that are NaN stay as they are."""

    @remote
    def simGetGroundTruthKinematics(self, vehicle_name: str = "") -> KinematicsState: ...
    @remote
    def simSetKinematics(self, state: KinematicsState, ignore_collision: bool, vehicle_name: str = "") -> None: ...
    @remote
    def simGetGroundTruthEnvironment(self, vehicle_name: str = "") -> EnvironmentState: ...
    @remote
    def simSetWind(self, wind: Vector3r) -> None:
        """Set the wind in metres per second, NED."""

    # --- recording --------------------------------------------------------------------------------

    @remote
    def startRecording(self) -> None: ...
    @remote
    def stopRecording(self) -> None: ...
    @remote
    def isRecording(self) -> bool: ...

    # --- objects ----------------------------------------------------------------------------------

    @remote
    def simListSceneObjects(self, name_regex: str = ".*") -> list[str]:
        """Return the names of the objects that match the regular expression."""

    @remote
    def simGetObjectPose(self, object_name: str) -> Pose:
        """Return the pose of an object; NaN if there is no such object."""

    @remote
    def simSetObjectPose(self, object_name: str, pose: Pose, teleport: bool = True) -> bool: ...
    @remote
    def simGetObjectScale(self, object_name: str) -> Vector3r: ...
    @remote
    def simSetObjectScale(self, object_name: str, scale_vector: Vector3r) -> bool: ...
    @remote
    def simSpawnObject(
        self, object_name: str, asset_name: str, pose: Pose, scale: Vector3r,
        physics_enabled: bool = False, is_blueprint: bool = False,
    ) -> str:  # fmt: skip
        """Add an object, and return the name that it was given."""

    @remote
    def simDestroyObject(self, object_name: str) -> bool: ...
    @remote
    def simListAssets(self) -> list[str]: ...
    @remote
    def simLoadLevel(self, level_name: str) -> bool: ...
    @remote
    def simSetSegmentationObjectID(self, mesh_name: str, object_id: int, is_name_regex: bool = False) -> bool:
        """Set the ID, 0 to 255, of the objects of this name; returns whether there are any."""

    @remote
    def simGetSegmentationObjectID(self, mesh_name: str) -> int:
        """Return the segmentation ID of an object; -1 if there is no such object."""

    @remote
    def simGetMeshPositionVertexBuffers(self) -> list[MeshPositionVertexBuffersResponse]: ...

    # --- geometry -------------------------------------------------------------------------------

    @remote
    def simTestLineOfSightToPoint(self, point: GeoPoint, vehicle_name: str = "") -> bool: ...
    @remote
    def simTestLineOfSightBetweenPoints(self, point1: GeoPoint, point2: GeoPoint) -> bool: ...
    @remote
    def simGetWorldExtents(self) -> list[GeoPoint]:
        """Two opposite corners of the world."""

    # --- images -----------------------------------------------------------------------------------

    @remote
    def simGetImages(
        self, requests: Annotated[Sequence[ImageRequest], list], vehicle_name: str = "", external: bool = False
    ) -> list[ImageResponse]:
        """Take images of one moment, returned in the order of the requests."""

    def simGetImage(
        self, camera_name: str | int, image_type: int, vehicle_name: str = "", external: bool = False
    ) -> bytes | None:
        """Take one image as PNG; None if there is none."""
        image = self.client.call("simGetImage", str(camera_name), image_type, vehicle_name, external)
        return None if image in ("", "\0", b"", b"\0") else image

    @remote
    def simGetCameraInfo(
        self, camera_name: CameraName, vehicle_name: str = "", external: bool = False
    ) -> CameraInfo: ...
    @remote
    def simSetCameraPose(
        self, camera_name: CameraName, pose: Pose, vehicle_name: str = "", external: bool = False
    ) -> None:
        """Set a camera's pose in the vehicle's frame."""

    def simSetCameraOrientation(
        self, camera_name: str | int, orientation: Quaternionr, vehicle_name: str = "", external: bool = False
    ) -> None:
        """Turn a camera in the vehicle's frame without moving it, as in AirSim before 1.6."""
        nowhere = Vector3r(math.nan, math.nan, math.nan)
        self.simSetCameraPose(camera_name, Pose(nowhere, orientation), vehicle_name, external)

    @remote
    def simSetCameraFov(
        self, camera_name: CameraName, fov_degrees: float, vehicle_name: str = "", external: bool = False
    ) -> None:
        """Set the horizontal field of view in degrees."""

    @remote
    def simGetDistortionParams(
        self, camera_name: CameraName, vehicle_name: str = "", external: bool = False
    ) -> list[float]: ...

    def simSetDistortionParams(
        self, camera_name: str | int, distortion_params: Mapping[str, float], vehicle_name: str = "",
        external: bool = False,
    ) -> None:  # fmt: skip
        """Set any of K1, K2, K3, P1 and P2."""
        for name, value in distortion_params.items():
            self.simSetDistortionParam(camera_name, name, value, vehicle_name, external)

    @remote
    def simSetDistortionParam(
        self, camera_name: CameraName, param_name: str, value: float, vehicle_name: str = "",
        external: bool = False,
    ) -> None: ...  # fmt: skip

    # --- detections -------------------------------------------------------------------------------

    @remote
    def simAddDetectionFilterMeshName(
        self, camera_name: str | int, image_type: int, mesh_name: str, vehicle_name: str = "",
        external: bool = False,
    ) -> None:  # fmt: skip
        """Detect the objects of this name, which may contain asterisks."""

    @remote
    def simSetDetectionFilterRadius(
        self, camera_name: str | int, image_type: int, radius_cm: float, vehicle_name: str = "",
        external: bool = False,
    ) -> None: ...  # fmt: skip
    @remote
    def simClearDetectionMeshNames(
        self, camera_name: str | int, image_type: int, vehicle_name: str = "", external: bool = False
    ) -> None: ...
    @remote
    def simGetDetections(
        self, camera_name: str | int, image_type: int, vehicle_name: str = "", external: bool = False
    ) -> list[DetectionInfo]: ...

    # --- Unreal's lenses, surfaces, weather and drawings: without effect, or refused, by this project's server ---

    simSwapTextures = Untyped("tags", tex_id=0, component_id=0, material_id=0)
    simSetObjectMaterial = Untyped("object_name", "material_name", component_id=0)
    simSetObjectMaterialFromTexture = Untyped("object_name", "texture_path", component_id=0)
    simSetLightIntensity = Untyped("light_name", "intensity")
    simCreateVoxelGrid = Untyped("position", "x", "y", "z", "res", "of")
    simSetTimeOfDay = Untyped(
        "is_enabled",
        start_datetime="",
        is_start_datetime_dst=False,
        celestial_clock_speed=1,
        update_interval_secs=60,
        move_sun=True,
    )
    simEnableWeather = Untyped("enable")
    simSetWeatherParameter = Untyped("param", "val")
    simRunConsoleCommand = Untyped("command")
    simPrintLogMessage = Untyped("message", message_param="", severity=0)
    simSetTraceLine = Untyped("color_rgba", thickness=1.0, vehicle_name="")
    simFlushPersistentMarkers = Untyped()
    simPlotPoints = Untyped("points", color_rgba=RED, size=10.0, **SHOWN_FOR)
    simPlotLineStrip = Untyped("points", color_rgba=RED, thickness=5.0, **SHOWN_FOR)
    simPlotLineList = Untyped("points", color_rgba=RED, thickness=5.0, **SHOWN_FOR)
    simPlotArrows = Untyped("points_start", "points_end", color_rgba=RED, thickness=5.0, arrow_size=2.0, **SHOWN_FOR)
    simPlotStrings = Untyped("strings", "positions", scale=5, color_rgba=RED, duration=-1.0)
    simPlotTransforms = Untyped("poses", scale=5.0, thickness=5.0, **SHOWN_FOR)
    simPlotTransformsWithNames = Untyped(
        "poses", "names", tf_scale=5.0, tf_thickness=5.0, text_scale=10.0, text_color_rgba=RED, duration=-1.0
    )
    simGetPresetLensSettings = Untyped("camera_name", **OF_CAMERA)
    simGetLensSettings = Untyped("camera_name", **OF_CAMERA)
    simSetPresetLensSettings = Untyped("preset_lens_settings", "camera_name", **OF_CAMERA)
    simGetPresetFilmbackSettings = Untyped("camera_name", **OF_CAMERA)
    simSetPresetFilmbackSettings = Untyped("preset_filmback_settings", "camera_name", **OF_CAMERA)
    simGetFilmbackSettings = Untyped("camera_name", **OF_CAMERA)
    simSetFilmbackSettings = Untyped("sensor_width", "sensor_height", "camera_name", **OF_CAMERA)
    simGetFocalLength = Untyped("camera_name", **OF_CAMERA)
    simSetFocalLength = Untyped("focal_length", "camera_name", **OF_CAMERA)
    simEnableManualFocus = Untyped("enable", "camera_name", **OF_CAMERA)
    simGetFocusDistance = Untyped("camera_name", **OF_CAMERA)
    simSetFocusDistance = Untyped("focus_distance", "camera_name", **OF_CAMERA)
    simGetFocusAperture = Untyped("camera_name", **OF_CAMERA)
    simSetFocusAperture = Untyped("focus_aperture", "camera_name", **OF_CAMERA)
    simEnableFocusPlane = Untyped("enable", "camera_name", **OF_CAMERA)
    simGetCurrentFieldOfView = Untyped("camera_name", **OF_CAMERA)

    # --- sensors ------------------------------------------------------------------------------------

    @remote
    def getImuData(self, imu_name: str = "", vehicle_name: str = "") -> ImuData: ...
    @remote
    def getBarometerData(self, barometer_name: str = "", vehicle_name: str = "") -> BarometerData: ...
    @remote
    def getMagnetometerData(self, magnetometer_name: str = "", vehicle_name: str = "") -> MagnetometerData: ...
    @remote
    def getGpsData(self, gps_name: str = "", vehicle_name: str = "") -> GpsData: ...
    @remote
    def getDistanceSensorData(self, distance_sensor_name: str = "", vehicle_name: str = "") -> DistanceSensorData: ...
    @remote
    def getLidarData(self, lidar_name: str = "", vehicle_name: str = "") -> LidarData: ...

    def simGetLidarSegmentation(self, lidar_name: str = "", vehicle_name: str = "") -> object:
        logging.warning("simGetLidarSegmentation API is deprecated, use getLidarData() API instead")
        return self.getLidarData(lidar_name, vehicle_name).segmentation
