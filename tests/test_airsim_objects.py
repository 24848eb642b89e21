"""Objects as AirSim's clients find, move, spawn, destroy, colour and detect them, and patterns of their names."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.airsim_wire import AirSimWire
from tests.clutter import clutter
from tests.flying import point, pose
from tests.scenes import Pose
from uavaccel.resources import asset
from uavaccel.sim import objects as sim_objects
from uavaccel.sim import scene
from uavaccel.sim.objects import SceneObjects, cast, matching
from uavaccel.sim.poses import Pose as ScenePose
from uavaccel.sim.profile import NATIVE
from uavaccel.sim.scene import QUADROTOR, SPARES
from uavaccel.sim.world import World
from uavaccel.units import attitude_difference_rad, mujoco_to_ned, ned_to_mujoco, quaternion_ned_to_mujoco
from uavaccel.wire import rpc
from uavaccel.wire.pictures import colours

ONE = point(1.0, 1.0, 1.0)
BLOCK = "block_north"


@pytest.fixture
def wire() -> Iterator[AirSimWire]:
    """What a test has spawned or moved is put back."""
    wire = AirSimWire()
    before = {name: wire.call("simGetObjectPose", name) for name in wire.call("simListSceneObjects", "block.*")}
    yield wire
    for name in wire.call("simListSceneObjects"):
        if name in before:
            wire.call("simSetObjectPose", name, before[name], True)
            wire.call("simSetObjectScale", name, ONE)
        else:
            wire.call("simDestroyObject", name)


def spawn(wire: AirSimWire, name: str, asset: str, at: tuple[float, float, float]) -> str:
    told: str = wire.call("simSpawnObject", name, asset, pose(*at), ONE, False, False)
    return told


def test_names_are_numbered_and_there_is_room_again(wire: AirSimWire) -> None:
    for name, scale in (("Cube", 0.0), ("Brick", 1.0)):  # what is refused takes no room
        with pytest.raises(rpc.RpcError, match=r"scale must be positive|no objects with name Brick"):
            wire.call("simSpawnObject", "box", name, pose(30.0, 30.0, -20.0), point(*[scale] * 3), False, False)
    taken = wire.call("listVehicles")[0]
    assert wire.call("simDestroyObject", spawn(wire, taken, "Cube", (30.0, 30.0, -20.0))), "it is no vehicle"
    names = ["box", "box", "box", "hut7", "hut"]
    spawned = [spawn(wire, name, "Cube", (30.0, 30.0, -20.0)) for name in names]
    assert spawned == ["box", "box1", "box2", "hut7", "hut8"]
    for _ in range(SPARES - len(names)):
        spawn(wire, "box", "Cube", (30.0, 30.0, -20.0))
    with pytest.raises(rpc.RpcError, match="there is no room for another object"):
        spawn(wire, "box", "Cube", (30.0, 30.0, -20.0))
    assert wire.call("simDestroyObject", "box1")
    assert spawn(wire, "late", "Cube", (30.0, 30.0, -20.0)) == "late"


def test_one_that_grows_is_in_the_way_and_is_hit_by_its_name(wire: AirSimWire) -> None:
    name, ends = spawn(wire, "hut", "Cube", (30.0, 30.0, -20.0)), [point(28.0, y, -20.0) for y in (0.0, 60.0)]
    for metres, free in ((1.0, True), (6.0, False)):
        assert wire.call("simSetObjectScale", name, point(metres, metres, metres))
        with pytest.raises(rpc.RpcError, match=r"m inside hut\."):
            wire.call("simSetVehiclePose", pose(30.0, 30.0, -20.0), False)
        assert wire.call("simTestLineOfSightBetweenPoints", *ends) is free
    wire.call("simSetVehiclePose", pose(30.0, 30.0, -23.04), False, "")
    wire.fly(0.01)
    assert wire.call("simGetCollisionInfo", "")["object_name"] == name
    wire.call("reset")
    assert wire.call("simGetCollisionInfo", "")["object_name"] == ""


TREES = """<mujoco><include file="quadrotor.xml"/><worldbody>
<body name="hedge" pos="0 -3 0" mocap="true"><geom size="0.5 0.5 1" type="box"/><geom size="0.7" pos="0 0 1.5"/></body>
<body name="tree" pos="6 0 0" euler="0 0 90"><geom name="trunk" type="cylinder" size="0.2 1" pos="0 0 1"/>
<body euler="0 30 0"><geom name="leaves" size="1.5" pos="0 1 3" contype="0" conaffinity="0"/></body></body>
</worldbody></mujoco>"""


def test_geoms_of_bodies_are_objects_too_and_rays_meet_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also those that nothing collides with; geoms without a name are called as their body."""
    (tmp_path / "quadrotor.xml").write_text(asset("mjcf/quadrotor.xml").read_text())
    (tmp_path / "trees.xml").write_text(TREES)
    monkeypatch.setattr(scene, "scene_path", lambda *_: tmp_path / "trees.xml")
    world, plain = World("trees", NATIVE, airsim=True), World("trees", NATIVE)
    objects, data = SceneObjects(world), plain.data
    mujoco.mj_kinematics(plain.model, data)
    assert objects.names() == ["hedge", "hedge_1", "leaves", "trunk"]
    for name in ("leaves", "trunk"):
        placed = objects.pose(name)
        assert placed is not None
        assert placed.position_m == pytest.approx(mujoco_to_ned(data.geom(name).xpos))
        turned = np.zeros(4)
        mujoco.mju_mat2Quat(turned, data.geom(name).xmat)
        assert attitude_difference_rad(quaternion_ned_to_mujoco(placed.orientation_wxyz), turned) < 1e-6
    rays = np.random.default_rng(0).normal(size=(300, 3))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    hits, drone = cast(world.model, world.data, (3.0, 1.0, -2.0), rays, exclude=QUADROTOR), plain.lead.body_id
    expected = [
        mujoco.mj_ray(plain.model, data, [3.0, -1.0, 2.0], ned_to_mujoco(ray), None, 1, drone, np.zeros(1, np.int32))
        for ray in rays
    ]
    met = np.isfinite(hits.distance_m)
    assert {world.name_of(int(geom)) for geom in hits.geoms[met]} == set(objects.names())
    np.testing.assert_allclose(np.where(met, hits.distance_m, -1.0), expected, atol=1e-9)


