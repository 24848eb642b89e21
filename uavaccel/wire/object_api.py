"""AirSim's calls about a scene's objects: found, moved, scaled, spawned, destroyed, given segmentation IDs, detected.

Sources: AirSim v1.8.1, WorldSimApi.cpp (returns and error texts), DetectionComponent.cpp.
"""

from __future__ import annotations

import math
from typing import Any

from uavaccel.sim.poses import Pose
from uavaccel.sim.scene.bounds import LONGEST_NAME
from uavaccel.sim.scene.objects import ASSETS
from uavaccel.wire import types
from uavaccel.wire.method import Method
from uavaccel.wire.notices import Notices
from uavaccel.wire.scenery import Scenery
from uavaccel.wire.sensor_api import pose_map
from uavaccel.wire.vehicle_api import VehicleApi

NAN = math.nan
NO_POSE = Pose((NAN, NAN, NAN), (NAN, NAN, NAN, NAN))


class ObjectApi:
    """The object calls of one simulation."""

    def __init__(self, scenery: Scenery, vehicles: VehicleApi, notices: Notices) -> None:
        self._scenery = scenery
        self._vehicles = vehicles
        self._notices = notices

    def methods(self) -> dict[str, Method]:
        """By wire name."""
        return {
            "simListSceneObjects": Method(self.listed, 0, 1),
            "simGetObjectPose": Method(self.pose, 1, 1),
            "simSetObjectPose": Method(self.set_pose, 2, 1),
            "simGetObjectScale": Method(self.scale, 1),
            "simSetObjectScale": Method(self.set_scale, 2),
            "simSpawnObject": Method(self.spawn, 4, 2),
            "simDestroyObject": Method(self.destroy, 1),
            "simListAssets": Method(self.assets, 0),
            "simSetSegmentationObjectID": Method(self.set_segmentation_id, 2, 1),
            "simGetSegmentationObjectID": Method(self.segmentation_id, 1),
        }

    def listed(self, pattern: Any = ".*") -> list[str]:
        """simListSceneObjects: objects and vehicles."""
        return self._scenery.named_like(_text(pattern, "name_regex"))

    def pose(self, name: Any, ned: Any = True) -> dict[str, Any]:
        """simGetObjectPose: of an object or a vehicle; not a number for what is not there. Always NED."""
        for vehicle in self._scenery.simulation.world.vehicles:
            if name == vehicle.name:
                return types.pose_map(vehicle.kinematics(in_world=True))
        return pose_map(self._scenery.objects.pose(_text(name, "object_name")) or NO_POSE)

    def set_pose(self, name: Any, pose: Any, teleport: Any = True) -> bool:
        """simSetObjectPose. It is put there at once, whatever is on the way."""
        if any(name == vehicle.name for vehicle in self._scenery.simulation.world.vehicles):
            self._vehicles.put(pose, name)
            return True
        if self._scenery.objects.geom(_text(name, "object_name")) is None:
            return False  # as AirSim: its pose, not a number, may be what is set
        return self._scenery.objects.set_pose(name, _finite(pose))

    def scale(self, name: Any) -> dict[str, float]:
        """simGetObjectScale: 0 for what is not there."""
        return types.vector_map(self._scenery.objects.scale(_text(name, "object_name")) or (0.0, 0.0, 0.0))

    def set_scale(self, name: Any, scale: Any) -> bool:
        """simSetObjectScale."""
        return self._scenery.objects.set_scale(
            _text(name, "object_name"), types.vector(scale, "scale_vector")
        )

    def spawn(
        self, name: Any, asset: Any, pose: Any, scale: Any, physics: Any = False, blueprint: Any = False
    ) -> str:
        """simSpawnObject: returns the name that it has got."""
        size = types.vector(scale, "scale")
        name = self._scenery.objects.spawn(
            _text(name, "object_name"), _text(asset, "asset_name"), _finite(pose), size
        )
        self._scenery.segmentation.spawned(name)
        if physics:
            self._notices.once("simSpawnObject: physics_enabled is without effect; objects stand still")
        return name

    def destroy(self, name: Any) -> bool:
        """simDestroyObject."""
        return self._scenery.objects.destroy(_text(name, "object_name"))

    def assets(self) -> list[str]:
        """simListAssets."""
        return [*ASSETS]

    def set_segmentation_id(self, name: Any, number: Any, is_regex: Any = False) -> bool:
        """simSetSegmentationObjectID."""
        number, name = types.whole(number, "object_id"), _text(name, "mesh_name")
        named = self._scenery.named_like(name) if is_regex else self._scenery.named(name)
        return self._scenery.segmentation.set_id(named, number)

    def segmentation_id(self, name: Any) -> int:
        """simGetSegmentationObjectID: -1 for what is not there."""
        return self._scenery.segmentation.id(self._scenery.named(_text(name, "mesh_name")))


def _text(value: Any, name: str) -> str:
    if not isinstance(value, str):
        raise ValueError(f"{name} must be a text, not {type(value).__name__}")
    if len(value) > LONGEST_NAME:
        raise ValueError(f"{name} must have at most {LONGEST_NAME} characters, not {len(value)}")
    return value


def _finite(value: Any) -> Pose:
    position, orientation = types.pose(value)
    if any(map(math.isnan, (*position, *orientation))):
        raise ValueError("pose must be finite")
    return Pose(position, orientation)
