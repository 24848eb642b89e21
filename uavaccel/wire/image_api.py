"""AirSim's calls about images, poses and collisions, and our own for a lane and for one bare picture.

Image, pose and time stamp belong to the same tick: a picture is of the moment at which the call is handled.
Sources: AirSim v1.8.1, ImageCaptureBase.hpp, RpcLibAdaptorsBase.hpp, WorldSimApi. Formats: airsim's clients expect
uncompressed images as blue, green, red bytes, compressed ones as PNG, float images as a row-major list.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavaccel.config import validate
from uavaccel.kinematics import Kinematics, Vector
from uavaccel.sim.camera.view import HEIGHT, WIDTH
from uavaccel.sim.lane.file import layout_from
from uavaccel.sim.lane.layout import Difficulty, LaneLayout, draw_layout
from uavaccel.sim.poses import Pose
from uavaccel.wire import types
from uavaccel.wire.cameras import SCENE, Cameras, MountedAs
from uavaccel.wire.image_files import png
from uavaccel.wire.notices import Notices
from uavaccel.wire.pictures import Scene, known_type
from uavaccel.wire.scenery import Scenery
from uavaccel.wire.steps import Steps

MOST_IMAGES = 64  # of one call
OPTICAL_FLOW = (8, 9)  # AirSim's types of image that are not drawn here
AT_ONCE = 4  # of more, each is drawn for itself, and the server looks after others between
PIXELS_AT_ONCE = 1 << 18  # and so of more pixels
PICTURES = ("gray", "colour", "depth", "segmentation")


class ImageRequest(NamedTuple):
    """What is asked for, by the name that the client gave the camera."""

    camera: MountedAs
    camera_name: str
    image_type: int
    pixels_as_float: bool
    compress: bool


class ImageApi:
    """The image calls of one simulation."""

    def __init__(self, scenery: Scenery, check_vehicle: Callable[[Any], None], notices: Notices) -> None:
        self.simulation = scenery.simulation
        self._scenery = scenery
        self._check_vehicle = check_vehicle
        self._notices = notices

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

    def get_images(self, requests: Any, vehicle: Any = "", external: Any = False) -> list[Any] | Steps:
        """simGetImages: all of one moment; what cannot be drawn is said in its response alone."""
        if not isinstance(requests, list) or len(requests) > MOST_IMAGES:
            raise ValueError(f"requests must be a list of at most {MOST_IMAGES} ImageRequest")
        cameras = self._cameras(vehicle, external)
        asked = [image_request(request, cameras) for request in requests]
        if len(asked) <= AT_ONCE and sum(map(_pixels, asked)) <= PIXELS_AT_ONCE:
            return [self._response(request, self._scenery.truth(vehicle)) for request in asked]
        scene, kinematics = self._scenery.pictures.kept(), self._scenery.truth(vehicle)
        return Steps(self._response(request, kinematics, scene) for request in asked)

    def get_image(self, camera: Any, image_type: Any, vehicle: Any = "", external: Any = False) -> bytes:
        """simGetImage: one PNG."""
        mounted = self._cameras(vehicle, external).named(camera)
        return png(self._scenery.pictures.bgr(mounted, types.whole(image_type, "image_type")))

    def _cameras(self, vehicle: Any, external: Any) -> Cameras:
        self._check_vehicle(vehicle)
        return self._scenery.cameras(vehicle, external)

    def _response(self, request: ImageRequest, kinematics: Kinematics, scene: Scene = None) -> dict[str, Any]:
        image, message = self._drawn(request, scene)
        as_float, compress = request.pixels_as_float, request.compress
        data = b"" if as_float or message else png(image) if compress else image.tobytes()
        eye = request.camera.eye(Pose(kinematics.position_m, kinematics.orientation_wxyz))
        return {
            "image_data_uint8": data,
            "image_data_float": image.ravel() if as_float else [],
            "camera_position": types.vector_map(self._local(request.camera, eye.position_m)),
            "camera_name": request.camera_name,
            "camera_orientation": types.quaternion_map(eye.orientation_wxyz),
            "time_stamp": types.stamp(kinematics.time_ns),
            "message": message,
            "pixels_as_float": as_float,
            "compress": compress,
            "width": image.shape[1],
            "height": image.shape[0],
            "image_type": request.image_type,
        }

    def _local(self, camera: MountedAs, place_m: Vector) -> Vector:
        return self.simulation.world.vehicles[camera.carrier].local(place_m)

    def _drawn(self, request: ImageRequest, scene: Scene) -> tuple[NDArray[Any], str]:
        """The picture; or an empty one, and why."""
        try:
            known_type(request.image_type)
        except ValueError as error:
            if request.image_type in OPTICAL_FLOW:
                self._notices.once("simGetImages: images of types 8 and 9 (optical flow) are empty")
            return np.empty((0, 0), np.float32), str(error)
        pictures = self._scenery.pictures
        draw = pictures.floats if request.pixels_as_float else pictures.bgr
        return draw(request.camera, request.image_type, scene), ""

    # --- lanes -------------------------------------------------------------------------------

    def set_lane(self, lane: Any) -> None:
        """Our own: lay out a lane, from a seed, {"seed": n, "difficulty": {...}}, or a mapping of obstacles."""
        layout, world = lane_layout(lane), self.simulation.world
        moves = layout.scenery != world.scenery
        world.set_lane(layout)
        if moves:  # what is kept of the model before
            self.simulation.frames.forget()
            self._scenery.forget()

    def collision(self) -> dict[str, Any]:
        """Our own: when, what and where the first touch was, simulated ns and NED; empty without one."""
        world = self.simulation.world
        touch = world.lead.touches.first
        if touch is None:
            return {}
        return {
            "time_ns": self.simulation.time_of(touch.tick),
            "object": touch.object,
            "position_m": list(world.lead.local(touch.position_m)),
        }


def _pixels(request: ImageRequest) -> int:
    lens = request.camera.lens(request.image_type)
    return lens.width * lens.height


def image_request(value: Any, cameras: Cameras) -> ImageRequest:
    """An ImageRequest of the wire, whose type need not be known. Raises ValueError."""
    if not isinstance(value, Mapping):
        raise ValueError("an ImageRequest must be a map")
    name = str(value.get("camera_name", ""))
    image_type = types.whole(value.get("image_type", SCENE), "image_type")
    as_float, compress = bool(value.get("pixels_as_float")), bool(value.get("compress", True))
    return ImageRequest(cameras.named(name), name, image_type, as_float, compress)


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
