"""AirSim's calls about a scene: its objects, what cameras detect of them, environment, wind, lines of sight, weather.

Sources: AirSim v1.8.1, WorldSimApi.cpp (returns and error texts), DetectionComponent.cpp, Environment.hpp,
PawnSimApi.cpp. An object is detected if a ray from the camera meets it at one of the points of its bounding box.
"""

from __future__ import annotations

import fnmatch
import math
from collections import defaultdict
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from uavaccel.kinematics import Vector
from uavaccel.sim.camera.camera import Lens
from uavaccel.sim.earth import GRAVITY_M_S2, GeoPoint, atmosphere, geodetic, geographic, local
from uavaccel.sim.objects import ASSETS, cast, sees
from uavaccel.sim.poses import LONGEST_NAME, Pose
from uavaccel.sim.scene import QUADROTOR
from uavaccel.wire import types
from uavaccel.wire.calls import Calls, Scenery, call, without_effect
from uavaccel.wire.pictures import CameraMount, known_type
from uavaccel.wire.types import (
    AnyPose,
    FinitePose,
    ObjectName,
    Point,
    Truthy,
    Vector3r,
    VehicleName,
    coordinate,
    finite,
)
from uavaccel.wire.vehicle_api import in_world_frame

NAN = math.nan
NO_POSE = Pose((NAN, NAN, NAN), (NAN, NAN, NAN, NAN))
NO_EDITOR = "there is no Unreal engine"
DEFAULT_RADIUS_M = 200.0
MOST_NAMES = 256  # patterns per filter
INSIDE = 0.98  # of the way from a box's centre to its corners: rays to the very edge may miss it


class ObjectApi(Calls, title="Objects"):
    """Calls about objects; poses are in the world's frame."""

    @call("simListSceneObjects")
    def listed(self, name_regex: ObjectName = ".*") -> list[str]:
        return self.scenery.named_like(name_regex)

    @call("simGetObjectPose")
    def pose(self, object_name: ObjectName, ned: object = True) -> dict[str, dict[str, float]]:
        """Return the pose of an object or a vehicle, always NED; NaN if there is none of that name."""
        for vehicle in self.simulation.world.vehicles:
            if object_name == vehicle.name:
                return types.pose_map(vehicle.kinematics(in_world=True))
        return types.pose_map(self.scenery.objects.pose(object_name) or NO_POSE)

    @call("simSetObjectPose")
    def set_pose(self, object_name: ObjectName, pose: AnyPose, teleport: object = True) -> bool:
        """Teleport an object or a vehicle; returns whether there is one."""
        for pilot in self.simulation.pilots:
            if object_name == pilot.vehicle.name:
                local = pose._replace(position_m=pilot.vehicle.local(pose.position_m))
                self.simulation.world.teleport(pilot.vehicle, *in_world_frame(pilot, local))
                return True
        if self.scenery.objects.geom(object_name) is None:
            return False  # as in AirSim, even for a pose that is NaN
        return self.scenery.objects.set_pose(object_name, finite(pose))

    @call("simGetObjectScale")
    def scale(self, object_name: ObjectName) -> dict[str, float]:
        """Return the scale of an object, 1 of a vehicle; 0 if there is none of that name."""
        vehicles = [vehicle.name for vehicle in self.simulation.world.vehicles]
        alike = 1.0 if object_name in vehicles else 0.0
        return types.vector_map(self.scenery.objects.scale(object_name) or (alike, alike, alike))

    @call("simSetObjectScale")
    def set_scale(self, object_name: ObjectName, scale_vector: Vector3r) -> bool:
        return self.scenery.objects.set_scale(object_name, scale_vector)

    @call("simSpawnObject")
    def spawn(
        self, object_name: ObjectName, asset_name: ObjectName, pose: FinitePose, scale: Vector3r,
        physics_enabled: Truthy = False, is_blueprint: object = False,
    ) -> str:  # fmt: skip
        """Add an object, and return the name that it was given."""
        name = self.scenery.objects.spawn(object_name, asset_name, pose, scale)
        self.scenery.segmentation.spawned(name)
        if physics_enabled:
            self.scenery.say_once("simSpawnObject: physics_enabled is without effect; objects stand still")
        return name

    @call("simDestroyObject")
    def destroy(self, object_name: ObjectName) -> bool:
        return self.scenery.objects.destroy(object_name)

    @call("simListAssets")
    def assets(self) -> list[str]:
        return [*ASSETS]

    @call("simLoadLevel")
    def load_level(self, level_name: object) -> bool:
        """Return True for the present scene, in any case as in Unreal. Raises ValueError for any other."""
        scene = self.simulation.world.scene
        if str(level_name).lower() != scene.lower():
            raise ValueError(f"the scene is {scene!r} and stays; another is chosen as the simulation is started")
        return True

    @call("simSetSegmentationObjectID")
    def set_segmentation_id(self, mesh_name: ObjectName, object_id: int, is_name_regex: Truthy = False) -> bool:
        named = self.scenery.named_like(mesh_name) if is_name_regex else self.scenery.named(mesh_name)
        return self.scenery.segmentation.set_id(named, object_id)

    @call("simGetSegmentationObjectID")
    def segmentation_id(self, mesh_name: ObjectName) -> int:
        """Return the segmentation ID of an object; -1 if there is none of that name."""
        return self.scenery.segmentation.id(self.scenery.named(mesh_name))

    ignored = (
        *without_effect("simSwapTextures", answer=[]),
        *without_effect(
            *("simSetObjectMaterial", "simSetObjectMaterialFromTexture", "simGetMeshPositionVertexBuffers"),
            refused=NO_EDITOR,
        ),
        *without_effect("simCreateVoxelGrid", refused="a client does not write files on the server"),
    )


