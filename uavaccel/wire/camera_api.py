"""AirSim's calls about a vehicle's cameras: where they are, how wide they see, how they project.

Sources: AirSim v1.8.1, PIPCamera.cpp (projection, field of view, distortion), CommonStructs.hpp (CameraInfo).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavaccel.sim.camera.mounted import Lens
from uavaccel.sim.poses import Pose
from uavaccel.wire import types
from uavaccel.wire.cameras import NARROWEST_DEG, SCENE, WIDEST_DEG, MountedAs
from uavaccel.wire.method import Method
from uavaccel.wire.notices import Notices
from uavaccel.wire.scenery import Scenery

NEAR_CM = 10.0  # GNearClippingPlane


class CameraApi:
    """The camera calls of one simulation."""

    def __init__(self, scenery: Scenery, check_vehicle: Callable[[Any], None], notices: Notices) -> None:
        self._scenery = scenery
        self._check_vehicle = check_vehicle
        self._notices = notices

    def methods(self) -> dict[str, Method]:
        """By wire name."""
        return {
            "simGetCameraInfo": Method(self.info, 1, 2),
            "simSetCameraPose": Method(self.set_pose, 2, 2),
            "simSetCameraFov": Method(self.set_fov, 2, 2),
            "simGetDistortionParams": Method(self.distortion, 1, 2),
            "simSetDistortionParam": Method(self.set_distortion, 3, 2),
        }

    def _named(self, camera: Any, vehicle: Any, external: Any) -> MountedAs:
        self._check_vehicle(vehicle)
        return self._scenery.cameras(vehicle, external).named(camera)

    def info(self, camera: Any, vehicle: Any = "", external: Any = False) -> dict[str, Any]:
        """simGetCameraInfo: pose NED, degrees, and the projection of NED centimetres from the camera."""
        mounted = self._named(camera, vehicle, external)
        kinematics = self._scenery.truth(vehicle)
        eye = mounted.eye(Pose(kinematics.position_m, kinematics.orientation_wxyz))
        pose = {
            "position": types.vector_map(self._scenery.vehicle(vehicle).local(eye.position_m)),
            "orientation": types.quaternion_map(eye.orientation_wxyz),
        }
        lens = mounted.lens(SCENE)
        return {"pose": pose, "fov": lens.fov_deg, "proj_mat": {"matrix": projection(lens).tolist()}}

    def set_pose(self, camera: Any, pose: Any, vehicle: Any = "", external: Any = False) -> None:
        """simSetCameraPose: relative to the vehicle, FRD; NaN leaves a part as it is."""
        mounted = self._named(camera, vehicle, external)
        position, orientation = types.pose(pose)
        keep = [any(map(math.isnan, part)) for part in (position, orientation)]
        mounted.mount = Pose(
            mounted.mount.position_m if keep[0] else position,
            mounted.mount.orientation_wxyz if keep[1] else orientation,
        )

    def set_fov(self, camera: Any, degrees: Any, vehicle: Any = "", external: Any = False) -> None:
        """simSetCameraFov: from the left to the right edge, of all types of image."""
        mounted = self._named(camera, vehicle, external)
        fov_deg = types.number(degrees, "fov_degrees")
        if not NARROWEST_DEG <= fov_deg <= WIDEST_DEG:
            raise ValueError(f"fov_degrees must be {NARROWEST_DEG:g} to {WIDEST_DEG:g}, not {fov_deg:g}")
        mounted.set_fov(fov_deg)

    def distortion(self, camera: Any, vehicle: Any = "", external: Any = False) -> list[float]:
        """simGetDistortionParams: K1, K2, K3, P1, P2."""
        return list(self._named(camera, vehicle, external).distortion.values())

    def set_distortion(
        self, camera: Any, name: Any, value: Any, vehicle: Any = "", external: Any = False
    ) -> None:
        """simSetDistortionParam: kept and told; pictures stay undistorted."""
        known = self._named(camera, vehicle, external).distortion
        if not isinstance(name, str) or name not in known:
            raise ValueError(f"no distortion parameter {name!r}; there are {', '.join(known)}")
        known[name] = types.number(value, "value")
        self._notices.once("simSetDistortionParam: accepted; pictures stay undistorted")


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
