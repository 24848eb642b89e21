"""Objects as AirSim's clients find, move, spawn, destroy, colour and detect them, and patterns of their names."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.airsim_wire import AirSimWire, level_pose, vector, xyz
from tests.simulating import simulate
from uavaccel.resources import asset
from uavaccel.sim.profile import NATIVE
from uavaccel.sim.scene.model import SPARES, airsim_spec, park_spares
from uavaccel.sim.scene.objects import SceneObjects, cast, matching, restore_from
from uavaccel.sim.simulation import Simulation
from uavaccel.sim.vehicle.vehicle import BODY
from uavaccel.sim.world import World
from uavaccel.wire import rpc
from uavaccel.wire.api import Api
from uavaccel.wire.pictures import colours
from uavaccel.wire.settings import Settings

NORTH = np.array([[1.0, 0.0, 0.0]])
ONE = vector(1.0, 1.0, 1.0)
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


def ahead_m(wire: AirSimWire) -> float:
    """How far the first thing north of the vehicle's middle is."""
    place = wire.simulation.kinematics().position_m
    return float(cast(wire.world.model, wire.world.data, place, NORTH, exclude=BODY).distance_m[0])


def spawn(wire: AirSimWire, name: str, asset: str, at: tuple[float, float, float], scale: Any = ONE) -> str:
    told: str = wire.call("simSpawnObject", name, asset, level_pose(*at), scale, False, False)
    return told


def test_objects_are_found_by_whole_names_whatever_their_case(wire: AirSimWire) -> None:
    assert wire.call("simListSceneObjects", "BLOCK_north.*") == ["block_north", "block_north_east", "block_north_west"]
    assert wire.call("simListSceneObjects", "north") == []
    assert {"ground", "SimpleFlight"} < set(wire.call("simListSceneObjects"))
    assert xyz(wire.call("simGetObjectPose", BLOCK)["position"]) == [45.0, 0.0, -6.0]
    assert wire.call("simGetObjectPose", "SimpleFlight") == wire.call("simGetVehiclePose", "")
    nowhere = wire.call("simGetObjectPose", "Nowhere")
    assert np.isnan(xyz(nowhere["position"])).all()
    assert np.isnan(nowhere["orientation"]["w_val"])
    assert not wire.call("simSetObjectPose", "Nowhere", nowhere, True)


def test_an_object_is_where_it_is_put_and_as_large_as_it_is_made(wire: AirSimWire) -> None:
    assert ahead_m(wire) == pytest.approx(42.0)
    assert wire.call("simSetObjectPose", BLOCK, level_pose(20.0, 0.0, -10.0), True)
    assert ahead_m(wire) == pytest.approx(17.0)
    assert wire.call("simSetObjectScale", BLOCK, vector(2.0, 1.0, 1.0))
    assert ahead_m(wire) == pytest.approx(14.0)
    assert xyz(wire.call("simGetObjectScale", BLOCK)) == [2.0, 1.0, 1.0]
    half = np.sqrt(0.5)
    turned = level_pose(20.0, 0.0, -10.0) | {"orientation": {"w_val": half, "x_val": 0.0, "y_val": 0.0, "z_val": half}}
    turned["position"]["x_val"] = 30.0
    assert wire.call("simSetObjectPose", BLOCK, turned, True)  # a quarter turn: its length of 40 m lies north
    assert ahead_m(wire) == pytest.approx(10.0)
    for method, value in (("simSetObjectPose", level_pose(0, 0, 0)), ("simSetObjectScale", ONE)):
        assert not wire.call(method, "ground", value)
        assert not wire.call(method, "nothing", value)


