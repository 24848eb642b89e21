"""The calls of AirSim's clients about cameras and images.

A camera's name may be a number, as in AirSim's scripts. `external` asks for a camera that no vehicle carries.
"""

# ruff: noqa: N802  the names are AirSim's

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Annotated

from uavaccel.airsim.calls import Calls, CameraName, remote
from uavaccel.airsim.types import CameraInfo, DetectionInfo, ImageRequest, ImageResponse, Pose
from uavaccel.airsim.vectors import Quaternionr, Vector3r


class CameraCalls(Calls):
    # --- images -----------------------------------------------------------------------------------

    @remote
    def simGetImages(
        self,
        requests: Annotated[Sequence[ImageRequest], list],
        vehicle_name: str = "",
        external: bool = False,
    ) -> list[ImageResponse]:
        """Images of one moment, in the order of the requests."""

    def simGetImage(
        self, camera_name: str | int, image_type: int, vehicle_name: str = "", external: bool = False
    ) -> bytes | None:
        """One image as PNG, or None if there is none."""
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
        """The pose in the frame of the vehicle."""

    def simSetCameraOrientation(
        self, camera_name: str | int, orientation: Quaternionr, vehicle_name: str = "", external: bool = False
    ) -> None:
        """Of AirSim before 1.6: turn a camera in the frame of the vehicle, and leave it where it is there."""
        nowhere = Vector3r(math.nan, math.nan, math.nan)
        self.simSetCameraPose(camera_name, Pose(nowhere, orientation), vehicle_name, external)

    @remote
    def simSetCameraFov(
        self, camera_name: CameraName, fov_degrees: float, vehicle_name: str = "", external: bool = False
    ) -> None:
        """The horizontal field of view in degrees."""

    @remote
    def simGetDistortionParams(
        self, camera_name: CameraName, vehicle_name: str = "", external: bool = False
    ) -> list[float]: ...

    def simSetDistortionParams(
        self,
        camera_name: str | int,
        distortion_params: Mapping[str, float],
        vehicle_name: str = "",
        external: bool = False,
    ) -> None:
        """Any of K1, K2, K3, P1 and P2."""
        for name, value in distortion_params.items():
            self.simSetDistortionParam(camera_name, name, value, vehicle_name, external)

    @remote
    def simSetDistortionParam(
        self,
        camera_name: CameraName,
        param_name: str,
        value: float,
        vehicle_name: str = "",
        external: bool = False,
    ) -> None: ...

    # --- detections -------------------------------------------------------------------------------

    @remote
    def simAddDetectionFilterMeshName(
        self,
        camera_name: str | int,
        image_type: int,
        mesh_name: str,
        vehicle_name: str = "",
        external: bool = False,
    ) -> None:
        """Detect objects of this name, which may end in an asterisk."""

    @remote
    def simSetDetectionFilterRadius(
        self,
        camera_name: str | int,
        image_type: int,
        radius_cm: float,
        vehicle_name: str = "",
        external: bool = False,
    ) -> None: ...

    @remote
    def simClearDetectionMeshNames(
        self, camera_name: str | int, image_type: int, vehicle_name: str = "", external: bool = False
    ) -> None: ...

    @remote
    def simGetDetections(
        self, camera_name: str | int, image_type: int, vehicle_name: str = "", external: bool = False
    ) -> list[DetectionInfo]: ...

    # --- lenses -----------------------------------------------------------------------------------

    @remote
    def simGetPresetLensSettings(
        self, camera_name: str | int, vehicle_name: str = "", external: bool = False
    ) -> object: ...

    @remote
    def simGetLensSettings(
        self, camera_name: str | int, vehicle_name: str = "", external: bool = False
    ) -> object: ...

    @remote
    def simSetPresetLensSettings(
        self,
        preset_lens_settings: str,
        camera_name: str | int,
        vehicle_name: str = "",
        external: bool = False,
    ) -> None: ...

    @remote
    def simGetPresetFilmbackSettings(
        self, camera_name: str | int, vehicle_name: str = "", external: bool = False
    ) -> object: ...

    @remote
    def simSetPresetFilmbackSettings(
        self,
        preset_filmback_settings: str,
        camera_name: str | int,
        vehicle_name: str = "",
        external: bool = False,
    ) -> None: ...

    @remote
    def simGetFilmbackSettings(
        self, camera_name: str | int, vehicle_name: str = "", external: bool = False
    ) -> object: ...

    @remote
    def simSetFilmbackSettings(
        self,
        sensor_width: float,
        sensor_height: float,
        camera_name: str | int,
        vehicle_name: str = "",
        external: bool = False,
    ) -> object: ...

    @remote
    def simGetFocalLength(
        self, camera_name: str | int, vehicle_name: str = "", external: bool = False
    ) -> object: ...

    @remote
    def simSetFocalLength(
        self, focal_length: float, camera_name: str | int, vehicle_name: str = "", external: bool = False
    ) -> None: ...

    @remote
    def simEnableManualFocus(
        self, enable: bool, camera_name: str | int, vehicle_name: str = "", external: bool = False
    ) -> None: ...

    @remote
    def simGetFocusDistance(
        self, camera_name: str | int, vehicle_name: str = "", external: bool = False
    ) -> object: ...

    @remote
    def simSetFocusDistance(
        self, focus_distance: float, camera_name: str | int, vehicle_name: str = "", external: bool = False
    ) -> None: ...

    @remote
    def simGetFocusAperture(
        self, camera_name: str | int, vehicle_name: str = "", external: bool = False
    ) -> object: ...

    @remote
    def simSetFocusAperture(
        self, focus_aperture: float, camera_name: str | int, vehicle_name: str = "", external: bool = False
    ) -> None: ...

    @remote
    def simEnableFocusPlane(
        self, enable: bool, camera_name: str | int, vehicle_name: str = "", external: bool = False
    ) -> None: ...

    @remote
    def simGetCurrentFieldOfView(
        self, camera_name: str | int, vehicle_name: str = "", external: bool = False
    ) -> object: ...
