"""AirSim's calls about a vehicle's cameras: where they are, how wide they see, how they project.

Sources: AirSim v1.8.1, PIPCamera.cpp (projection, field of view, distortion), CommonStructs.hpp (CameraInfo).
"""

# ruff: noqa: N815  the names are AirSim's

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from uavaccel.sim.camera.mounted import Lens
from uavaccel.sim.poses import Pose
from uavaccel.wire import types
from uavaccel.wire.arguments import AnyPose, Truthy, VehicleName
from uavaccel.wire.calls import Calls, WithoutEffect, call
from uavaccel.wire.cameras import NARROWEST_DEG, SCENE, WIDEST_DEG, MountedAs

NEAR_CM = 10.0  # GNearClippingPlane
NO_LENS = "cameras here are pinholes; simSetCameraFov sets what they see"


class CameraApi(Calls, title="Cameras and images"):
    @call("simGetCameraInfo")
    def info(
        self, camera_name: object, vehicle: VehicleName = "", external: Truthy = False
    ) -> dict[str, object]:
        """Pose NED, degrees, and the projection of NED centimetres from the camera."""
        mounted = self._named(camera_name, vehicle, external)
        kinematics, lens = self.scenery.truth(vehicle), mounted.lens(SCENE)
        eye = mounted.eye(Pose(kinematics.position_m, kinematics.orientation_wxyz))
        local = eye._replace(position_m=self.scenery.vehicle(vehicle).local(eye.position_m))
        matrix = {"matrix": projection(lens).tolist()}
        return {"pose": types.pose_map(local), "fov": lens.fov_deg, "proj_mat": matrix}

    @call("simSetCameraPose")
    def set_pose(
        self, camera_name: object, pose: AnyPose, vehicle: VehicleName = "", external: Truthy = False
    ) -> None:
        """Relative to the vehicle, FRD; NaN leaves a part as it is."""
        mounted = self._named(camera_name, vehicle, external)
        position, orientation = pose
        keep = [any(map(math.isnan, part)) for part in (position, orientation)]
        mounted.mount = Pose(
            mounted.mount.position_m if keep[0] else position,
            mounted.mount.orientation_wxyz if keep[1] else orientation,
        )

    @call("simSetCameraFov")
    def set_fov(
        self, camera_name: object, fov_degrees: float, vehicle: VehicleName = "", external: Truthy = False
    ) -> None:
        """From the left to the right edge, of all types of image."""
        mounted = self._named(camera_name, vehicle, external)
        if not NARROWEST_DEG <= fov_degrees <= WIDEST_DEG:
            raise ValueError(f"fov_degrees must be {NARROWEST_DEG:g} to {WIDEST_DEG:g}, not {fov_degrees:g}")
        mounted.set_fov(fov_degrees)

    @call("simGetDistortionParams")
    def distortion(
        self, camera_name: object, vehicle: VehicleName = "", external: Truthy = False
    ) -> list[float]:
        """K1, K2, K3, P1, P2."""
        return list(self._named(camera_name, vehicle, external).distortion.values())

    @call("simSetDistortionParam")
    def set_distortion(
        self,
        camera_name: object,
        param_name: object,
        value: float,
        vehicle: VehicleName = "",
        external: Truthy = False,
    ) -> None:
        """Kept and told; pictures stay undistorted."""
        known = self._named(camera_name, vehicle, external).distortion
        if not isinstance(param_name, str) or param_name not in known:
            raise ValueError(f"no distortion parameter {param_name!r}; there are {', '.join(known)}")
        known[param_name] = value
        self.notices.once("simSetDistortionParam: accepted; pictures stay undistorted")

    def _named(self, camera: object, vehicle: str, external: bool) -> MountedAs:
        return self.scenery.cameras(vehicle, external).named(camera)

    simGetPresetLensSettings = WithoutEffect(refused=NO_LENS)
    simGetLensSettings = WithoutEffect(refused=NO_LENS)
    simSetPresetLensSettings = WithoutEffect(refused=NO_LENS)
    simGetPresetFilmbackSettings = WithoutEffect(refused=NO_LENS)
    simSetPresetFilmbackSettings = WithoutEffect(refused=NO_LENS)
    simGetFilmbackSettings = WithoutEffect(refused=NO_LENS)
    simSetFilmbackSettings = WithoutEffect(refused=NO_LENS)
    simGetFocalLength = WithoutEffect(refused=NO_LENS)
    simSetFocalLength = WithoutEffect(refused=NO_LENS)
    simEnableManualFocus = WithoutEffect(refused=NO_LENS)
    simGetFocusDistance = WithoutEffect(refused=NO_LENS)
    simSetFocusDistance = WithoutEffect(refused=NO_LENS)
    simGetFocusAperture = WithoutEffect(refused=NO_LENS)
    simSetFocusAperture = WithoutEffect(refused=NO_LENS)
    simEnableFocusPlane = WithoutEffect(refused=NO_LENS)
    simGetCurrentFieldOfView = WithoutEffect(refused=NO_LENS)


def projection(lens: Lens) -> NDArray[np.float64]:
    """AirSim's proj_mat (4, 4): columns north, east and down of the camera's frame, and one.

    The quotients by the fourth row are the picture's, from -1 to 1, of what is opposite: AirSim turns north into the
    south that Unreal's matrix takes for ahead (PIPCamera.cpp, getProjectionMatrix).
    """
    half = math.tan(math.radians(lens.fov_deg) / 2)
    across, up = max(1.0, lens.height / lens.width), max(1.0, lens.width / lens.height)
    matrix = np.zeros((4, 4))
    matrix[0, 1], matrix[1, 2] = across / half, -up / half
    matrix[2, 3], matrix[3, 0] = NEAR_CM, -1.0
    return matrix