def test_what_is_moved_and_scaled_is_as_if_it_had_been_made_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Shapes of every kind, by the poses that MJCF gives them."""
    (tmp_path / "clutter.xml").write_text(clutter(5, count=15))
    monkeypatch.setattr(scene, "scene_path", lambda *_: tmp_path / "clutter.xml")
    world, made = World("clutter", NATIVE, airsim=True), scene.airsim_spec(tmp_path / "clutter.xml")
    objects, random, scaled = SceneObjects(world), np.random.default_rng(2), set[str]()
    for name in objects.names():
        geom, placed, times = made.geom(name), objects.pose(name), float(random.uniform(0.5, 1.5))
        assert placed is not None
        np.testing.assert_allclose(ned_to_mujoco(placed.position_m), geom.pos, atol=1e-9)
        assert attitude_difference_rad(quaternion_ned_to_mujoco(placed.orientation_wxyz), geom.quat) < 1e-5
        turn = random.normal(size=4)
        there = ScenePose((*random.uniform(-6.0, 6.0, 2), -3.0), tuple((turn / np.linalg.norm(turn)).tolist()))
        if objects.set_pose(name, there):
            geom.pos, geom.quat = ned_to_mujoco(there.position_m), quaternion_ned_to_mujoco(there.orientation_wxyz)
        if objects.set_scale(name, (times, times, times)):
            geom.size = [size * times for size in geom.size]
            scaled.add(name.split("_")[0])
    assert scaled == {"sphere", "capsule", "ellipsoid", "cylinder", "box"}
    model = scene.compiled_for_clients(made)
    rays = random.normal(size=(400, 3))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    hits, expected = (
        cast(each, mujoco.MjData(each), (0.0, 0.0, -3.0), rays, exclude=None) for each in (world.model, model)
    )
    np.testing.assert_allclose(hits.distance_m, expected.distance_m, atol=1e-9)
    with pytest.raises(ValueError, match=r"^the scale of a capsule must be the same along x, y and z"):
        objects.set_scale("capsule_1", (1.0, 1.0, 2.0))


def test_a_detection_is_where_the_object_is_for_the_camera(wire: AirSimWire) -> None:
    """A turned box before a turned camera of a turned vehicle; its pixels are those of a pinhole."""
    random, clipped = np.random.default_rng(0), 0
    signs, size = np.array([*itertools.product([-0.5, 0.5], repeat=3)]), np.array([256.0, 144.0])
    home = wire.call("getHomeGeoPoint", "")
    degrees_m = np.radians(6378137.0) * np.array([1.0, np.cos(np.radians(home["latitude"]))])
    wire.call("simAddDetectionFilterMeshName", "0", 0, "hut*", "", False)
    for _ in range(12):
        vehicle, mounted, box = (tuple(random.uniform(-most, most, 3).tolist()) for most in (40.0, 90.0, 180.0))
        wire.move(Pose((30.0, 30.0, -60.0), vehicle))
        wire.call("simSetCameraPose", "0", Pose((0.5, 0.1, -0.2), mounted).message(), "")
        eye_m, axes = of_message(wire.call("simGetCameraInfo", "0", "", False)["pose"])
        sides_m, ahead_m = random.uniform(1.0, 4.0, 3), np.array([random.uniform(5.5, 9.0), *random.uniform(-4, 4, 2)])
        there = Pose(tuple((eye_m + axes @ ahead_m).tolist()), box)
        wire.call("simSpawnObject", "hut", "Cube", there.message(), point(*sides_m), False, False)
        (told,) = wire.call("simGetDetections", "0", 0, "", False)
        corners = ahead_m + (signs * sides_m) @ there.matrix().T @ axes
        pixels = size / 2 + size[0] / 2 * corners[:, 1:] / corners[:, :1]
        ends = {"box3D": (corners.min(0), corners.max(0)), "box2D": np.clip([pixels.min(0), pixels.max(0)], 0, size)}
        for kind, expected in ends.items():
            found = [[*told[kind][end].values()] for end in ("min", "max")]
            np.testing.assert_allclose(found, expected, atol=1e-3)
        clipped += bool((pixels.min(0) < 0).any() or (pixels.max(0) > size).any())
        for seen, expected in zip(of_message(told["relative_pose"]), (ahead_m, axes.T @ there.matrix()), strict=True):
            np.testing.assert_allclose(seen, expected, atol=1e-4)
        *plane, height_m = np.subtract([*told["geo_point"].values()], [*home.values()])
        np.testing.assert_allclose([*(plane * degrees_m), -height_m], there.position_m, atol=0.01)
        assert wire.call("simDestroyObject", told["name"])
    assert 0 < clipped < 12


def of_message(told: Any) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Place and matrix of a pose as it is sent."""
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, np.array([*told["orientation"].values()]))
    return np.array([*told["position"].values()]), turn.reshape(3, 3)