@dataclass
class DetectionFilter:
    """The objects that one camera detects: name patterns with * and ?, within a radius."""

    patterns: list[str] = field(default_factory=list)
    radius_m: float = DEFAULT_RADIUS_M


class DetectionApi(Calls, title="Objects"):
    def __init__(self, scenery: Scenery) -> None:
        super().__init__(scenery)
        self._filters: dict[tuple[str, bool, int, int], DetectionFilter] = defaultdict(DetectionFilter)

    @call("simAddDetectionFilterMeshName")
    def add_name(
        self, camera_name: object, image_type: int, mesh_name: object, vehicle: VehicleName = "",
        external: Truthy = False,
    ) -> None:  # fmt: skip
        found = self._filter(camera_name, image_type, vehicle, external)[1]
        name = str(mesh_name)
        if len(found.patterns) >= MOST_NAMES or len(name) > LONGEST_NAME:
            raise ValueError(f"there may be {MOST_NAMES} names of {LONGEST_NAME} characters, not more")
        if name not in found.patterns:
            found.patterns.append(name)

    @call("simSetDetectionFilterRadius")
    def set_radius(
        self, camera_name: object, image_type: int, radius_cm: float, vehicle: VehicleName = "",
        external: Truthy = False,
    ) -> None:  # fmt: skip
        self._filter(camera_name, image_type, vehicle, external)[1].radius_m = radius_cm / 100

    @call("simClearDetectionMeshNames")
    def clear(self, camera_name: object, image_type: int, vehicle: VehicleName = "", external: Truthy = False) -> None:
        self._filter(camera_name, image_type, vehicle, external)[1].patterns.clear()

    @call("simGetDetections")
    def detections(
        self, camera_name: object, image_type: int, vehicle: VehicleName = "", external: Truthy = False
    ) -> list[dict[str, object]]:
        mounted, found = self._filter(camera_name, image_type, vehicle, external)
        kinematics = self.scenery.truth(vehicle)
        eye = mounted.eye(Pose(kinematics.position_m, kinematics.orientation_wxyz))
        patterns = [pattern.lower() for pattern in found.patterns]
        names = [
            name
            for name in self.scenery.objects.names()
            if any(fnmatch.fnmatchcase(name.lower(), pattern) for pattern in patterns)
        ]
        seen = (self._detection(name, eye, mounted, image_type, found.radius_m) for name in names)
        return [one for one in seen if one is not None]

    def _filter(
        self, camera: object, image_type: int, vehicle: str, external: bool
    ) -> tuple[CameraMount, DetectionFilter]:
        mounted = self.scenery.cameras(vehicle, external).named(camera)
        kind = known_type(image_type)
        return mounted, self._filters[mounted.name, mounted.external, mounted.carrier, kind]

    def _detection(
        self, name: str, eye: Pose, camera: CameraMount, image_type: int, radius_m: float
    ) -> dict[str, object] | None:
        objects = self.scenery.objects
        pose, corners = objects.pose(name) or Pose(), objects.corners(name)
        inside = eye.inwards(corners)
        if np.linalg.norm(np.array(pose.position_m) - eye.position_m) > radius_m:
            return None
        box = picture_box(inside, camera.lens(image_type))
        if box is None or not self._is_visible(name, corners, eye, camera):
            return None
        (left, top), (right, bottom) = box
        low, high = inside.min(axis=0).tolist(), inside.max(axis=0).tolist()
        return {
            "name": name,
            "geo_point": types.geo_map(geographic(pose.position_m, self.scenery.settings.home)),
            "box2D": {"min": {"x_val": left, "y_val": top}, "max": {"x_val": right, "y_val": bottom}},
            "box3D": {"min": types.vector_map(low), "max": types.vector_map(high)},
            "relative_pose": types.pose_map(eye.inwards_pose(pose)),
        }

    def _is_visible(self, name: str, corners: NDArray[np.float64], eye: Pose, camera: CameraMount) -> bool:
        world, middle = self.simulation.world, corners.mean(axis=0)
        outwards = INSIDE * (corners - middle)
        points = np.vstack([middle, middle + outwards, middle + outwards / 2])
        ways = points - np.array(eye.position_m)
        lengths = np.linalg.norm(ways, axis=1)
        far = lengths > 0
        rays, carrier = ways[far] / lengths[far, None], camera.body(world.vehicles)
        hits = cast(world.model, world.data, eye.position_m, rays, exclude=carrier)
        return bool((hits.geoms == self.scenery.objects.geom(name)).any())


