"""AirSim's calls about cameras and images, and our own for one raw image.

Image, pose and time stamp belong to the same tick: a picture is of the moment at which the call is handled.
Sources: AirSim v1.8.1, ImageCaptureBase.hpp, RpcLibAdaptorsBase.hpp, WorldSimApi. Formats: airsim's clients expect
uncompressed images as blue, green, red bytes, compressed ones as PNG, float images as a row-major list.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from uavaccel.config import Config, validate
from uavaccel.kinematics import Kinematics
from uavaccel.sim.camera.camera import Lens
from uavaccel.sim.camera.pixels import png
from uavaccel.sim.camera.view import HEIGHT, WIDTH, AnyImage
from uavaccel.sim.clutter import Clutter, ClutterLayout, sample_world
from uavaccel.sim.lane import Difficulty, LaneLayout, layout_from, sample_layout
from uavaccel.sim.poses import Pose
from uavaccel.wire import types
from uavaccel.wire.calls import Calls, Scenery, call, without_effect
from uavaccel.wire.pictures import NARROWEST_DEG, SCENE, WIDEST_DEG, CameraMount, Cameras, Pixels, known_type
from uavaccel.wire.rpc import MAX_ANSWER_BYTES, Received, bulk_bytes
from uavaccel.wire.types import AnyPose, Truthy, VehicleName, whole

NEAR_CM = 10.0  # GNearClippingPlane
NO_LENS = "cameras here are pinholes; simSetCameraFov sets what they see"
MOST_IMAGES = 64  # of one call
OPTICAL_FLOW = (8, 9)  # AirSim's types of image that are not available here
PICTURES = ("gray", "colour", "depth", "segmentation")


class CameraApi(Calls, title="Cameras and images"):
    @call("simGetCameraInfo")
    def info(self, camera_name: object, vehicle: VehicleName = "", external: Truthy = False) -> dict[str, object]:
        """Return the pose in NED, the field of view in degrees, and the projection of NED centimetres."""
        mounted = self._named(camera_name, vehicle, external)
        eye, lens = told_pose(mounted, self.scenery, self.scenery.truth(vehicle)), mounted.lens(SCENE)
        matrix = {"matrix": projection(lens).tolist()}
        return {"pose": types.pose_map(eye), "fov": lens.fov_deg, "proj_mat": matrix}

    @call("simSetCameraPose")
    def set_pose(self, camera_name: object, pose: AnyPose, vehicle: VehicleName = "", external: Truthy = False) -> None:
        """Set the pose relative to the vehicle, FRD; parts that are NaN stay as they are."""
        mounted = self._named(camera_name, vehicle, external)
        position, orientation = pose
        before = mounted.mount
        mounted.mount = Pose(
            before.position_m if any(map(math.isnan, position)) else position,
            before.orientation_wxyz if any(map(math.isnan, orientation)) else orientation,
        )

    @call("simSetCameraFov")
    def set_fov(
        self, camera_name: object, fov_degrees: float, vehicle: VehicleName = "", external: Truthy = False
    ) -> None:
        mounted = self._named(camera_name, vehicle, external)
        if not NARROWEST_DEG <= fov_degrees <= WIDEST_DEG:
            raise ValueError(f"fov_degrees must be {NARROWEST_DEG:g} to {WIDEST_DEG:g}, not {fov_degrees:g}")
        mounted.set_fov(fov_degrees)

    @call("simGetDistortionParams")
    def distortion(self, camera_name: object, vehicle: VehicleName = "", external: Truthy = False) -> list[float]:
        """Return K1, K2, K3, P1, P2."""
        return list(self._named(camera_name, vehicle, external).distortion.values())

    @call("simSetDistortionParam")
    def set_distortion(
        self, camera_name: object, param_name: object, value: float, vehicle: VehicleName = "",
        external: Truthy = False,
    ) -> None:  # fmt: skip
        """Keep a parameter, which can be read again; pictures stay undistorted."""
        known = self._named(camera_name, vehicle, external).distortion
        if not isinstance(param_name, str) or param_name not in known:
            raise ValueError(f"no distortion parameter {param_name!r}; there are {', '.join(known)}")
        known[param_name] = value
        self.scenery.say_once("simSetDistortionParam: accepted; pictures stay undistorted")

    def _named(self, camera: object, vehicle: str, external: bool) -> CameraMount:
        return self.scenery.cameras(vehicle, external).named(camera)

    ignored = (
        *without_effect(
            *("simGetPresetLensSettings", "simGetLensSettings", "simSetPresetLensSettings"),
            *("simGetPresetFilmbackSettings", "simSetPresetFilmbackSettings", "simGetFilmbackSettings"),
            *("simSetFilmbackSettings", "simGetFocalLength", "simSetFocalLength", "simEnableManualFocus"),
            *("simGetFocusDistance", "simSetFocusDistance", "simGetFocusAperture", "simSetFocusAperture"),
            *("simEnableFocusPlane", "simGetCurrentFieldOfView"),
            refused=NO_LENS,
        ),
    )


def told_pose(camera: CameraMount, scenery: Scenery, vehicle: Kinematics) -> Pose:
    """Return a camera's pose in its carrier's frame or, of an external one, NED from the player's start."""
    eye = camera.eye(Pose(vehicle.position_m, vehicle.orientation_wxyz))
    if camera.external:
        return eye
    return eye._replace(position_m=scenery.simulation.world.vehicles[camera.carrier].local(eye.position_m))