@pytest.mark.opengl
def test_pictures_of_segmentation_have_the_colours_of_the_ids(wire: AirSimWire) -> None:
    assert wire.call("simSetSegmentationObjectID", BLOCK, 42, False)

    def middle() -> list[int]:
        [picture] = wire.images(("0", 5, False))
        pixels = np.frombuffer(picture["image_data_uint8"], np.uint8).reshape(144, 256, 3)
        return [int(part) for part in pixels[78, 128, ::-1]]

    assert middle() == colours()[42].tolist() == [92, 31, 106]
    assert colours()[255].tolist() == [255, 255, 255]
    assert len(np.unique(colours(), axis=0)) == 256
    assert wire.call("simSetSegmentationObjectID", BLOCK, -1, False)
    assert middle() == [0, 0, 0]


def test_the_scene_fits_airsims_scripts() -> None:
    """path.py flies 125 m north, 130 m west, and back, 5 m up; objects.py and detection.py name objects of Blocks."""
    world = World("blocks", NATIVE, airsim=True)
    corners = np.array([(0.0, 0.0, -5.0), (125.0, 0.0, -5.0), (125.0, -130.0, -5.0), (0.0, -130.0, -5.0)])
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        way = end - start
        length_m = float(np.linalg.norm(way))
        beside = np.array([-way[1], way[0], 0.0]) / length_m
        for aside_m in (-5.0, 0.0, 5.0):
            place = start + aside_m * beside
            hits = cast(world.model, world.data, place, way[None] / length_m, length_m, exclude=QUADROTOR)
            assert hits.geoms[0] == -1
    assert {"OrangeBall", "PulsingCone", "Cylinder5_2"} < set(SceneObjects(world).names())
    low = SceneObjects(world).corners("PulsingCone")[:, 2].max()
    assert low == pytest.approx(0.0, abs=1e-6), "it stands on the ground"


# --- patterns ---------------------------------------------------------------------------------------------------------