@pytest.mark.parametrize(("asset", "scale", "half_m"), [
    ("Cube", (2.0, 1.0, 3.0), 1.0),
    ("Sphere", (1.0, 3.0, 3.0), 0.5),
    ("Cylinder", (3.0, 3.0, 3.0), 1.5),
    ("Plane", (4.0, 4.0, 200.0), 2.0),
])  # fmt: skip
def test_what_is_spawned_has_its_form_stops_the_vehicle_and_goes(
    wire: AirSimWire, asset: str, scale: tuple[float, float, float], half_m: float
) -> None:
    assert asset in wire.call("simListAssets")
    name = spawn(wire, "crate", asset, (6.0, 0.0, -10.0), vector(*scale))
    assert name == "crate"
    assert ahead_m(wire) == pytest.approx(6.0 - half_m)
    assert not wire.call("simGetCollisionInfo", "")["has_collided"]
    wire.call("moveByVelocityZ", 4.0, 0.0, -10.0, 10.0, 0, {"is_rate": True, "yaw_or_rate": 0.0}, "")
    wire.fly(3.0)
    hit = wire.call("simGetCollisionInfo", "")
    assert (hit["has_collided"], hit["object_name"]) == (True, "crate")
    assert wire.call("simDestroyObject", "crate")
    assert not wire.call("simDestroyObject", "crate")
    wire.call("reset")
    assert ahead_m(wire) == pytest.approx(42.0)
    wire.simulation.lead.api_control = True
    wire.call("moveByVelocityZ", 4.0, 0.0, -10.0, 10.0, 0, {"is_rate": True, "yaw_or_rate": 0.0}, "")
    wire.fly(3.0)
    assert not wire.call("simGetCollisionInfo", "")["has_collided"]
    assert wire.simulation.kinematics().position_m[0] > 5.5


def test_names_are_numbered_and_there_is_room_again(wire: AirSimWire) -> None:
    names = ["box", "box", "box", "hut7", "hut"]
    spawned = [spawn(wire, name, "Cube", (30.0, 30.0, -20.0)) for name in names]
    assert spawned == ["box", "box1", "box2", "hut7", "hut8"]
    for _ in range(SPARES - len(names)):
        spawn(wire, "box", "Cube", (30.0, 30.0, -20.0))
    with pytest.raises(rpc.RpcError, match="there is no room for another object"):
        spawn(wire, "box", "Cube", (30.0, 30.0, -20.0))
    assert wire.call("simDestroyObject", "box1")
    assert spawn(wire, "late", "Cube", (30.0, 30.0, -20.0)) == "late"


@pytest.mark.opengl
def test_segmentation_ids_are_airsims_until_they_are_set(wire: AirSimWire) -> None:
    letters = sum(map(ord, "blocknorth"))
    assert wire.call("simGetSegmentationObjectID", BLOCK) == (5 + letters) % 256
    assert wire.call("simSetSegmentationObjectID", "block_[a-z_]*", 21, True)
    assert not wire.call("simSetSegmentationObjectID", "tree.*", 3, True)
    assert wire.call("simSetSegmentationObjectID", BLOCK, 42, False)
    assert wire.call("simGetSegmentationObjectID", "BLOCK_NORTH") == 42
    assert wire.call("simGetSegmentationObjectID", "block_east") == 21
    assert wire.call("simGetSegmentationObjectID", "tree") == -1
    assert wire.call("simGetSegmentationObjectID", "SimpleFlight") == (5 + sum(map(ord, "simpleflight"))) % 256
    assert wire.call("simSetSegmentationObjectID", "simpleflight", 7, False)
    assert wire.call("simGetSegmentationObjectID", "SimpleFlight") == 7

    def middle() -> list[int]:
        [picture] = wire.images(("0", 5, False))
        pixels = np.frombuffer(picture["image_data_uint8"], np.uint8).reshape(144, 256, 3)
        return [int(part) for part in pixels[78, 128, ::-1]]

    assert middle() == colours()[42].tolist() == [92, 31, 106]
    assert colours()[255].tolist() == [255, 255, 255]
    assert len(np.unique(colours(), axis=0)) == 256
    assert wire.call("simSetSegmentationObjectID", BLOCK, -1, False)
    assert middle() == [0, 0, 0]


def test_objects_stay_what_they_are_in_a_model_with_more_vehicles(wire: AirSimWire) -> None:
    """As a world makes a new model that has others attached."""
    spawn(wire, "post", "Cylinder", (10.0, 0.0, -10.0), vector(1.0, 1.0, 30.0))
    spec = airsim_spec(asset("mjcf/blocks.xml"))
    other = mujoco.MjSpec.from_file(str(asset("mjcf/quadrotor.xml")))
    spec.attach(other, frame=spec.worldbody.add_frame(pos=[0, 0, 50]), prefix="Other/")
    new = spec.compile()
    park_spares(new)
    restore_from(wire.world.model, new)
    data = mujoco.MjData(new)
    assert cast(new, data, (0.0, 0.0, -10.0), NORTH, exclude=BODY).distance_m[0] == pytest.approx(9.5)
    data.qpos[:3] = 9.4, 0.0, 10.0
    mujoco.mj_forward(new, data)
    assert data.ncon > 0


