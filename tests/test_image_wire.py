"""Images as they come over the wire, against rays cast into scenes whose measures are known."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from tests.airsim_wire import MS, AirSimWire, floats, pixels
from tests.scenes import BLOCKS, COLUMNS, ROWS, Pose, cast_rays
from uavaccel.sim.camera.camera import SKY_M, Lens, MountedCamera
from uavaccel.sim.profile import NATIVE
from uavaccel.sim.world import World
from uavaccel.wire import rpc
from uavaccel.wire.api import Api
from uavaccel.wire.image_api import decode_image, projection
from uavaccel.wire.pictures import can_render, colours, id_of_name, pixel_rays
from uavaccel.wire.types import EPOCH_NS

pytestmark = pytest.mark.opengl

SCENE, PLANAR, PERSPECTIVE, DEPTH_VIS, SEGMENTATION = 0, 1, 2, 3, 5

POSES = [
    Pose((2.0, 6.0, -7.0), (0.0, 0.0, 0.0)),
    Pose((10.0, -5.0, -4.0), (12.0, -8.0, 35.0)),
    Pose((-15.0, 4.0, -9.0), (-20.0, -15.0, -130.0)),
]


@pytest.fixture(scope="module")
def worlds() -> Iterator[dict[str, World]]:
    worlds = {scene: World(scene, NATIVE) for scene in ("blocks", "lane")}
    yield worlds
    for world in worlds.values():
        world.close()


def raw(wire: AirSimWire, kind: str) -> NDArray[Any]:
    return decode_image(wire.call("uavaccelImage", kind))


def metres(wire: AirSimWire, image_type: int) -> NDArray[np.float64]:
    return floats(wire.images(("0", image_type, True))[0])


def bgr(wire: AirSimWire, image_type: int) -> NDArray[np.uint8]:
    return pixels(wire.images(("0", image_type, False))[0])


@pytest.fixture
def blocks(worlds: dict[str, World]) -> AirSimWire:
    return AirSimWire(world=worlds["blocks"])


@pytest.fixture
def lane(worlds: dict[str, World]) -> AirSimWire:
    return AirSimWire(world=worlds["lane"])


@pytest.mark.parametrize("pose", POSES)
def test_depth_is_how_far_each_ray_goes(blocks: AirSimWire, pose: Pose) -> None:
    blocks.move(pose)
    seen = cast_rays(pose, BLOCKS)
    inside = seen.inside() & (seen.box >= 0)
    assert inside.mean() > 0.3
    for image_type, expected_m in ((PLANAR, seen.planar_m), (PERSPECTIVE, seen.perspective_m)):
        depth_m = metres(blocks, image_type)
        np.testing.assert_allclose(depth_m[inside], expected_m[inside], rtol=3e-3)
        share = np.clip(expected_m / 100.0, 0.0, 1.0)
        shades = bgr(blocks, image_type)
        assert np.abs(shades[inside] / 255.0 - share[inside, None]).max() < 1 / 255 + 2e-3
    np.testing.assert_allclose(metres(blocks, DEPTH_VIS)[inside], np.minimum(seen.planar_m / 100, 1)[inside], rtol=3e-3)
    np.testing.assert_array_equal(bgr(blocks, DEPTH_VIS), bgr(blocks, PLANAR))
    sky = metres(blocks, PLANAR) == 65504.0
    np.testing.assert_array_equal(raw(blocks, "depth")[~sky], metres(blocks, PLANAR)[~sky])
    assert sky[seen.inside() & (seen.box < 0)].all()


@pytest.mark.parametrize("pose", POSES)
def test_segmentation_has_a_colour_per_object(blocks: AirSimWire, pose: Pose) -> None:
    blocks.move(pose)
    seen, ids = cast_rays(pose, BLOCKS), raw(blocks, "segmentation")
    expected = np.array([*(blocks.world.model.geom(name).id for name in BLOCKS), -1])[seen.box]
    assert len(np.unique(expected)) >= 4
    np.testing.assert_array_equal(ids[seen.inside()], expected[seen.inside()])
    assert ids.dtype == np.int32
    assert ids.shape == (ROWS, COLUMNS)
    object_ids = np.array([id_of_name(name) for name in [*BLOCKS, ""]])
    object_ids[-1] = 0
    np.testing.assert_array_equal(
        bgr(blocks, SEGMENTATION)[seen.inside()], colours()[object_ids[seen.box]][..., ::-1][seen.inside()]
    )
    assert (bgr(blocks, SEGMENTATION)[ids == -1] == 0).all()
    assert len(np.unique(colours(), axis=0)) == len(colours()) == 256


def test_pictures_are_blue_first_and_ours_red_first(lane: AirSimWire) -> None:
    """A blue post to the left and a red one to the right, its top above the horizon, the ground below."""
    places = {"blue": -1.5, "red": 1.5}
    lane.call(
        "uavaccelSetLane",
        {"obstacles": [{"x_m": 6.0, "y_m": y, "half_side_m": 0.5, "texture": c} for c, y in places.items()]},
    )
    posts = {colour: ((6.0, y, -10.0), (0.5, 0.5, 10.0)) for colour, y in places.items()}
    pose = Pose((0.0, 0.0, -10.0), (0.0, 0.0, 0.0))
    seen, shown = cast_rays(pose, posts), bgr(lane, SCENE)
    blue, green, red = shown[seen.inside() & (seen.box == 0)].mean(axis=0)  # material 0.35, 0.55, 1
    assert (red / blue, green / blue) == pytest.approx((0.35, 0.55), rel=0.05)
    blue, green, red = shown[seen.inside() & (seen.box == 1)].mean(axis=0)  # material 0.9, 0.25, 0.2
    assert (green / red, blue / red) == pytest.approx((0.25 / 0.9, 0.2 / 0.9), rel=0.05)
    colour = raw(lane, "colour")
    np.testing.assert_array_equal(colour, shown[..., ::-1])
    gray = raw(lane, "gray")
    assert gray.dtype == np.uint8
    assert gray.shape == (ROWS, COLUMNS)
    assert np.abs(gray - colour @ np.array([0.299, 0.587, 0.114])).max() <= 1.0
    np.testing.assert_array_equal(metres(lane, SCENE), (shown[..., 2] / np.float32(255)).astype(np.float32))
    for png in (
        lane.call("simGetImages", [{"camera_name": "0"}], "")[0]["image_data_uint8"],
        lane.call("simGetImage", "front_center", SCENE, "", False),
    ):
        assert png.startswith(b"\x89PNG")
        np.testing.assert_array_equal(cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR), shown)


def test_a_response_tells_the_pose_and_the_time_of_its_picture(blocks: AirSimWire) -> None:
    """In flight, tilted and turning: camera, picture, state and stamp are of one tick."""
    blocks.call("moveByVelocity", 4.0, 2.0, 0.0, 5.0, 0, {"is_rate": False, "yaw_or_rate": 70.0}, "")
    blocks.fly(1.234)
    state = blocks.call("getMultirotorState", "")
    told = state["kinematics_estimated"]
    [response, other] = blocks.call(
        "simGetImages", [{"camera_name": "front_center", "image_type": PLANAR, "pixels_as_float": True}, {}], ""
    )
    assert response["time_stamp"] == other["time_stamp"] == state["timestamp"] == EPOCH_NS + 1234 * MS
    assert response["camera_orientation"] == told["orientation"]
    w, x, y, z = told["orientation"].values()
    degrees = np.degrees(
        (
            np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
            np.arcsin(2 * (w * y - z * x)),
            np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)),
        )
    )
    pose = Pose(tuple(told["position"].values()), tuple(degrees))
    assert abs(degrees[0]) > 2.0
    assert abs(degrees[2]) > 30.0
    np.testing.assert_allclose(list(response["camera_position"].values()), pose.camera_m(), atol=1e-6)
    seen = cast_rays(pose, BLOCKS)
    inside = seen.inside() & (seen.box >= 0)
    depth_m = np.array(response["image_data_float"]).reshape(ROWS, COLUMNS)
    np.testing.assert_allclose(depth_m[inside], seen.planar_m[inside], rtol=3e-3)
    assert (response["width"], response["height"], response["message"]) == (COLUMNS, ROWS, "")
    assert (response["camera_name"], response["image_type"]) == ("front_center", PLANAR)
    assert (response["pixels_as_float"], response["compress"]) == (True, True)
    assert (other["camera_name"], other["image_type"], other["pixels_as_float"]) == ("", SCENE, False)
    assert other["image_data_uint8"].startswith(b"\x89PNG")  # compressed, unless it is asked not to be


def test_camera_info_projects_a_corner_to_its_pixel(blocks: AirSimWire) -> None:
    pose = POSES[1]
    blocks.move(pose)
    info = blocks.call("simGetCameraInfo", "0", "", False)
    assert info["fov"] == 90.0
    np.testing.assert_allclose(list(info["pose"]["position"].values()), pose.camera_m(), atol=1e-6)
    np.testing.assert_allclose(list(info["pose"]["orientation"].values()), pose.quaternion(), atol=1e-6)
    corner = np.array([42.0, 20.0, -12.0])  # of block_north
    north, east, down = pose.matrix().T @ (corner - pose.camera_m())
    x, y, near, w = np.array(info["proj_mat"]["matrix"]) @ (north, east, down, 1.0)
    assert w == -north  # AirSim's matrix takes north for behind
    column, row = (1 - x / w) * COLUMNS / 2, (1 + y / w) * ROWS / 2
    assert near == 10.0  # centimetres, as in Unreal
    upright = projection(Lens(ROWS, COLUMNS, 90.0))  # as AirSim has it
    assert (upright[0, 1], upright[1, 2]) == pytest.approx((COLUMNS / ROWS, -1.0))
    seen = cast_rays(pose, {"block_north": BLOCKS["block_north"]}).box
    patch = seen[int(row) - 2 : int(row) + 3, int(column) - 2 : int(column) + 3]
    assert 0 < (patch == 0).sum() < patch.size


def test_switched_off_images_are_refused_by_every_call(blocks: AirSimWire) -> None:
    api = Api(blocks.simulation, render=False)
    for method, params in (
        ("simGetImages", [[{}]]),
        ("simGetImages", [[{"image_type": PERSPECTIVE, "pixels_as_float": True}]]),
        ("simGetImage", ["0", SCENE]),
        ("uavaccelImage", ["gray"]),
    ):
        with pytest.raises(rpc.RpcError, match="rendering is switched off"):
            api.call(method, params, 0)


HUGE = {
    "CameraDefaults": {"CaptureSettings": [{"ImageType": kind, "Width": 8192, "Height": 4096} for kind in range(8)]}
}


def test_a_picture_that_is_too_large_is_refused_before_it_is_drawn() -> None:
    wire = AirSimWire(HUGE)
    for kind in range(8):
        for as_float in (False, True):
            with pytest.raises(rpc.RpcError, match=r"8192 x 4096 is too large: it may have 16,777,216 pixels"):
                wire.images(("0", kind, as_float))
    assert can_render(Lens(4320, 2160)), "AirSim's high resolution camera"


def test_normals_of_a_large_picture_are_those_row_by_row() -> None:
    wide = {"ImageType": 6, "Width": 400, "Height": 300}
    wire = AirSimWire({"CameraDefaults": {"CaptureSettings": [wide]}})
    with pytest.MonkeyPatch.context() as patch:
        whole = wire.images(("0", 6, False))[0]["image_data_uint8"]
        patch.setattr("uavaccel.wire.pictures.RAYS_AT_ONCE", 1)
        assert wire.images(("0", 6, False))[0]["image_data_uint8"] == whole
    assert len(set(whole)) > 2


@pytest.mark.opengl
def test_rays_are_those_of_the_lens_that_it_is_pointed_through() -> None:
    """Of one size, and of another size or field of view in turn: in the corner a ray is as long as its slopes say."""
    world = World("blocks", NATIVE)
    with MountedCamera(world.model, 64, 48) as camera:
        for lens in (Lens(64, 48, 90.0), Lens(64, 48, 60.0), Lens(32, 48, 60.0), Lens(64, 48, 90.0)):
            camera.point(None, lens)
            depth, length = camera.depth(world.data), camera.depth_perspective(world.data)
            slope = np.tan(np.radians(lens.fov_deg) / 2) / lens.width
            ray = np.sqrt(1 + ((lens.width - 1) * slope) ** 2 + ((lens.height - 1) * slope) ** 2)
            assert length.shape == (lens.height, lens.width)
            assert length[-1, -1] / depth[-1, -1] == pytest.approx(ray, rel=1e-5)
            rays = pixel_rays(lens, range(lens.height))
            np.testing.assert_allclose(length, np.minimum(depth / rays[..., 0], SKY_M), rtol=1e-5)
            np.testing.assert_allclose(rays[0, 0], rays[-1, -1] * [1, -1, -1])
            assert (rays[-1, -1] > 0).all(), "to the right and down"
    world.close()