NAMES = ["", "a", "ab", "aab", "B", "TemplateCube_Rounded_45", "Ground", "x.y-z", "a{2}", "1 b", "Rück_ß"]

letters = st.sampled_from([*"ab1_-.", r"\.", r"\d", r"\W", "[a-c]", "[^b_]", "[.-]", r"[\d-]"])
expressions = st.recursive(
    letters,
    lambda inner: (
        st.tuples(inner, st.sampled_from(["*", "+", "?", "{2}", "{0,1}", "{1,}", "*?", "+?"])).map(
            lambda part: f"(?:{part[0]}){part[1]}"
        )
        | st.lists(inner, min_size=1, max_size=3).map("".join)
        | st.lists(inner, min_size=2, max_size=3).map(lambda parts: f"({'|'.join(parts)})")
        | inner.map(lambda part: f"(?={part})")
        | inner.map(lambda part: f"(?!{part})")
        | inner.map(lambda part: rf"\b{part}")
    ),
    max_leaves=6,
)


@given(expressions, st.lists(st.text("aAbB1_-. ", max_size=8), max_size=8))
def test_it_finds_what_pythons_own_matcher_finds(expression: str, names: list[str]) -> None:
    every, other = [*NAMES[:6], *names], re.compile(expression, re.IGNORECASE)
    assert matching(expression, every) == [name for name in every if other.fullmatch(name)]


@pytest.mark.parametrize(("expression", "found"), [
    (".*", NAMES),
    ("", [""]),
    ("templatecube.*", ["TemplateCube_Rounded_45"]),
    (r"^(?!.*ground|.*cube).{2,4}$", ["ab", "aab", "a{2}", "1 b"]),
    (r"a\{2}", ["a{2}"]),
    ("a{2}", []),
    ("[[:alpha:]]{3}", ["aab"]),
    (r"\x42|\u0061", ["a", "B"]),
    (r".*\d\d", ["TemplateCube_Rounded_45"]),
    ("RÜCK.*", ["Rück_ß"]),
    (r"r.\w+", []),  # as in the C locale, ASCII's letters alone
    ("[[:upper:]]+", ["a", "ab", "aab", "B", "Ground"]),
    ("[[:d:]][[:s:]][[:w:]]", ["1 b"]),
    (r"(.)\1.*", ["aab"]),
    ("[^]{1}|[]", ["a", "B"]),
    (r"\A{1}|a\{,2}|a{2\}", ["a", "a{2}"]),
])  # fmt: skip
def test_whole_names_whatever_their_case(expression: str, found: list[str]) -> None:
    assert matching(expression, NAMES) == found


def test_the_end_is_not_before_a_last_line_break_nor_a_dot_one() -> None:
    assert matching(r"a$|b\0", ["a", "a\n", "b\0"]) == ["a", "b\0"]
    assert matching("a$.*|a.", ["a", "a\n", "a\u2028"]) == ["a"]
    assert [matching(f"[[:{case}:]]", ["A", "é"]) for case in ("lower", "upper")] == [["A"]] * 2


@pytest.mark.parametrize("expression", ["(a+)+$", "(a|a)*b", "((a*)*)*b", "(x+x+)+y", "(.*.*.*)*!", "(?:(?:a+)+)+!"])
def test_what_naive_backtracking_never_ends_is_answered(expression: str) -> None:
    assert matching(expression, ["a" * 200, "x" * 200]) == ["a" * 200] * (expression == "(a+)+$")


def test_the_time_is_that_of_all_names(monkeypatch: pytest.MonkeyPatch) -> None:
    times_ns = iter((0, 0, sim_objects.LONGEST_NS, sim_objects.LONGEST_NS))
    monkeypatch.setattr(sim_objects, "MonotonicClock", lambda: SimpleNamespace(now_ns=lambda: next(times_ns)))
    with pytest.raises(ValueError, match="takes too long to match"):
        matching("a+", ["b", "a", "c"])


def test_both_calls_match_in_bounded_time(wire: AirSimWire) -> None:
    name = spawn(wire, "x" * 200, "Cube", (3000.0, 0.0, -50.0))
    for method, *rest in (("simListSceneObjects",), ("simSetSegmentationObjectID", 7, True)):
        assert not wire.call(str(method), "(x+x+)+y", *rest)
        assert wire.call(str(method), "(x+x+)+", *rest) in ([name], True)
        with pytest.raises(rpc.RpcError, match="no regular expression"):
            wire.call(str(method), "(", *rest)
