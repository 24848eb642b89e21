"""The camera: known geometry, and pictures of the moment."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from typing import Any

import cv2
import mujoco
import numpy as np
import pytest

from tests.opengl import needs_opengl
from tests.scenes import Scene, object_names
from uavaccel.errors import UserError
from uavaccel.kinematics import VelocityGoal
from uavaccel.resources import asset
from uavaccel.sim.camera import gl, pixels
from uavaccel.sim.camera.camera import SKY_M, Camera, Lens, MountedCamera
from uavaccel.sim.camera.view import HEIGHT, WIDTH, own_fov_deg
from uavaccel.sim.flight import of_velocity
from uavaccel.sim.lane import apply_layout, sample_layout
from uavaccel.sim.profile import NATIVE
from uavaccel.sim.world import World

EYE_AHEAD_M = 0.46
POST_FACE_M = 6.0
SCENE = """
<mujoco>
  <include file="{quadrotor}"/>
  <visual>
    <map znear="0.0005" zfar="3"/>
    <headlight ambient="0 0 0" diffuse="0 0 0" specular="0 0 0"/>
  </visual>
  <statistic extent="100" center="0 0 0"/>
  <asset>
    <texture name="sky" type="skybox" builtin="flat" rgb1="0 0 1" width="8" height="8"/>
  </asset>
  <worldbody>
    <light directional="true" castshadow="false" dir="1 0 0" diffuse="1 1 1" ambient="0 0 0" specular="0 0 0"/>
    <geom name="post" type="box" pos="{post} 0 10" size="1 1 1" rgba="1 0 0 1"/>
    <geom name="left_up" type="box" pos="{post} 3 12" size="1 0.5 0.5" rgba="0 1 0 1"/>
  </worldbody>