def test_detections_are_boxes_of_what_is_seen_within_the_radius(wire: AirSimWire) -> None:
    spawn(wire, "Car_1", "Cube", (10.46, 2.0, -9.0))
    spawn(wire, "Car_far", "Cube", (80.0, 0.0, -30.0))
    spawn(wire, "Car_hidden", "Cube", (60.0, 0.0, -5.0))  # behind block_north
    spawn(wire, "Car_behind", "Cube", (-20.0, 0.0, -10.0))
    assert wire.call("simGetDetections", "0", 0, "", False) == []
    wire.call("simAddDetectionFilterMeshName", "0", 0, "car_*", "", False)
    assert [found["name"] for found in wire.call("simGetDetections", "0", 0, "", False)] == ["Car_1", "Car_far"]
    wire.call("simAddDetectionFilterMeshName", "0", 0, "block_no?th", "", False)  # beside the other name
    assert {found["name"] for found in wire.call("simGetDetections", "0", 0, "", False)} == {
        "Car_1",
        "Car_far",
        "block_north",
    }
    wire.call("simSetDetectionFilterRadius", "front_center", 0, 3000.0, "", False)
    [car] = wire.call("simGetDetections", "0", 0, "", False)
    box = car["box2D"]
    near, far = 9.5, 10.5  # of its faces; 128 pixels are one metre at one metre
    assert box["min"] == pytest.approx({"x_val": 128 + 128 * 1.5 / far, "y_val": 72 + 128 * 0.5 / far})
    assert box["max"] == pytest.approx({"x_val": 128 + 128 * 2.5 / near, "y_val": 72 + 128 * 1.5 / near})
    assert xyz(car["relative_pose"]["position"]) == pytest.approx([10.0, 2.0, 1.0])
    assert xyz(car["box3D"]["min"]) == pytest.approx([9.5, 1.5, 0.5])
    assert car["geo_point"]["altitude"] == pytest.approx(122.0 + 9.0)
    assert wire.call("simGetDetections", "0", 1, "", False) == [], "each type has filters of its own"
    wire.call("simClearDetectionMeshNames", "0", 0, "", False)
    assert wire.call("simGetDetections", "0", 0, "", False) == []


FILTERS: dict[str, tuple[str, int, str, bool]] = {  # camera, type of image, vehicle, external
    "front camera": ("front_center", 0, "A", False),
    "another type": ("front_center", 1, "A", False),
    "another camera": ("front_right", 0, "A", False),
    "another vehicle": ("front_center", 0, "B", False),
    "external of that name": ("front_center", 0, "A", True),
}


@pytest.mark.parametrize("chosen", FILTERS)
def test_a_filter_is_of_one_camera_and_type_of_image(chosen: str) -> None:
    """Names, radius and their removal; all look at block_north, whose middle is more than 30 m away."""
    settings = {
        "Vehicles": {"A": {"X": 0, "Y": 0, "Z": -6}, "B": {"X": 0, "Y": 5, "Z": -6}},
        "ExternalCameras": {"front_center": {"X": 0, "Y": -5, "Z": -6}},
    }
    api = Api(Simulation(World("blocks", NATIVE)), Settings.model_validate(settings), render=False)

    def call(method: str, which: str, *value: object) -> Any:
        camera, image_type, *whose = FILTERS[which]
        return api.call(method, [camera, image_type, *value, *whose], 0)

    def detecting() -> list[str]:
        return [name for name in FILTERS if call("simGetDetections", name)]

    call("simAddDetectionFilterMeshName", chosen, "block_north")
    assert detecting() == [chosen]
    for name in FILTERS:
        call("simAddDetectionFilterMeshName", name, "block_north")
    call("simSetDetectionFilterRadius", chosen, 3000.0)
    assert detecting() == [name for name in FILTERS if name != chosen]
    call("simSetDetectionFilterRadius", chosen, 6000.0)
    call("simClearDetectionMeshNames", chosen)
    assert detecting() == [name for name in FILTERS if name != chosen]


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
            hits = cast(world.model, world.data, place, way[None] / length_m, length_m, exclude=BODY)
            assert hits.geoms[0] == -1
    assert {"OrangeBall", "PulsingCone", "Cylinder5_2"} < set(SceneObjects(world).names())
    low = SceneObjects(world).corners("PulsingCone")[:, 2].max()
    assert low == pytest.approx(0.0, abs=1e-6), "it stands on the ground"


