"""The calls of AirSim's clients about cameras and images.

A camera's name may be a number, as in AirSim's scripts. `external` asks for a camera that no vehicle carries.
"""

# ruff: noqa: N802  the names are AirSim's

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from uavaccel.airsim.calls import Calls
from uavaccel.airsim.types import CameraInfo, DetectionInfo, ImageRequest, ImageResponse, Pose
from uavaccel.airsim.vectors import Quaternionr, Vector3r


class CameraCalls(Calls):
    # --- images -----------------------------------------------------------------------------------

    def simGetImages(
        self, requests: Sequence[ImageRequest], vehicle_name: str = "", external: bool = False
    ) -> list[ImageResponse]:
        """Images of one moment, in the order of the requests."""
        responses = self.client.call("simGetImages", list(requests), vehicle_name, external)
        return [ImageResponse.from_msgpack(response) for response in responses]

    def simGetImage(
        self, camera_name: str | int, image_type: int, vehicle_name: str = "", external: bool = False
    ) -> bytes | None:
        """One image as PNG, or None if there is none."""
        image = self.client.call("simGetImage", str(camera_name), image_type, vehicle_name, external)
        return None if image in ("", "\0", b"", b"\0") else image

    def simGetCameraInfo(
        self, camera_name: str | int, vehicle_name: str = "", external: bool = False
    ) -> CameraInfo:
        return CameraInfo.from_msgpack(
            self.client.call("simGetCameraInfo", str(camera_name), vehicle_name, external)
        )

    def simSetCameraPose(
        self, camera_name: str | int, pose: Pose, vehicle_name: str = "", external: bool = False
    ) -> None:
        """The pose in the frame of the vehicle."""
        self.client.call("simSetCameraPose", str(camera_name), pose, vehicle_name, external)

    def simSetCameraOrientation(
        self, camera_name: str | int, orientation: Quaternionr, vehicle_name: str = "", external: bool = False
    ) -> None:
        """Of AirSim before 1.6: turn a camera in the frame of the vehicle, and leave it where it is there."""
        nowhere = Vector3r(math.nan, math.nan, math.nan)
        self.simSetCameraPose(camera_name, Pose(nowhere, orientation), vehicle_name, external)

    def simSetCameraFov(
        self, camera_name: str | int, fov_degrees: float, vehicle_name: str = "", external: bool = False
    ) -> None:
        """The horizontal field of view in degrees."""
        self.client.call("simSetCameraFov", str(camera_name), fov_degrees, vehicle_name, external)

    def simGetDistortionParams(
        self, camera_name: str | int, vehicle_name: str = "", external: bool = False
    ) -> list[float]:
        return list(self.client.call("simGetDistortionParams", str(camera_name), vehicle_name, external))

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

    def simSetDistortionParam(
        self,
        camera_name: str | int,
        param_name: str,
        value: float,
        vehicle_name: str = "",
        external: bool = False,
    ) -> None:
        self.client.call("simSetDistortionParam", str(camera_name), param_name, value, vehicle_name, external)

    # --- detections -------------------------------------------------------------------------------

    def simAddDetectionFilterMeshName(
        self,
        camera_name: str | int,
        image_type: int,
        mesh_name: str,
        vehicle_name: str = "",
        external: bool = False,
    ) -> None:
        """Detect objects of this name, which may end in an asterisk."""
        self.client.call(
            "simAddDetectionFilterMeshName", camera_name, image_type, mesh_name, vehicle_name, external
        )

    def simSetDetectionFilterRadius(
        self,
        camera_name: str | int,
        image_type: int,
        radius_cm: float,
        vehicle_name: str = "",
        external: bool = False,
    ) -> None:
        self.client.call(
            "simSetDetectionFilterRadius", camera_name, image_type, radius_cm, vehicle_name, external
        )

    def simClearDetectionMeshNames(
        self, camera_name: str | int, image_type: int, vehicle_name: str = "", external: bool = False
    ) -> None:
        self.client.call("simClearDetectionMeshNames", camera_name, image_type, vehicle_name, external)

    def simGetDetections(
        self, camera_name: str | int, image_type: int, vehicle_name: str = "", external: bool = False
    ) -> list[DetectionInfo]:
        detections = self.client.call("simGetDetections", camera_name, image_type, vehicle_name, external)
        return [DetectionInfo.from_msgpack(detection) for detection in detections]

    # --- lenses -----------------------------------------------------------------------------------

    def simGetPresetLensSettings(
        self, camera_name: str | int, vehicle_name: str = "", external: bool = False
    ) -> Any:
        return self.client.call("simGetPresetLensSettings", camera_name, vehicle_name, external)

    def simGetLensSettings(
        self, camera_name: str | int, vehicle_name: str = "", external: bool = False
    ) -> Any:
        return self.client.call("simGetLensSettings", camera_name, vehicle_name, external)

    def simSetPresetLensSettings(
        self,
        preset_lens_settings: str,
        camera_name: str | int,
        vehicle_name: str = "",
        external: bool = False,
    ) -> None:
        self.client.call(
            "simSetPresetLensSettings", preset_lens_settings, camera_name, vehicle_name, external
        )

    def simGetPresetFilmbackSettings(
        self, camera_name: str | int, vehicle_name: str = "", external: bool = False
    ) -> Any:
        return self.client.call("simGetPresetFilmbackSettings", camera_name, vehicle_name, external)

    def simSetPresetFilmbackSettings(
        self,
        preset_filmback_settings: str,
        camera_name: str | int,
        vehicle_name: str = "",
        external: bool = False,
    ) -> None:
        self.client.call(
            "simSetPresetFilmbackSettings", preset_filmback_settings, camera_name, vehicle_name, external
        )

    def simGetFilmbackSettings(
        self, camera_name: str | int, vehicle_name: str = "", external: bool = False
    ) -> Any:
        return self.client.call("simGetFilmbackSettings", camera_name, vehicle_name, external)

    def simSetFilmbackSettings(
        self,
        sensor_width: float,
        sensor_height: float,
        camera_name: str | int,
        vehicle_name: str = "",
        external: bool = False,
    ) -> Any:
        return self.client.call(
            "simSetFilmbackSettings", sensor_width, sensor_height, camera_name, vehicle_name, external
        )

    def simGetFocalLength(
        self, camera_name: str | int, vehicle_name: str = "", external: bool = False
    ) -> Any:
        return self.client.call("simGetFocalLength", camera_name, vehicle_name, external)

    def simSetFocalLength(
        self, focal_length: float, camera_name: str | int, vehicle_name: str = "", external: bool = False
    ) -> None:
        self.client.call("simSetFocalLength", focal_length, camera_name, vehicle_name, external)

    def simEnableManualFocus(
        self, enable: bool, camera_name: str | int, vehicle_name: str = "", external: bool = False
    ) -> None:
        self.client.call("simEnableManualFocus", enable, camera_name, vehicle_name, external)

    def simGetFocusDistance(
        self, camera_name: str | int, vehicle_name: str = "", external: bool = False
    ) -> Any:
        return self.client.call("simGetFocusDistance", camera_name, vehicle_name, external)

    def simSetFocusDistance(
        self, focus_distance: float, camera_name: str | int, vehicle_name: str = "", external: bool = False
    ) -> None:
        self.client.call("simSetFocusDistance", focus_distance, camera_name, vehicle_name, external)

    def simGetFocusAperture(
        self, camera_name: str | int, vehicle_name: str = "", external: bool = False
    ) -> Any:
        return self.client.call("simGetFocusAperture", camera_name, vehicle_name, external)

    def simSetFocusAperture(
        self, focus_aperture: float, camera_name: str | int, vehicle_name: str = "", external: bool = False
    ) -> None:
        self.client.call("simSetFocusAperture", focus_aperture, camera_name, vehicle_name, external)

    def simEnableFocusPlane(
        self, enable: bool, camera_name: str | int, vehicle_name: str = "", external: bool = False
    ) -> None:
        self.client.call("simEnableFocusPlane", enable, camera_name, vehicle_name, external)

    def simGetCurrentFieldOfView(
        self, camera_name: str | int, vehicle_name: str = "", external: bool = False
    ) -> Any:
        return self.client.call("simGetCurrentFieldOfView", camera_name, vehicle_name, external)