</mujoco>
"""


@pytest.fixture(scope="module")
def posts() -> mujoco.MjModel:
    """A red cube 6 m ahead of the eye, a green block up to the left, a blue sky."""
    quadrotor = asset("mjcf/quadrotor.xml")
    return mujoco.MjModel.from_xml_string(SCENE.format(quadrotor=quadrotor, post=EYE_AHEAD_M + POST_FACE_M + 1.0))


@pytest.fixture
def lane(lane_scene: Scene) -> Scene:
    """The lane of seed 0, the vehicle at its start."""
    model, data = lane_scene
    mujoco.mj_resetData(model, data)
    apply_layout(model, data, sample_layout(0))
    return model, data


@pytest.fixture
def eye(posts: mujoco.MjModel) -> Iterator[Camera]:
    with Camera(posts) as camera:
        yield camera


@needs_opengl
def test_a_picture_has_its_top_first_and_its_left_to_the_left(posts: mujoco.MjModel, eye: Camera) -> None:
    picture = eye.colour(mujoco.MjData(posts))
    assert picture.shape == (HEIGHT, WIDTH, 3) == (144, 256, 3)
    assert picture.dtype == np.uint8
    assert picture[72, 128].tolist() == [255, 0, 0]
    assert picture[140, 250].tolist() == [0, 0, 255]
    green = np.argwhere(picture[:, :, 1] > 200)
    assert green[:, 0].max() < 72
    assert green[:, 1].max() < 128
    gray = eye.gray(mujoco.MjData(posts))
    assert gray.shape == (144, 256)
    assert (gray[72, 128], gray[140, 250]) == (round(0.299 * 255), round(0.114 * 255))
    seen = eye.segmentation(mujoco.MjData(posts))
    assert seen.dtype == np.int32
    assert (seen[72, 128], seen[140, 250]) == (posts.geom("post").id, -1)
    assert object_names(posts, seen) == ["left_up", "post"]


@needs_opengl
def test_pictures_are_opencvs_to_the_bit() -> None:
    random = np.random.default_rng(0)
    for shape in ((144, 256, 3), (144, 256), (8, 12, 3)):
        picture, small = random.integers(0, 256, shape, np.uint8), (shape[1] // 4, shape[0] // 4)
        for kind in (picture, random.random(shape, np.float32) * np.float32(50)):
            np.testing.assert_array_equal(pixels.quartered(kind), cv2.resize(kind, small, interpolation=cv2.INTER_AREA))
        assert pixels.means(picture) == list(cv2.mean(picture))[: 3 if picture.ndim == 3 else 1]
    drawn = random.integers(0, 256, (9, 7, 4), np.uint8)
    np.testing.assert_array_equal(pixels.luma(drawn, turned=True)[::-1], cv2.cvtColor(drawn, cv2.COLOR_RGBA2GRAY))
    np.testing.assert_array_equal(pixels.turned_colours(drawn), drawn[::-1, :, :3])
    file = cv2.imdecode(np.frombuffer(pixels.png(drawn[..., :3]), np.uint8), cv2.IMREAD_COLOR)
    np.testing.assert_array_equal(np.asarray(file)[..., ::-1], drawn[..., :3])


def test_depth_is_in_metres(posts: mujoco.MjModel, eye: Camera) -> None:
    data = mujoco.MjData(posts)
    planar, along_rays = eye.depth(data), eye.depth_perspective(data)
    assert planar.dtype == along_rays.dtype == np.float32
    face = eye.segmentation(data) == posts.geom("post").id
    assert np.allclose(planar[face], POST_FACE_M, rtol=1e-4)
    row, column = np.argwhere(face)[0]
    ray = np.hypot(1.0, np.hypot((column + 0.5 - 128) / 128, (row + 0.5 - 72) / 128))
    assert along_rays[row, column] == pytest.approx(POST_FACE_M * ray, rel=1e-4)
    assert planar[140, 250] == pytest.approx(eye.far_m, rel=1e-4)


@needs_opengl
@pytest.mark.parametrize(("width", "height", "fov_deg"), [(256, 144, 90.0), (64, 64, 90.0), (160, 40, 120.0)])
def test_the_field_of_view_is_horizontal(posts: mujoco.MjModel, width: int, height: int, fov_deg: float) -> None:
    """The cube is 2 m wide and 6 m away."""
    with MountedCamera(posts, width, height) as camera:
        camera.point(None, Lens(width, height, fov_deg))
        cube = camera.segmentation(mujoco.MjData(posts)) == posts.geom("post").id
    focal = width / 2 / np.tan(np.radians(fov_deg) / 2)
    assert cube.any(axis=0).sum() == pytest.approx(2.0 / POST_FACE_M * focal, abs=1.0)
    assert cube.any(axis=1).sum() == pytest.approx(2.0 / POST_FACE_M * focal, abs=1.0)


@needs_opengl
def test_pictures_have_a_drones_own_field_of_view(posts: mujoco.MjModel) -> None:
    narrow = copy.copy(posts)
    narrow.cam_fovy += 0.05  # a quarter of a pixel
    assert [own_fov_deg(each, 0) == 90.0 for each in (posts, narrow)] == [True, False]
    narrow.cam_fovy[:] = 40.0
    with Camera(narrow, 128, 72) as camera:
        cube = camera.segmentation(mujoco.MjData(narrow)) == narrow.geom("post").id
    assert cube.any(axis=1).sum() == pytest.approx(2.0 / POST_FACE_M * 36 / np.tan(np.radians(20.0)), abs=1.0)


@needs_opengl
def test_a_picture_is_of_the_pose_at_that_moment(lane: Scene) -> None:
    """MuJoCo's own places lag a step behind the pose; the camera's must not."""
    model, data = lane
    with Camera(model) as camera:
        mujoco.mj_forward(model, data)
        data.qpos[0] = 3.0
        late = camera.depth(data)
        mujoco.mj_forward(model, data)
        assert np.array_equal(late, camera.depth(data))
        data.qpos[0] = 0.0
        assert not np.array_equal(late, camera.depth(data))


@needs_opengl
def test_looking_does_not_change_the_flight() -> None:
    ends = []
    for looks in (False, True):
        world = World("lane", NATIVE)
        world.set_lane(sample_layout(1))
        world.reset()
        world.lead.set_goal(of_velocity(VelocityGoal((1.0, 0.4, 0.0), yaw=0.2)))
        for _ in range(20):
            world.advance(50)
            if looks:
                world.camera(WIDTH, HEIGHT).colour(world.data)
        ends.append((world.data.qpos.tobytes(), world.data.qvel.tobytes()))
        world.close()
    assert ends[0] == ends[1]


@needs_opengl
def test_same_data_same_bytes_in_every_kind(lane: Scene) -> None:
    """Whatever was drawn in between, by whichever of two cameras."""
    model, data = lane
    with Camera(model) as first, Camera(model, 64, 36) as second:
        kinds: list[Any] = [first.colour, first.gray, first.depth, first.depth_perspective, first.segmentation]
        before = [kind(data).tobytes() for kind in kinds]
        small = second.colour(data).tobytes()
        assert [kind(data).tobytes() for kind in reversed(kinds)] == before[::-1]
        assert second.colour(data).tobytes() == small
        for kind, kept in zip(kinds, before, strict=True):
            earlier = kind(data)
            data.qpos[0] += 2.0
            assert kind(data).tobytes() != kept
            assert earlier.tobytes() == kept, "a later picture does not overwrite an earlier one"
            data.qpos[0] -= 2.0
    with Camera(model) as third:
        assert third.colour(data).tobytes() == before[0]


@needs_opengl
def test_worlds_that_look_alike_share_a_context_and_others_do_not(lane: Scene) -> None:
    """Each draws what it draws alone, and goes on when another one is closed."""
    model, data = lane
    other = mujoco.MjModel.from_xml_path(str(asset("mjcf/lane.xml")))
    scene = mujoco.MjData(other)
    apply_layout(other, scene, sample_layout(2))
    with Camera(other) as alone:
        expected = alone.colour(scene)
    textured = mujoco.MjModel.from_xml_path(str(asset("mjcf/lane.xml")))
    textured.tex_data[:] = 255
    with Camera(model) as first, Camera(textured) as third:
        with Camera(other) as second:
            assert second._canvas is first._canvas is not third._canvas
            before = first.colour(data)
            np.testing.assert_array_equal(second.colour(scene), expected)
        np.testing.assert_array_equal(first.colour(data), before)


@needs_opengl
def test_a_canvas_has_room_for_the_highest_and_for_the_widest() -> None:
    world = World("blocks", NATIVE)
    for width, height, ground in ((96, 16, 13), (16, 96, 50)):
        pointed = world.mounted_camera(width, height)
        pointed.point(None, Lens(width, height))
        assert (pointed.depth(world.data)[ground:] < SKY_M).all()  # from that row down, as wide as it is
    assert (pointed.width_most, pointed.height_most) == (16, 96)
    world.close()


@needs_opengl
@pytest.mark.parametrize(("new", "said"), [
    ('"tail"', "no camera 'front_center' in the scene; there is tail"),
    *(
        (f'"front_center" {other}', "camera 'front_center': must be fixed to its body")
        for other in ('mode="trackcom"', 'projection="orthographic"', 'sensorsize="1 1" resolution="9 9"')
    ),
])  # fmt: skip
def test_a_camera_that_is_not_there_or_no_pinhole(new: str, said: str) -> None:
    other = asset("mjcf/quadrotor.xml").read_text().replace('"front_center"', new)
    with pytest.raises(UserError, match=said):
        Camera(mujoco.MjModel.from_xml_string(other.replace('fovy="58.7155"', "") if "sensor" in new else other))


@needs_opengl
def test_pixels_are_those_of_mujocos_own_buffer(lane_scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    """Software draws without the stencil that MuJoCo's off-screen buffer has beside its depths."""
    model, data = lane_scene
    seen: list[bytes] = []
    for drop in (gl.drop_stencil, lambda *_: None):
        monkeypatch.setattr(gl, "drop_stencil", drop)
        with Camera(model) as camera:
            for seed in range(4):
                apply_layout(model, data, sample_layout(seed))
                data.qpos[:] = (30.0 * seed, 1.0 - seed, 2.0, 1.0, 0.03 * seed, -0.05, 0.1)
                pictures = (camera.colour(data), camera.depth(data), camera.segmentation(data))
                seen.append(b"".join(picture.tobytes() for picture in pictures))
    assert seen[:4] == seen[4:]
    assert len(set(seen[:4])) == 4
