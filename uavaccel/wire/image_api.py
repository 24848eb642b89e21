"""AirSim's calls about images, poses and collisions, and our own for a lane and for one bare picture.

Image, pose and time stamp belong to the same tick: a picture is of the moment at which the call is handled.
Sources: AirSim v1.8.1, ImageCaptureBase.hpp, RpcLibAdaptorsBase.hpp, WorldSimApi. Formats: airsim's clients expect
uncompressed images as blue, green, red bytes, compressed ones as PNG, float images as a row-major list.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavaccel.config import validate
from uavaccel.sim.lane.file import layout_from
from uavaccel.sim.lane.layout import Difficulty, LaneLayout, draw_layout
from uavaccel.sim.poses import Pose
from uavaccel.sim.view import HEIGHT, WIDTH
from uavaccel.wire import types
from uavaccel.wire.cameras import SCENE, Cameras, MountedAs
from uavaccel.wire.image_files import png
from uavaccel.wire.pictures import known_type
from uavaccel.wire.scenery import Scenery

MOST_IMAGES = 64  # of one call, while which the clock is not served
PICTURES = ("gray", "colour", "depth", "segmentation")


class ImageApi:
    """The image calls of one simulation."""

    def __init__(self, scenery: Scenery, check_vehicle: Callable[[Any], None]) -> None:
        self.simulation = scenery.simulation
        self._scenery = scenery
        self._check_vehicle = check_vehicle

    # --- images -----------------------------------------------------------------------------------------------

    def picture(self, kind: str) -> NDArray[Any]:
        """One picture of this moment at AirSim's default size: gray or segmentation (H, W), colour (H, W, 3), depth."""
        if kind not in PICTURES:
            raise ValueError(f"no picture {kind!r}; there are {', '.join(PICTURES)}")
        if not self._scenery.render:
            raise ValueError("rendering is switched off")
        camera = self.simulation.world.camera(WIDTH, HEIGHT)
        image: NDArray[Any] = getattr(camera, kind)(self.simulation.frames.scene(self.simulation.world.data))
        return image

    def raw_image(self, kind: Any) -> dict[str, Any]:
        """Our own: one picture as bytes, with its shape and NumPy type."""
        image = self.picture(str(kind))
        return {"shape": list(image.shape), "dtype": image.dtype.str, "data": image.tobytes()}

    def get_images(self, requests: Any, vehicle: Any = "", external: Any = False) -> list[dict[str, Any]]:
        """simGetImages: all of one moment; what cannot be drawn is said in its response alone."""
        if not isinstance(requests, list) or len(requests) > MOST_IMAGES:
            raise ValueError(f"requests must be a list of at most {MOST_IMAGES} ImageRequest")
        cameras = self._cameras(vehicle, external)
        return [self._response(cameras, request) for request in requests]

    def get_image(self, camera: Any, image_type: Any, vehicle: Any = "", external: Any = False) -> bytes:
        """simGetImage: one PNG."""
        mounted = self._cameras(vehicle, external).named(camera)
        return png(self._scenery.pictures.bgr(mounted, types.whole(image_type, "image_type")))

    def _cameras(self, vehicle: Any, external: Any) -> Cameras:
        self._check_vehicle(vehicle)
        return self._scenery.cameras(vehicle, external)

    def _response(self, cameras: Cameras, request: Any) -> dict[str, Any]:
        if not isinstance(request, Mapping):
            raise ValueError("an ImageRequest must be a map")
        camera = cameras.named(request.get("camera_name", ""))
        image_type = types.whole(request.get("image_type", SCENE), "image_type")
        as_float, compress = bool(request.get("pixels_as_float")), bool(request.get("compress", True))
        image, message = self._drawn(camera, image_type, as_float)
        kinematics = self.simulation.kinematics()
        eye = camera.eye(Pose(kinematics.position_m, kinematics.orientation_wxyz))
        return {
            "image_data_uint8": b""
            if as_float
            else png(image)
            if compress and not message
            else image.tobytes(),
            "image_data_float": image.ravel() if as_float else [],
            "camera_position": types.vector_map(eye.position_m),
            "camera_name": str(request.get("camera_name", "")),
            "camera_orientation": types.quaternion_map(eye.orientation_wxyz),
            "time_stamp": types.stamp(kinematics.time_ns),
            "message": message,
            "pixels_as_float": as_float,
            "compress": compress,
            "width": image.shape[1],
            "height": image.shape[0],
            "image_type": image_type,
        }

    def _drawn(self, camera: MountedAs, image_type: int, as_float: bool) -> tuple[NDArray[Any], str]:
        """The picture; or an empty one, and why."""
        try:
            known_type(image_type)
        except ValueError as error:
            return np.empty((0, 0), np.float32), str(error)
        pictures = self._scenery.pictures
        return (pictures.floats if as_float else pictures.bgr)(camera, image_type), ""

    # --- poses, collisions, lanes -------------------------------------------------------------------------------

    def vehicle_pose(self, vehicle: Any = "") -> dict[str, Any]:
        """simGetVehiclePose; ours is of the same tick as everything else."""
        self._check_vehicle(vehicle)
        return types.pose_map(self.simulation.kinematics())

    def set_vehicle_pose(self, pose: Any, ignore_collision: Any, vehicle: Any = "") -> None:
        """simSetVehiclePose: at rest in a new pose; NaN leaves a part as it is."""
        self._check_vehicle(vehicle)
        position, orientation = types.pose(pose)
        now = self.simulation.kinematics()
        keep = [math.isnan(sum(position)), math.isnan(sum(orientation))]
        self.simulation.world.place(
            now.position_m if keep[0] else position, now.orientation_wxyz if keep[1] else orientation
        )

    def collision_info(self, vehicle: Any = "") -> dict[str, Any]:
        """simGetCollisionInfo; reading it sets has_collided back, as in AirSim."""
        self._check_vehicle(vehicle)
        touches = self.simulation.world.touches
        info = types.no_collision_map() | {"has_collided": touches.read(), "collision_count": touches.count}
        if touch := touches.latest:
            info |= {"time_stamp": types.stamp(self.simulation.time_of(touch.tick))}
            info |= {"object_name": self._scenery.objects.name_of(touch.object)}
            info |= {"penetration_depth": touch.penetration_m, "normal": types.vector_map(touch.normal)}
            info |= {"position": types.vector_map(touch.position_m)}
            info |= {"impact_point": types.vector_map(touch.impact_point_m)}
        return info

    def set_lane(self, lane: Any) -> None:
        """Our own: lay out a lane, from a seed, {"seed": n, "difficulty": {...}}, or a mapping of obstacles."""
        self.simulation.world.set_lane(lane_layout(lane))

    def collision(self) -> dict[str, Any]:
        """Our own: tick in simulated ns, object and north position of the latched collision; empty without one."""
        world = self.simulation.world
        if world.collision_tick is None:
            return {}
        return {
            "time_ns": self.simulation.time_of(world.collision_tick),
            "object": world.collision_object,
            "position_m": list(self.simulation.kinematics().position_m),
        }


def lane_layout(lane: Any) -> LaneLayout:
    """The layout that a seed, a seed with a difficulty, or a mapping of obstacles stands for. Raises UserError."""
    if isinstance(lane, Mapping) and "seed" not in lane:
        return layout_from(lane, "lane")
    seed = lane["seed"] if isinstance(lane, Mapping) else lane
    if isinstance(seed, bool) or not isinstance(seed, int):
        raise ValueError("a lane is a seed, {seed, difficulty}, or a mapping of obstacles")
    difficulty = lane.get("difficulty") if isinstance(lane, Mapping) else None
    return draw_layout(seed, validate(Difficulty, difficulty or {}, "difficulty"))


def decode_image(reply: Mapping[str, Any]) -> NDArray[Any]:
    """The picture in a `raw_image` reply."""
    return np.frombuffer(reply["data"], reply["dtype"]).reshape(reply["shape"])