def test_a_plain_scene_can_be_moved_but_has_no_room() -> None:
    api = Api(simulate())
    with pytest.raises(rpc.RpcError, match="no room for another object"):
        api.call("simSpawnObject", ["box", "Cube", level_pose(0, 0, -50), ONE, False, False], 0)


def test_a_pattern_gives_its_segmentation_id_to_all_that_match() -> None:
    wire = AirSimWire()
    blocks = wire.call("simListSceneObjects", "block_.*")
    assert len(blocks) > 1
    assert wire.call("simSetSegmentationObjectID", "block_.*", 77, True) is True
    assert {wire.call("simGetSegmentationObjectID", name) for name in blocks} == {77}
    assert wire.call("simGetSegmentationObjectID", "ground") != 77


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
    (r"(.)\1.*", ["aab"]),
    ("[^]{1}|[]", ["a", "B"]),
    (r"\A{1}|a\{,2}|a{2\}", ["a", "a{2}"]),
])  # fmt: skip
def test_whole_names_whatever_their_case(expression: str, found: list[str]) -> None:
    assert matching(expression, NAMES) == found


def test_the_end_is_not_before_a_last_line_break_nor_a_dot_one() -> None:
    assert matching("a$", ["a", "a\n"]) == ["a"]
    assert matching("a$.*|a.", ["a", "a\n", "a\u2028"]) == ["a"]


@pytest.mark.parametrize(("expression", "reason"), [
    ("(", r"missing \)"),
    ("a)", "unbalanced"),
    ("*", "nothing to repeat"),
    ("a{3,2}", "greater than max"),
    ("[", "unterminated"),
    ("[b-a]", "bad character range"),
    ("[[:vowel:]]", "unknown property"),
    ("(?<=a)b", r"\(\?< is not known"),
    ("(?i)a", r"\(\?i is not known"),
    ("(*FAIL)", r"\(\* is not known"),
    ("a++", r"\+\+ is not known"),
    (r"(a)\2", "group"),
    ("\\", "end of pattern"),
    ("(" * 5000 + ")" * 5000, "nested too deeply"),
    ("((a{1000}){1000}){1000}", "repetitions written out"),
    ("(" * 80 + "a" + "+)" * 80 + "+", "repetitions written out"),
])  # fmt: skip
def test_what_is_none_is_refused_in_words(expression: str, reason: str) -> None:
    with pytest.raises(ValueError, match=f"is no regular expression: .*{reason}"):
        matching(expression, NAMES)


@pytest.mark.parametrize("expression", ["(a+)+$", "(a|a)*b", "((a*)*)*b", "(x+x+)+y", "(.*.*.*)*!", "(?:(?:a+)+)+!"])
def test_what_naive_backtracking_never_ends_is_answered(expression: str) -> None:
    assert matching(expression, ["a" * 200, "x" * 200]) == ["a" * 200] * (expression == "(a+)+$")


@pytest.mark.parametrize("call", [
    ("simListSceneObjects",),
    ("simSetSegmentationObjectID", 7, True),
])  # fmt: skip
def test_both_calls_match_in_bounded_time(call: tuple[object, ...]) -> None:
    wire, (method, *rest) = AirSimWire(), call
    name = wire.call("simSpawnObject", "x" * 200, "Cube", POSE, {"x_val": 1.0, "y_val": 1.0, "z_val": 1.0})
    try:
        assert not wire.call(str(method), "(x+x+)+y", *rest)
        assert wire.call(str(method), "(x+x+)+", *rest) in ([name], True)
        with pytest.raises(rpc.RpcError, match="no regular expression"):
            wire.call(str(method), "(", *rest)
    finally:
        wire.call("simDestroyObject", name)


POSE = {
    "position": {"x_val": 3000.0, "y_val": 0.0, "z_val": -50.0},
    "orientation": {"w_val": 1.0, "x_val": 0.0, "y_val": 0.0, "z_val": 0.0},
}