def projection(lens: Lens) -> NDArray[np.float64]:
    """AirSim's proj_mat (4, 4), for homogeneous north, east, down in the camera's frame.

    Divided by the fourth row they give picture coordinates from -1 to 1, of the point on the opposite side: AirSim
    turns north into the south that Unreal's matrix takes for ahead (PIPCamera.cpp, getProjectionMatrix).
    """
    half = math.tan(math.radians(lens.fov_deg) / 2)
    across, up = max(1.0, lens.height / lens.width), max(1.0, lens.width / lens.height)
    matrix = np.zeros((4, 4))
    matrix[0, 1], matrix[1, 2] = across / half, -up / half
    matrix[2, 3], matrix[3, 0] = NEAR_CM, -1.0
    return matrix


class ImageRequest(NamedTuple):
    """One requested image; `camera_name` is the client's name for the camera. The type of image is not checked."""

    camera: CameraMount
    camera_name: str
    image_type: int
    pixels_as_float: bool
    compress: bool


class ImageApi(Calls, title="Cameras and images"):
    @call("uavaccelImage", "image", leaves_state=True)
    def raw_image(self, kind: object, width: int = WIDTH, height: int = HEIGHT) -> dict[str, object]:
        """Return the present picture, by default of AirSim's size, as bytes, with its shape and NumPy type.

        Gray, segmentation and depth have the shape (H, W), colour (H, W, 3).
        """
        if kind not in PICTURES:
            raise ValueError(f"no picture {str(kind)!r}; there are {', '.join(PICTURES)}")
        if not self.scenery.render:
            raise ValueError("rendering is switched off")
        if not (16 <= width <= WIDTH and 16 <= height <= WIDTH):
            raise ValueError(f"width and height must be 16 to {WIDTH}, not {width} and {height}")
        camera, world = self.simulation.world.camera(width, height), self.simulation.world
        image: AnyImage = getattr(camera, str(kind))(self.simulation.frames.scene(world.data))
        return {"shape": list(image.shape), "dtype": image.dtype.str, "data": image.tobytes()}

    @call("simGetImages", "image")
    def get_images(
        self, requests: object, vehicle: VehicleName = "", external: Truthy = False
    ) -> list[dict[str, object]]:
        """Return images of one moment; the response of one that cannot be drawn says why."""
        if not isinstance(requests, list) or len(requests) > MOST_IMAGES:
            raise ValueError(f"requests must be a list of at most {MOST_IMAGES} ImageRequest")
        cameras = self.scenery.cameras(vehicle, external)
        kinematics, room_bytes, responses = self.scenery.truth(vehicle), MAX_ANSWER_BYTES, []
        for request in [image_request(request, cameras) for request in requests]:
            responses.append(self._response(request, kinematics))
            room_bytes -= bulk_bytes(responses[-1])
            if room_bytes < 0:
                raise ValueError(f"the answer would have more than {MAX_ANSWER_BYTES >> 20} MiB: ask for less at once")
        return responses

    @call("simGetImage", "image")
    def get_image(
        self, camera_name: object, image_type: int, vehicle: VehicleName = "", external: Truthy = False
    ) -> bytes:
        mounted = self.scenery.cameras(vehicle, external).named(camera_name)
        return png(self.scenery.pictures.rgb(mounted, image_type))

    def _response(self, request: ImageRequest, kinematics: Kinematics) -> dict[str, object]:
        camera, name, image_type, as_float, compress = request
        image: Pixels
        image, message, pictures = np.empty((0, 0), np.float32), "", self.scenery.pictures
        try:
            known_type(image_type)
        except ValueError as error:
            message = str(error)
            if image_type in OPTICAL_FLOW:
                self.scenery.say_once("simGetImages: images of types 8 and 9 (optical flow) are empty")
        else:
            image = (pictures.floats if as_float else pictures.rgb)(camera, image_type)
        eye = told_pose(camera, self.scenery, kinematics)
        data = b"" if as_float or message else png(image) if compress else image[..., ::-1].tobytes()
        return {
            "image_data_uint8": data,
            "image_data_float": image.ravel() if as_float else [],
            "camera_position": types.vector_map(eye.position_m),
            "camera_name": name,
            "camera_orientation": types.quaternion_map(eye.orientation_wxyz),
            "time_stamp": types.stamp(kinematics.time_ns),
            "message": message,
            "pixels_as_float": as_float,
            "compress": compress,
            "width": image.shape[1],
            "height": image.shape[0],
            "image_type": image_type,
        }


