"""AirSim's calls about images, poses and collisions, and our own for a lane and for one bare picture.

Image, pose and time stamp belong to the same tick: a picture is of the moment at which the call is handled.
Sources: AirSim v1.8.1, ImageCaptureBase.hpp, RpcLibAdaptorsBase.hpp, WorldSimApi. Formats: airsim's clients expect
uncompressed images as blue, green, red bytes, compressed ones as PNG, float images as a row-major list.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import cv2
import mujoco
import numpy as np
from numpy.typing import NDArray

from uavaccel.config import validate
from uavaccel.kinematics import Kinematics, Vector
from uavaccel.sim.lane.file import layout_from
from uavaccel.sim.lane.layout import Difficulty, LaneLayout, draw_layout
from uavaccel.sim.quadrotor import body_to_world
from uavaccel.sim.simulation import Simulation
from uavaccel.wire import types

WIDTH, HEIGHT, FOV_DEG = 256, 144, 90.0
CAMERA_MOUNT_M = (0.46, 0.0, 0.0)  # FRD, BP_FlyingPawn's front_center
FRONT_CAMERAS = ("0", "front_center", "", "fpv")
DEPTH_VIS_FAR_M = 100.0
MOST_IMAGES = 64  # of one call, while which the clock is not served

SCENE, DEPTH_PLANAR, DEPTH_PERSPECTIVE, DEPTH_VIS, SEGMENTATION = 0, 1, 2, 3, 5
PICTURES = ("gray", "colour", "depth", "segmentation")

# Colours of segmentation ids, AirSim's way: fixed, far apart, id 0 black.
_PALETTE = np.random.default_rng(5).permutation(np.arange(1, 1 << 12))[:255]
PALETTE = np.vstack([[0, 0, 0], np.stack([_PALETTE >> 8, (_PALETTE >> 4) & 15, _PALETTE & 15], axis=1) * 17])


class ImageApi:
    """The image calls of one simulation. `render` False refuses them all, and costs nothing."""

    def __init__(self, simulation: Simulation, render: bool = True) -> None:
        self.simulation = simulation
        self.render = render

    # --- images -----------------------------------------------------------------------------------------------

    def picture(self, kind: str) -> NDArray[Any]:
        """One picture of this moment at AirSim's default size: gray or segmentation (H, W), colour (H, W, 3), depth."""
        if kind not in PICTURES:
            raise ValueError(f"no picture {kind!r}; there are {', '.join(PICTURES)}")
        return self._draw(kind)

    def _draw(self, kind: str) -> NDArray[Any]:
        """The picture that a method of `Camera` draws. Raises ValueError where rendering is switched off."""
        if not self.render:
            raise ValueError("rendering is switched off")
        camera = self.simulation.world.camera(WIDTH, HEIGHT)
        image: NDArray[Any] = getattr(camera, kind)(self._shown())
        return image

    def _shown(self) -> mujoco.MjData:
        """What there is to see: the present, or what a modelled renderer shows."""
        return self.simulation.frames.scene(self.simulation.world.data)

    def raw_image(self, kind: Any) -> dict[str, Any]:
        """Our own: one picture as bytes, with its shape and NumPy type."""
        image = self.picture(str(kind))
        return {"shape": list(image.shape), "dtype": image.dtype.str, "data": image.tobytes()}

    def get_images(self, requests: Any, vehicle: Any = "", external: Any = False) -> list[dict[str, Any]]:
        """simGetImages."""
        if not isinstance(requests, list) or len(requests) > MOST_IMAGES:
            raise ValueError(f"requests must be a list of at most {MOST_IMAGES} ImageRequest")
        return [self._response(request) for request in requests]

    def get_image(self, camera: Any, image_type: Any, vehicle: Any = "", external: Any = False) -> bytes:
        """simGetImage: one PNG."""
        self._check_camera(camera)
        return _png(self._bgr(int(types.number(image_type, "image_type"))))

    def _response(self, request: Any) -> dict[str, Any]:
        if not isinstance(request, Mapping):
            raise ValueError("an ImageRequest must be a map")
        self._check_camera(request.get("camera_name", ""))
        image_type = int(types.number(request.get("image_type", SCENE), "image_type"))
        as_float, compress = bool(request.get("pixels_as_float")), bool(request.get("compress", True))
        data: bytes = b""
        floats: list[float] = []
        if as_float:
            floats = self._floats(image_type).ravel().tolist()
        else:
            image = self._bgr(image_type)
            data = _png(image) if compress else image.tobytes()
        kinematics = self.simulation.kinematics()
        return {
            "image_data_uint8": data,
            "image_data_float": floats,
            "camera_position": types.vector_map(camera_position(kinematics)),
            "camera_name": str(request.get("camera_name", "")),
            "camera_orientation": types.quaternion_map(kinematics.orientation_wxyz),
            "time_stamp": kinematics.time_ns,
            "message": "",
            "pixels_as_float": as_float,
            "compress": compress,
            "width": WIDTH,
            "height": HEIGHT,
            "image_type": image_type,
        }

    def _floats(self, image_type: int) -> NDArray[np.float32]:
        if image_type == DEPTH_PLANAR:
            return self._draw("depth")
        if image_type == DEPTH_PERSPECTIVE:
            return self._draw("depth_perspective")
        if image_type == DEPTH_VIS:
            return np.clip(self._draw("depth") / DEPTH_VIS_FAR_M, 0, 1)
        # AirSim gives the first channel of any other image
        return (self._bgr(image_type)[..., 2] / np.float32(255)).astype(np.float32)

    def _bgr(self, image_type: int) -> NDArray[np.uint8]:
        if image_type == SCENE:
            return np.ascontiguousarray(self.picture("colour")[..., ::-1])
        if image_type == SEGMENTATION:
            colours = PALETTE[(self.picture("segmentation") + 1) % len(PALETTE)]
            return np.ascontiguousarray(colours[..., ::-1].astype(np.uint8))
        if image_type in (DEPTH_PLANAR, DEPTH_PERSPECTIVE, DEPTH_VIS):
            kind = "depth_perspective" if image_type == DEPTH_PERSPECTIVE else "depth"
            share = np.clip(self._draw(kind) / DEPTH_VIS_FAR_M, 0, 1)
            return np.repeat(np.rint(share * 255).astype(np.uint8)[..., None], 3, axis=2)
        raise ValueError(
            f"image type {image_type} is not available; there are 0 scene, 1 2 3 depth, 5 segmentation"
        )

    def camera_info(self, camera: Any, vehicle: Any = "", external: Any = False) -> dict[str, Any]:
        """simGetCameraInfo."""
        self._check_camera(camera)
        kinematics = self.simulation.kinematics()
        half = math.tan(math.radians(FOV_DEG) / 2)
        matrix = np.zeros((4, 4))
        matrix[0, 0], matrix[1, 1], matrix[2, 3], matrix[3, 2] = 1 / half, WIDTH / HEIGHT / half, 10.0, 1.0
        pose = {
            "position": types.vector_map(camera_position(kinematics)),
            "orientation": types.quaternion_map(kinematics.orientation_wxyz),
        }
        return {"pose": pose, "fov": FOV_DEG, "proj_mat": {"matrix": matrix.tolist()}}

    def _check_camera(self, name: Any) -> None:
        if str(name) not in FRONT_CAMERAS:
            raise ValueError(f"no camera '{name}'; there is front_center, also called 0")

    # --- lanes -------------------------------------------------------------------------------

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


def camera_position(kinematics: Kinematics) -> Vector:
    """Where the front camera is, NED."""
    turned: Vector = body_to_world(np.array(kinematics.orientation_wxyz), CAMERA_MOUNT_M)
    return tuple(a + b for a, b in zip(kinematics.position_m, turned, strict=True))  # type: ignore[return-value]


def _png(image: NDArray[np.uint8]) -> bytes:
    done, data = cv2.imencode(".png", image)
    if not done:
        raise ValueError("the image could not be compressed")
    return data.tobytes()


def decode_image(reply: Mapping[str, Any]) -> NDArray[Any]:
    """The picture in a `raw_image` reply."""
    return np.frombuffer(reply["data"], reply["dtype"]).reshape(reply["shape"])
