"""AirSim's calls about images, and our own for one bare picture.

Image, pose and time stamp belong to the same tick: a picture is of the moment at which the call is handled.
Sources: AirSim v1.8.1, ImageCaptureBase.hpp, RpcLibAdaptorsBase.hpp, WorldSimApi. Formats: airsim's clients expect
uncompressed images as blue, green, red bytes, compressed ones as PNG, float images as a row-major list.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, NamedTuple

import numpy as np

from uavaccel.config import validate
from uavaccel.kinematics import Kinematics, Vector
from uavaccel.sim.camera.view import HEIGHT, WIDTH, AnyImage
from uavaccel.sim.lane.file import layout_from
from uavaccel.sim.lane.layout import Difficulty, LaneLayout, draw_layout
from uavaccel.sim.poses import Pose
from uavaccel.wire import types
from uavaccel.wire.arguments import Truthy, VehicleName, whole
from uavaccel.wire.calls import Calls, PartialResult, call
from uavaccel.wire.cameras import SCENE, Cameras, MountedAs
from uavaccel.wire.image_files import Pixels, png
from uavaccel.wire.pictures import Scene, known_type
from uavaccel.wire.rpc import Received

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


def image_requests(value: object, name: str) -> list[object]:
    """A list that is not too long."""
    if not isinstance(value, list) or len(value) > MOST_IMAGES:
        raise ValueError(f"{name} must be a list of at most {MOST_IMAGES} ImageRequest")
    return value


class ImageApi(Calls, title="Cameras and images"):
    @call("uavaccelImage", "image", leaves_state=True)
    def raw_image(self, kind: object) -> dict[str, object]:
        """One picture of this moment at AirSim's default size, as bytes, with its shape and NumPy type.

        Gray or segmentation (H, W), colour (H, W, 3), or depth.
        """
        if kind not in PICTURES:
            raise ValueError(f"no picture {str(kind)!r}; there are {', '.join(PICTURES)}")
        if not self.scenery.render:
            raise ValueError("rendering is switched off")
        camera, world = self.simulation.world.camera(WIDTH, HEIGHT), self.simulation.world
        image: AnyImage = getattr(camera, str(kind))(self.simulation.frames.scene(world.data))
        return {"shape": list(image.shape), "dtype": image.dtype.str, "data": image.tobytes()}

    @call("simGetImages", "image")
    def get_images(
        self,
        requests: Annotated[list[object], image_requests],
        vehicle: VehicleName = "",
        external: Truthy = False,
    ) -> list[dict[str, object]] | PartialResult:
        """All of one moment; what cannot be drawn is said in its response alone."""
        cameras = self.scenery.cameras(vehicle, external)
        asked = [image_request(request, cameras) for request in requests]
        if len(asked) <= AT_ONCE and sum(map(_pixels, asked)) <= PIXELS_AT_ONCE:
            return [self._response(request, self.scenery.truth(vehicle)) for request in asked]
        scene, kinematics = self.scenery.pictures.kept(), self.scenery.truth(vehicle)
        return PartialResult(self._response(request, kinematics, scene) for request in asked)

    @call("simGetImage", "image")
    def get_image(
        self, camera_name: object, image_type: int, vehicle: VehicleName = "", external: Truthy = False
    ) -> bytes:
        """One PNG."""
        mounted = self.scenery.cameras(vehicle, external).named(camera_name)
        return png(self.scenery.pictures.bgr(mounted, image_type))

    def _response(
        self, request: ImageRequest, kinematics: Kinematics, scene: Scene = None
    ) -> dict[str, object]:
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

    def _drawn(self, request: ImageRequest, scene: Scene) -> tuple[Pixels, str]:
        """The picture; or an empty one, and why."""
        try:
            known_type(request.image_type)
        except ValueError as error:
            if request.image_type in OPTICAL_FLOW:
                self.notices.once("simGetImages: images of types 8 and 9 (optical flow) are empty")
            return np.empty((0, 0), np.float32), str(error)
        pictures = self.scenery.pictures
        draw = pictures.floats if request.pixels_as_float else pictures.bgr
        return draw(request.camera, request.image_type, scene), ""


def _pixels(request: ImageRequest) -> int:
    lens = request.camera.lens(request.image_type)
    return lens.width * lens.height


def image_request(value: object, cameras: Cameras) -> ImageRequest:
    """An ImageRequest of the wire, whose type need not be known. Raises ValueError."""
    if not isinstance(value, Mapping):
        raise ValueError("an ImageRequest must be a map")
    name = str(value.get("camera_name", ""))
    image_type = whole(value.get("image_type", SCENE), "image_type")
    as_float, compress = bool(value.get("pixels_as_float")), bool(value.get("compress", True))
    return ImageRequest(cameras.named(name), name, image_type, as_float, compress)


def lane_layout(lane: object) -> LaneLayout:
    """The layout that a seed, a seed with a difficulty, or a mapping of obstacles stands for. Raises UserError."""
    if isinstance(lane, Mapping) and "seed" not in lane:
        return layout_from(lane, "lane")
    seed = lane["seed"] if isinstance(lane, Mapping) else lane
    if isinstance(seed, bool) or not isinstance(seed, int):
        raise ValueError("a lane is a seed, {seed, difficulty}, or a mapping of obstacles")
    difficulty = lane.get("difficulty") if isinstance(lane, Mapping) else None
    return draw_layout(seed, validate(Difficulty, difficulty or {}, "difficulty"))


def decode_image(reply: Received) -> AnyImage:
    """The picture in a `raw_image` reply."""
    image: AnyImage = np.frombuffer(reply["data"], reply["dtype"]).reshape(reply["shape"])
    return image