def image_request(value: object, cameras: Cameras) -> ImageRequest:
    """Return the wire's ImageRequest; its type of image is not checked. Raises ValueError."""
    if not isinstance(value, Mapping):
        raise ValueError("an ImageRequest must be a map")
    name = str(value.get("camera_name", ""))
    image_type = whole(value.get("image_type", SCENE), "image_type")
    as_float, compress = bool(value.get("pixels_as_float")), bool(value.get("compress", True))
    return ImageRequest(cameras.named(name), name, image_type, as_float, compress)


def lane_layout(lane: object) -> LaneLayout:
    """Return the lane layout for a seed, a seed with a difficulty, or a mapping of obstacles. Raises UserError."""
    if isinstance(lane, Mapping) and "seed" not in lane:
        return layout_from(lane, "lane")
    seed = lane["seed"] if isinstance(lane, Mapping) else lane
    if isinstance(seed, bool) or not isinstance(seed, int):
        raise ValueError("a lane is a seed, {seed, difficulty}, or a mapping of obstacles")
    difficulty = lane.get("difficulty") if isinstance(lane, Mapping) else None
    return sample_layout(seed, validate(Difficulty, difficulty or {}, "difficulty"))


class ClutterWorld(Config):
    """A world of clutter on the wire."""

    clutter: Clutter
    """The distribution it is sampled from."""
    seed: Annotated[int, Field(ge=0, lt=1 << 63)]
    goal_m: tuple[float, float, float]
    """The goal, NED, around which it is clear."""


def clutter_layout(world: Mapping[str, object]) -> ClutterLayout:
    """Return the layout of {"clutter": {...}, "seed": n, "goal_m": [north, east, down]}. Raises UserError."""
    asked = validate(ClutterWorld, world, "clutter")
    return sample_world(asked.seed, asked.clutter, asked.goal_m)


def decode_image(reply: Received) -> AnyImage:
    image: AnyImage = np.frombuffer(reply["data"], reply["dtype"]).reshape(reply["shape"])
    return image
