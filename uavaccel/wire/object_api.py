"""AirSim's calls about a scene's objects: found, moved, scaled, spawned, destroyed, given segmentation IDs.

Source: AirSim v1.8.1, WorldSimApi.cpp (returns and error texts).
"""

# ruff: noqa: N815  the names are AirSim's

from __future__ import annotations

import math

from uavaccel.sim.poses import Pose
from uavaccel.sim.scene.objects import ASSETS
from uavaccel.wire import types
from uavaccel.wire.arguments import AnyPose, FinitePose, ObjectName, Truthy, Vector3r, finite
from uavaccel.wire.calls import Calls, WithoutEffect, call
from uavaccel.wire.vehicles import put_at

NAN = math.nan
NO_POSE = Pose((NAN, NAN, NAN), (NAN, NAN, NAN, NAN))
NO_EDITOR = "there is no Unreal engine"


class ObjectApi(Calls, title="Objects"):
    """Poses are the world's."""

    @call("simListSceneObjects")
    def listed(self, name_regex: ObjectName = ".*") -> list[str]:
        """Objects and vehicles."""
        return self.scenery.named_like(name_regex)

    @call("simGetObjectPose")
    def pose(self, object_name: ObjectName, ned: object = True) -> dict[str, dict[str, float]]:
        """Of an object or a vehicle; not a number for what is not there. Always NED."""
        for vehicle in self.simulation.world.vehicles:
            if object_name == vehicle.name:
                return types.pose_map(vehicle.kinematics(in_world=True))
        return types.pose_map(self.scenery.objects.pose(object_name) or NO_POSE)

    @call("simSetObjectPose")
    def set_pose(self, object_name: ObjectName, pose: AnyPose, teleport: object = True) -> bool:
        """It is put there at once, whatever is on the way."""
        for pilot in self.simulation.pilots:
            if object_name == pilot.vehicle.name:
                local = pose._replace(position_m=pilot.vehicle.local(pose.position_m))
                self.simulation.world.teleport(pilot.vehicle, *put_at(pilot, local))
                return True
        if self.scenery.objects.geom(object_name) is None:
            return False  # as AirSim: its pose, not a number, may be what is set
        return self.scenery.objects.set_pose(object_name, finite(pose))

    @call("simGetObjectScale")
    def scale(self, object_name: ObjectName) -> dict[str, float]:
        """0 for what is not there."""
        return types.vector_map(self.scenery.objects.scale(object_name) or (0.0, 0.0, 0.0))

    @call("simSetObjectScale")
    def set_scale(self, object_name: ObjectName, scale_vector: Vector3r) -> bool:
        return self.scenery.objects.set_scale(object_name, scale_vector)

    @call("simSpawnObject")
    def spawn(
        self,
        object_name: ObjectName,
        asset_name: ObjectName,
        pose: FinitePose,
        scale: Vector3r,
        physics_enabled: Truthy = False,
        is_blueprint: object = False,
    ) -> str:
        """Returns the name that it has got."""
        name = self.scenery.objects.spawn(object_name, asset_name, pose, scale)
        self.scenery.segmentation.spawned(name)
        if physics_enabled:
            self.notices.once("simSpawnObject: physics_enabled is without effect; objects stand still")
        return name

    @call("simDestroyObject")
    def destroy(self, object_name: ObjectName) -> bool:
        return self.scenery.objects.destroy(object_name)

    @call("simListAssets")
    def assets(self) -> list[str]:
        return [*ASSETS]

    @call("simLoadLevel")
    def load_level(self, level_name: object) -> bool:
        """True for the scene that is there. Raises ValueError for another."""
        scene = self.simulation.world.scene
        if level_name != scene:
            raise ValueError(
                f"the scene is {scene!r} and stays; another is chosen as the simulation is started"
            )
        return True

    @call("simSetSegmentationObjectID")
    def set_segmentation_id(
        self, mesh_name: ObjectName, object_id: int, is_name_regex: Truthy = False
    ) -> bool:
        named = self.scenery.named_like(mesh_name) if is_name_regex else self.scenery.named(mesh_name)
        return self.scenery.segmentation.set_id(named, object_id)

    @call("simGetSegmentationObjectID")
    def segmentation_id(self, mesh_name: ObjectName) -> int:
        """-1 for what is not there."""
        return self.scenery.segmentation.id(self.scenery.named(mesh_name))

    simSwapTextures = WithoutEffect([])  # of the objects whose textures were swapped
    simSetObjectMaterial = WithoutEffect(refused=NO_EDITOR)
    simSetObjectMaterialFromTexture = WithoutEffect(refused=NO_EDITOR)
    simGetMeshPositionVertexBuffers = WithoutEffect(refused=NO_EDITOR)
    simCreateVoxelGrid = WithoutEffect(refused="a client does not write files on the server")