def picture_box(corners: NDArray[np.float64], lens: Lens) -> tuple[list[float], list[float]] | None:
    """Return the first and last pixel of a box with corners (8, 3) in the camera's frame; None if it is out of view."""
    ahead = corners[corners[:, 0] > 1e-3]
    if not len(ahead):
        return None
    focal = lens.width / 2 / np.tan(np.radians(lens.fov_deg) / 2)
    size = np.array([lens.width, lens.height], float)
    pixels = size / 2 + focal * ahead[:, 1:] / ahead[:, :1]
    low, high = np.clip(pixels.min(axis=0), 0, size), np.clip(pixels.max(axis=0), 0, size)
    return None if (low >= high).any() else (low.tolist(), high.tolist())


class WorldApi(Calls, title="World"):
    @call("simGetGroundTruthEnvironment")
    def environment(self, vehicle: VehicleName = "") -> dict[str, object]:
        """Return the environment at a vehicle, in SI units."""
        position, own = self.scenery.truth(vehicle).position_m, self.scenery.vehicle(vehicle)
        place = geodetic(position, self.scenery.settings.home, own.origin_m)
        air = atmosphere(place.altitude)
        return {
            "position": types.vector_map(own.local(position)),
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
    def set_wind(self, wind: Vector3r) -> None:
        """Set the wind in m/s NED, until it is set again."""
        self.simulation.world.set_wind(wind)

    @call("simTestLineOfSightToPoint")
    def has_line_of_sight_to(self, point: Point, vehicle: VehicleName = "") -> bool:
        """Return whether the line of sight from the vehicle to a point is free."""
        here_m, own = self.scenery.truth(vehicle).position_m, self.scenery.vehicle(vehicle).body
        return self._sees(here_m, self._local(point), own)

    @call("simTestLineOfSightBetweenPoints")
    def has_line_of_sight(self, point1: Point, point2: Point) -> bool:
        return self._sees(self._local(point1), self._local(point2), QUADROTOR)

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
        low, high = corners.min(axis=0).tolist(), corners.max(axis=0).tolist()
        extents = (low[0], low[1], high[2]), (high[0], high[1], low[2])
        return [types.geo_map(geographic(place, self.scenery.settings.home)) for place in extents]

    ignored = (
        *without_effect("simSetTimeOfDay", "simEnableWeather", "simSetWeatherParameter"),
        *without_effect("simSetLightIntensity", "simRunConsoleCommand", answer=True),
    )
