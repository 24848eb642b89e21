"""AirSim's detections: which of the objects that a client looks for a camera sees, and in which box of its picture.

Source: AirSim v1.8.1, DetectionComponent.cpp. An object is seen if a ray meets it at one of the points of its box.
"""

from __future__ import annotations

import fnmatch
from collections import defaultdict
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from uavaccel.sim.camera.mounted import Lens
from uavaccel.sim.poses import Pose
from uavaccel.sim.scene.bounds import LONGEST_NAME
from uavaccel.sim.scene.rays import cast
from uavaccel.sim.sensors.earth import geographic
from uavaccel.wire import types
from uavaccel.wire.arguments import Truthy, VehicleName
from uavaccel.wire.calls import CallContext, Calls, call
from uavaccel.wire.cameras import MountedAs
from uavaccel.wire.pictures import known_type

DEFAULT_RADIUS_M = 200.0
MOST_NAMES = 256  # that a camera looks for
INSIDE = 0.98  # of the way from a box's middle: rays to the very edge may pass it


@dataclass
class Filter:
    """What one camera looks for: names, with * and ?, within a radius."""

    patterns: list[str] = field(default_factory=list)
    radius_m: float = DEFAULT_RADIUS_M

    def matches(self, name: str) -> bool:
        return any(fnmatch.fnmatchcase(name.lower(), pattern.lower()) for pattern in self.patterns)


class DetectionApi(Calls, title="Objects"):
    def __init__(self, context: CallContext) -> None:
        super().__init__(context)
        self._filters: dict[tuple[str, bool, int, int], Filter] = defaultdict(Filter)

    @call("simAddDetectionFilterMeshName")
    def add_name(
        self,
        camera_name: object,
        image_type: int,
        mesh_name: object,
        vehicle: VehicleName = "",
        external: Truthy = False,
    ) -> None:
        found = self._filter(camera_name, image_type, vehicle, external)[1]
        name = str(mesh_name)
        if len(found.patterns) >= MOST_NAMES or len(name) > LONGEST_NAME:
            raise ValueError(f"there may be {MOST_NAMES} names of {LONGEST_NAME} characters, not more")
        if name not in found.patterns:
            found.patterns.append(name)

    @call("simSetDetectionFilterRadius")
    def set_radius(
        self,
        camera_name: object,
        image_type: int,
        radius_cm: float,
        vehicle: VehicleName = "",
        external: Truthy = False,
    ) -> None:
        self._filter(camera_name, image_type, vehicle, external)[1].radius_m = radius_cm / 100

    @call("simClearDetectionMeshNames")
    def clear(
        self, camera_name: object, image_type: int, vehicle: VehicleName = "", external: Truthy = False
    ) -> None:
        self._filter(camera_name, image_type, vehicle, external)[1].patterns.clear()

    @call("simGetDetections")
    def detections(
        self, camera_name: object, image_type: int, vehicle: VehicleName = "", external: Truthy = False
    ) -> list[dict[str, object]]:
        mounted, found = self._filter(camera_name, image_type, vehicle, external)
        kinematics = self.scenery.truth(vehicle)
        eye = mounted.eye(Pose(kinematics.position_m, kinematics.orientation_wxyz))
        names = [name for name in self.scenery.objects.names() if found.matches(name)]
        seen = (self._detection(name, eye, mounted.lens(image_type), found.radius_m) for name in names)
        return [one for one in seen if one is not None]

    def _filter(
        self, camera: object, image_type: int, vehicle: str, external: bool
    ) -> tuple[MountedAs, Filter]:
        mounted = self.scenery.cameras(vehicle, external).named(camera)
        kind = known_type(image_type)
        return mounted, self._filters[mounted.name, mounted.external, mounted.carrier, kind]

    def _detection(self, name: str, eye: Pose, lens: Lens, radius_m: float) -> dict[str, object] | None:
        objects = self.scenery.objects
        pose = objects.pose(name) or Pose()
        corners = objects.corners(name)
        if np.linalg.norm(np.array(pose.position_m) - eye.position_m) > radius_m:
            return None
        box = picture_box(eye.inwards(corners), lens)
        if box is None or not self._is_visible(name, corners, eye):
            return None
        (left, top), (right, bottom) = box
        inside = eye.inwards(corners)
        low, high = inside.min(axis=0).tolist(), inside.max(axis=0).tolist()
        return {
            "name": name,
            "geo_point": types.geo_map(geographic(pose.position_m, self.scenery.settings.home)),
            "box2D": {
                "min": {"x_val": left, "y_val": top},
                "max": {"x_val": right, "y_val": bottom},
            },
            "box3D": {"min": types.vector_map(low), "max": types.vector_map(high)},
            "relative_pose": types.pose_map(eye.inwards_pose(pose)),
        }

    def _is_visible(self, name: str, corners: NDArray[np.float64], eye: Pose) -> bool:
        world = self.simulation.world
        middle = corners.mean(axis=0)
        points = np.vstack(
            [middle, middle + INSIDE * (corners - middle), middle + INSIDE / 2 * (corners - middle)]
        )
        ways = points - np.array(eye.position_m)
        lengths = np.linalg.norm(ways, axis=1)
        far = lengths > 0
        hits = cast(world.model, world.data, eye.position_m, ways[far] / lengths[far, None])
        return bool((hits.geoms == self.scenery.objects.geom(name)).any())


def picture_box(corners: NDArray[np.float64], lens: Lens) -> tuple[list[float], list[float]] | None:
    """First and last pixel of a box, given by corners (8, 3) in the camera's frame; None out of the picture."""
    ahead = corners[corners[:, 0] > 1e-3]
    if not len(ahead):
        return None
    focal = lens.width / 2 / np.tan(np.radians(lens.fov_deg) / 2)
    size = np.array([lens.width, lens.height], float)
    pixels = size / 2 + focal * ahead[:, 1:] / ahead[:, :1]
    low, high = np.clip(pixels.min(axis=0), 0, size), np.clip(pixels.max(axis=0), 0, size)
    return None if (low >= high).any() else (low.tolist(), high.tolist())
