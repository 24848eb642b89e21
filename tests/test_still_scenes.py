"""Any still scene as arrays: rays, touches and flights in it, against MuJoCo's own."""

from __future__ import annotations

import re
from contextlib import closing
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from tests.clutter import KINDS, clutter
from tests.compiling import kept
from tests.lanes import SideBySide
from tests.own_tasks import Pair
from uavaccel.envs.hover import Hover
from uavaccel.envs.kernel_batch import KernelBatch
from uavaccel.errors import UserError
from uavaccel.kernels import casting, tiles
from uavaccel.kernels import scene as at
from uavaccel.kernels.appearance import read_looks
from uavaccel.kernels.bodies import read_scene, read_surroundings, touchable, visible
from uavaccel.kernels.fields import EMISSION, HALF_HEIGHT, HALF_WIDTH
from uavaccel.kernels.scene import Scene
from uavaccel.kernels.scene_touching import NOTHING, above_ground, deepest_shape, nearest_shape
from uavaccel.kernels.touching import ALL, nearest, touched
from uavaccel.resources import asset
from uavaccel.sim import scene as scenes

SEEN = np.array([1, 0, 1, 0, 1, 1], np.uint8)  # groups that the drone's camera may see
HULL = (0.3418, 0.045)
FAR_M = 1000.0
TOLERANCE_M = 1e-6  # of MuJoCo's own search for contacts


@kept(error_model="numpy")
def cast_all(scene: Any, origin: Any, rays: Any, distances: Any, items: Any, normals: Any) -> None:
    for ray in range(len(rays)):
        direction = rays[ray, 0], rays[ray, 1], rays[ray, 2]
        from_ = origin[0], origin[1], origin[2]
        distance, item = casting.first_met(scene, 0, from_, direction, np.float32(FAR_M))
        distances[ray], items[ray] = distance, item
        if item != NOTHING:
            point = casting.along(from_, direction, distance)
            normal = casting.normal_at(scene, 0, item, point, direction)
            normals[ray, 0], normals[ray, 1], normals[ray, 2] = normal


@kept(error_model="numpy")
def touch_all(scene: Any, poses: Any, radius: float, half: float, found: Any, bounds: Any) -> None:
    for pose in range(len(poses)):
        found[pose], _ = deepest_shape(scene, 0, poses[pose], radius, half, (0, 1))
        bounds[pose] = nearest_shape(scene, 0, poses[pose], (0, 1))


@kept(error_model="numpy")
def touch_solids(solids: Any, poses: Any, radius: float, half: float, found: Any, bounds: Any) -> None:
    for pose in range(len(poses)):
        found[pose] = touched(poses[pose], solids, len(solids), radius, half, ALL)
        bounds[pose] = nearest(solids, len(solids), poses[pose], ALL)


@kept(error_model="numpy")
def not_in_tiles(scene: Any, camera: Any, eye: Any, size: Any, met: Any) -> int:
    """How many pixels see what is not in their tile, or nearer than it is listed; with shapes and distances `met`."""
    missed = 0
    for row in range(size[0]):
        for column in range(size[1]):
            ray, _ = casting.ray_of(camera, eye[1], row, column, size[0], size[1])
            distance, item = casting.first_met(scene, 0, eye[0], ray, eye[2])
            met[row, column] = item
            if item != NOTHING:
                shape = scene.shapes[0, item]
                there = tiles.covers(tiles.tiles_of(shape, camera, eye, size), column // 8, row // 4)
                missed += not (there and tiles.step_of(shape, eye) * tiles.STEP_M <= distance)
    return missed


def kinematic(model: mujoco.MjModel) -> mujoco.MjData:
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return data


@pytest.mark.parametrize("kind", [*KINDS, "all"])
def test_rays_meet_what_mujocos_rays_meet(kind: str) -> None:
    """Within 1e-4 m and 1e-5 of the distance; but for silhouettes the same object, and its normal."""
    kinds = KINDS if kind == "all" else (kind, "sphere")
    model = mujoco.MjModel.from_xml_string(clutter(3, kinds))
    scene, data, random = read_scene(model, seen=True), kinematic(model), np.random.default_rng(5)
    others = 0
    for number in range(12):
        heights = (-7.0, -4.0) if kind == "hfield" and number % 2 else (1.5, 7.0)  # it is seen from below, too
        origin = np.array([*random.uniform(-12, 12, 2), random.uniform(*heights)], np.float32)
        rays = random.normal(size=(1000, 3)) * (1.0, 1.0, 0.5)
        if number >= 8:  # from within, of hills upwards: MuJoCo's have a floor inside
            which = number % len(kinds)
            origin = data.geom(f"{kinds[which]}_{which}").xpos + 0.1 * random.normal(size=3)
            if kinds[which] == "hfield":
                origin[2], rays[:, 2] = origin[2] + 0.3, np.abs(rays[:, 2]) + 0.3
            origin = origin.astype(np.float32)
        rays = (rays / np.linalg.norm(rays, axis=1, keepdims=True)).astype(np.float32)
        distances, items = np.zeros(1000, np.float32), np.zeros(1000, np.int64)
        normals, expected_normals = np.zeros((1000, 3), np.float32), np.zeros((1000, 3))
        cast_all(scene, origin, rays, distances, items, normals)
        geoms, expected_m = np.zeros(1000, np.int32), np.zeros(1000)
        args = (SEEN, 1, -1, geoms, expected_m, expected_normals.ravel(), 1000, FAR_M)
        mujoco.mj_multiRay(model, data, origin.astype(float), rays.astype(float).ravel(), *args)
        geoms[expected_m > FAR_M] = -1
        found = np.where(items >= 0, scene.shapes[0, items, at.GEOM].astype(int), -1)
        same, hit = found == geoms, geoms >= 0
        others += int((~same).sum())
        met = same & hit
        np.testing.assert_array_less(np.abs(distances - expected_m)[met], 1e-4 + 1e-5 * expected_m[met])
        facing = np.einsum("ni,ni->n", normals, expected_normals.reshape(-1, 3))[met]
        assert np.mean(np.abs(facing) > 0.999) > 0.99
        assert np.all(np.einsum("ni,ni->n", normals, rays)[met] <= 1e-6)
    assert others <= 8, "silhouettes"


def test_a_picture_sees_only_what_its_tiles_have() -> None:
    """Also with the eye next to shapes, or within one."""
    model, camera, size = mujoco.MjModel.from_xml_string(clutter(3)), np.zeros(16), (36, 64)
    scene, random = read_scene(model, seen=True), np.random.default_rng(1)
    camera[HALF_WIDTH], camera[HALF_HEIGHT], seen = 1.0, 36 / 64, set()
    for number in range(24):
        place = scene.shapes[0, random.integers(scene.shapes.shape[1]), at.CENTRE : at.AXES]
        place = place + random.normal(size=3) * (0.2 if number % 2 else 4.0)
        axes = np.linalg.qr(random.normal(size=(3, 3)))[0]
        eye = tuple(place.astype(np.float32)), tuple(map(tuple, axes.astype(np.float32))), np.float32(FAR_M)
        met = np.zeros(size, np.int64)
        assert not_in_tiles(scene, camera, eye, size, met) == 0
        seen |= set(met.ravel().tolist())
    assert len(seen) > 60


def poses_at_touch(model: mujoco.MjModel, data: mujoco.MjData, seed: int, count: int) -> NDArray[np.float64]:
    """Poses (count, 7) on lines that come from afar, up to 5 mm from where MuJoCo finds a first touch."""
    random, poses = np.random.default_rng(seed), np.zeros((count, 7))
    for pose in poses:
        turn = np.array([1.0, *0.4 * random.normal(size=2), random.normal()])
        way = random.normal(size=3)
        way, middle = way / np.linalg.norm(way), random.uniform((-6, -6, -1), (6, 6, 4))
        pose[3:] = turn / np.linalg.norm(turn)
        near, far = 0.0, 25.0
        for _ in range(20):
            pose[:3] = middle + (near + far) / 2 * way
            near, far = ((near + far) / 2, far) if contacts(model, data, pose) else (near, (near + far) / 2)
        pose[:3] = middle + (far + random.uniform(-0.005, 0.005)) * way
    return poses


def contacts(model: mujoco.MjModel, data: mujoco.MjData, pose: NDArray[np.float64]) -> dict[int, float]:
    """What MuJoCo finds the drone to touch there, and how deeply: geoms, and the least distance."""
    data.qpos[:] = pose
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_collision(model, data)
    found: dict[int, float] = {}
    for contact in data.contact[: data.ncon]:
        geom = int(min(contact.geom, key=lambda each: model.geom_bodyid[each]))
        found[geom] = min(found.get(geom, 0.0), float(contact.dist))
    return found


@kept(error_model="numpy")
def bound_all(scene: Any, shape: Any, points: Any, bounds: Any) -> None:
    for point in range(len(points)):
        bounds[point] = above_ground(scene, shape, (points[point, 0], points[point, 1], points[point, 2]))


def test_no_hill_is_nearer_than_the_bound() -> None:
    """Above spikes, to any of the lines between heights; where the ground is flat, the bound is the height itself."""
    random = np.random.default_rng(2)
    heights = np.where(random.random((14, 11)) < 0.08, 1.0, 0.0)
    heights[:9] = 0.0
    data = " ".join(map(str, heights.ravel()))
    field = f'<hfield name="hills" nrow="14" ncol="11" size="5 6.5 9 0.5" elevation="{data}"/>'
    hills = '<geom name="hills" type="hfield" hfield="hills"/>'
    scene = read_scene(own_world(hills, rest=f"<asset>{field}</asset>"))
    points = random.uniform((-6.0, -7.5, 0.0), (6.0, 7.5, 4.0), (3000, 3))
    bounds = np.zeros(len(points))
    bound_all(scene, scene.shapes[0, 0], points, bounds)
    x, y = np.meshgrid(np.linspace(-5.0, 5.0, 11), np.linspace(-6.5, 6.5, 14))
    tops = np.stack([x, y, scene.heights.reshape(14, 11)], axis=-1)
    share = np.linspace(0.0, 1.0, 40)[:, None, None, None]
    lines = [one + share * (other - one) for one, other in ((tops[1:], tops[:-1]), (tops[:, 1:], tops[:, :-1]))]
    nearest, _ = cKDTree(np.concatenate([line.reshape(-1, 3) for line in lines])).query(points)
    assert (bounds <= nearest + 1e-9).all()
    flat = (np.abs(points[:, 0]) < 5.0) & (np.abs(points[:, 1] - 4.5) < 2.0) & (np.abs(points[:, 2] - 1.5) < 1.5)
    np.testing.assert_allclose(bounds[flat], points[flat, 2], atol=1e-12)


def test_the_hull_touches_what_mujoco_finds_it_to_touch_in_a_lane() -> None:
    """All is upright; but for rims of tops, which meet the hull's edge to edge."""
    others, hits, found, bounds = 0, 0, np.zeros(60, np.int64), np.zeros(60)
    for seed in range(6):
        upright = re.sub(r' quat="[^"]*"', "", clutter(seed, ["box", "cylinder", "plane"], count=24))
        model = mujoco.MjModel.from_xml_string(upright)
        solids, still, data = read_surroundings(model, "lane").fixed, touchable(model), kinematic(model)
        poses, hull = poses_at_touch(model, data, seed, 60), model.geom("quadrotor_hull").id
        touch_solids(solids, poses, *HULL, found, bounds)
        for pose, item, bound_m in zip(poses, found, bounds, strict=True):
            expected = contacts(model, data, pose)
            least_m = min(mujoco.mj_geomDistance(model, data, hull, int(geom), 50.0, None) for geom in still)
            assert bound_m <= max(least_m, 0.0) + float(np.hypot(*HULL)) + TOLERANCE_M
            same = bool(expected) == (item != NOTHING)
            if expected and item != NOTHING:
                same = expected.get(int(still[item]), 1.0) <= min(expected.values()) + 0.01
            others += not same and abs(least_m) > 2 * TOLERANCE_M
            hits += bool(expected)
    assert others <= 9
    assert hits > 120


@settings(deadline=None, max_examples=8)
@given(st.integers(0, 2**32 - 1))
def test_the_hull_touches_what_mujoco_finds_it_to_touch(seed: int) -> None:
    """Where there is no ground they come to hills from below, too."""
    kinds = [kind for kind in KINDS if seed % 2 or kind != "plane"]
    model = mujoco.MjModel.from_xml_string(clutter(seed, kinds, count=24))
    scene, data = read_scene(model), kinematic(model)
    poses = poses_at_touch(model, data, seed, 60)
    found, bounds = np.zeros(len(poses), np.int64), np.zeros(len(poses))
    touch_all(scene, poses, *HULL, found, bounds)
    hull = model.geom("quadrotor_hull").id
    for pose, item, bound_m in zip(poses, found, bounds, strict=True):
        expected = contacts(model, data, pose)
        if bool(expected) != (item != NOTHING):
            still = scene.shapes[0, :, at.GEOM].astype(int)
            least_m = min(mujoco.mj_geomDistance(model, data, hull, int(geom), 1.0, None) for geom in still)
            assert abs(least_m) < 2 * TOLERANCE_M
        elif expected:
            geom = int(scene.shapes[0, item, at.GEOM])
            assert expected[geom] <= min(expected.values()) + 0.01, "not the deepest, and not nearly so"
        else:
            still = scene.shapes[0, :, at.GEOM].astype(int)
            least_m = min(mujoco.mj_geomDistance(model, data, hull, int(geom), 50.0, None) for geom in still)
            assert bound_m <= least_m + float(np.hypot(*HULL)) + TOLERANCE_M


@pytest.fixture(params=[1, 4])
def cluttered(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Turned shapes of every kind in place of the blocks."""
    path = tmp_path / "blocks.xml"
    path.write_text(clutter(request.param, size_m=0.7))
    monkeypatch.setattr(scenes, "scene_path", lambda scene, scenery="plain": path)


@pytest.mark.usefixtures("cluttered")
def test_flights_among_turned_shapes_are_the_exact_simulators() -> None:
    """The same bytes until the first touch, at the same tick, of the same object."""
    task: dict[str, Any] = {"altitude_m": 2.0, "radius_m": 0.3, "max_commands": 25, "speed_m_s": 3.0}
    count = 8
    headings = 2 * np.pi * np.arange(count) / count  # each keeps its way
    actions = np.random.default_rng(3).uniform((-0.4, -0.4, -0.3), (0.4, 0.4, 0.4), (25, count, 3))
    actions[:, :, :2] += 0.6 * np.stack([np.cos(headings), np.sin(headings)], axis=1)
    actions = actions.astype(np.float32)
    alone = [Hover(**task) for _ in range(count)]
    with closing(KernelBatch(Hover, count, threads=1, autoreset_mode="SameStep", **task)) as batch:
        lanes = SideBySide(batch, alone)
        lanes.reset(7)
        for given in actions:
            lanes.step(given)
    hit = [info["collision"] for info in lanes.ends]
    assert sum(each is not None for each in hit) >= count // 4
    assert len(set(hit)) >= 3


def test_a_world_knows_its_shapes_by_name() -> None:
    model = mujoco.MjModel.from_xml_string(clutter(1))
    around = read_surroundings(model, "blocks")
    assert isinstance(around.scene, Scene)
    assert sorted(around.names) == sorted(model.geom(geom).name for geom in range(model.ngeom) if geom in still(model))


def still(model: mujoco.MjModel) -> set[int]:
    return set(np.flatnonzero(model.geom_bodyid == 0).tolist())


DRONE = asset("mjcf/quadrotor.xml").read_text()


def own_text(things: str, rest: str = "") -> str:
    return f'<mujoco><include file="quadrotor.xml"/><worldbody>{things}</worldbody>{rest}</mujoco>'


def own_world(things: str, drone: str = DRONE, rest: str = "") -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(own_text(things, rest), {"quadrotor.xml": drone.encode()})


def test_what_may_be_touched_is_what_mujoco_lets_touch() -> None:
    """Whatever its name and the body that it belongs to; layouts place nothing in a world of one's own."""
    ghosts = '<contact><exclude body1="ghost" body2="quadrotor"/></contact>'
    things = """<geom name="clutter_a" size="1"/><geom name="obstacle_b" type="box" size="1 1 1"/>
    <geom name="looks" size="1" contype="0" conaffinity="0"/><geom name="others" size="1" contype="2" conaffinity="2"/>
    <body name="ghost"><geom name="through" size="1"/><body euler="0 30 0"><geom name="inner" size="1"/></body></body>
    <body name="hand" mocap="true"><geom name="put" size="1"/></body>"""
    around = read_surroundings(own_world(things, rest=ghosts), "blocks")
    assert sorted(around.names) == ["clutter_a", "inner", "obstacle_b", "put"]


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('<geom name="post"', '<geom name="post" margin="0.1"'),
        ('<geom name="post"', '<geom name="post" gap="0.1"'),
        ('<geom name="quadrotor_hull"', '<geom name="quadrotor_hull" margin="0.1"'),
        ('<geom name="quadrotor_hull"', '<geom size="0.1" pos="0 0 0.2"/><geom name="quadrotor_hull"'),
        ('<geom name="quadrotor_hull"', '<body><geom size="0.1" mass="0"/></body><geom name="quadrotor_hull"'),
        ('<geom name="quadrotor_hull"', '<geom name="quadrotor_hull" pos="0.1 0 0"'),
        ('<geom name="quadrotor_hull"', '<geom name="quadrotor_hull" euler="90 0 0"'),
        ('type="cylinder" size="0.3418 0.045"', 'type="box" size="0.3 0.3 0.05"'),
        ("<sensor>", '<contact><pair geom1="post" geom2="quadrotor_hull"/></contact><sensor>'),
        ("<sensor>", '<option><flag override="enable"/></option><sensor>'),
        ("<sensor>", '<option><flag contact="disable"/></option><sensor>'),
    ],
)
def test_hulls_and_contacts_that_mujoco_alone_has_are_refused(old: str, new: str) -> None:
    post = '<geom name="post" type="box" size="1 1 1" pos="5 0 0"/>'
    assert read_surroundings(own_world(post), "blocks").names == ("post",)
    assert old in post + DRONE
    with pytest.raises(UserError, match=r"^simulator = kernels: .*; use simulator = mujoco$"):
        read_surroundings(own_world(post.replace(old, new), DRONE.replace(old, new)), "blocks")


SUN = '<light directional="true" dir="0.3 0.2 -1" specular="0 0 0"/>'
POST = '<geom name="post" type="box" size="1 1 1" pos="5 0 0" material="paint"/>'
LOOKS = """<visual><headlight active="0"/><map znear="0.01"/></visual><statistic extent="10"/>
<asset><texture type="skybox" builtin="flat" width="8" height="8"/>
<texture name="checks" type="2d" builtin="checker" width="8" height="8"/>
<material name="paint" rgba="0.9 0.1 0.1 1"/><material name="tiles" texture="checks"/></asset>"""


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('rgba="0.9 0.1 0.1 1"', 'rgba="0.9 0.1 0.1 0.5"', "post has an alpha < 1"),
        ('box" size="1 1 1" pos="5 0 0" material="paint"', 'plane" size="0 5 1" material="tiles"', "give post a size"),
        ('dir="0.3', 'mode="targetbody" target="quadrotor" dir="0.3', "a sun that stands still"),
        ("<camera", SUN + "<camera", "one directional light"),
        ('znear="0.01"', 'znear="0.1"', "znear x extent is 1 m"),
        ('name="front_center"', 'name="front"', "a fixed camera of the drone"),
        ("<camera", '<camera mode="track"', "a fixed camera of the drone"),
        ("<camera", '<camera projection="orthographic"', "a fixed camera of the drone"),
        ('active="0"', 'active="1"', "without a headlight"),
        (' specular="0 0 0"', "", "without gloss: let the sun's specular and each reflectance be 0"),
        ('name="paint"', 'name="paint" reflectance="0.3"', "without gloss"),
        ('directional="true" ', "", "one directional light"),
        ('fovy="58.7155"', 'sensorsize="1 1" focal="1 1" resolution="1 1"', "a fixed camera of the drone"),
    ],
)
def test_looks_that_rays_do_not_have_are_refused(old: str, new: str, said: str) -> None:
    texts = (SUN + POST, DRONE, LOOKS)
    assert any(old in text for text in texts)
    read_looks(own_world(*texts), (64, 36), depth=False)
    things, drone, looks = (text.replace(old, new) for text in texts)
    with pytest.raises(UserError, match=f"simulator: kernels draws .*{said}"):
        read_looks(own_world(things, drone, looks), (64, 36), depth=False)


def test_a_sun_in_a_turned_body_shines_from_there() -> None:
    """Beside a light that is off."""
    turned = f'<light active="false"/><body euler="40 0 70">{SUN}</body>'
    light = read_looks(own_world(turned, rest=LOOKS), (64, 36), depth=False).light
    model = own_world(turned, rest=LOOKS)
    expected = np.zeros(3)
    mujoco.mju_rotVecQuat(expected, model.light_dir[1], model.body_quat[model.light_bodyid[1]])
    np.testing.assert_allclose(light[6:], -expected, atol=1e-6)
    with pytest.raises(UserError, match="a sun that stands still"):
        read_looks(own_world(POST, DRONE.replace("<camera", SUN + "<camera"), LOOKS), (64, 36), depth=False)


@pytest.mark.opengl
def test_textures_lie_on_all_sides_of_boxes_as_in_opengl(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Boxes, upright and turned, that show sides of all axes."""
    boxes = [((3, 2, 1), (0, 0, 115)), ((4, 0, 0.4), (0, 0, -30)), ((3, -2, 1), (90, 20, 0)), ((6, 1, 4), (0, 50, 160))]
    things = "".join(
        f'<geom type="box" size="0.4 0.8 1.2" pos="{" ".join(map(str, place))}" euler="{" ".join(map(str, turn))}" '
        'material="tiles"/>'
        for place, turn in boxes
    )
    (tmp_path / "quadrotor.xml").write_text(DRONE)
    path = tmp_path / "blocks.xml"
    path.write_text(own_text(SUN.replace("spec", 'ambient="0.6 0.6 0.6" spec') + things, LOOKS))
    monkeypatch.setattr(scenes, "scene_path", lambda scene, scenery="plain": path)
    keys: dict[str, Any] = {"observation": "colour", "picture_size": [128, 72], "altitude_m": 2.0}
    with closing(KernelBatch(Pair, 1, threads=1, **keys)) as batch, closing(Pair(**keys)) as alone:
        ours, theirs = batch.reset(seed=0)[0][0].astype(int), alone.reset(seed=0)[0]
    assert np.mean(np.abs(ours - theirs) > 1) < 0.005


def test_what_glows_by_its_material_glows_in_every_shape() -> None:
    """Shapes but planes and boxes have their texture's mean as their colour, and their material's emission as it is."""
    rest = LOOKS.replace('name="tiles"', 'name="tiles" emission="0.5" rgba="1 0.5 0 1"')
    things = POST + '<geom name="ball" size="1" material="tiles"/><geom name="bare" size="1" rgba="1 0 0 1"/>'
    model = own_world(SUN + things, rest=rest)
    looks, rows = read_looks(model, (64, 36), depth=False), read_scene(model, seen=True).shapes[0]
    seen = {model.geom(int(row[at.GEOM])).name: row for row in rows}
    assert int(seen["bare"][at.MATERIAL]) == -1
    assert looks.materials[int(seen["ball"][at.MATERIAL]), EMISSION] == 0.5
    mean = np.mean(model.tex_data[-8 * 8 * 3 :].reshape(-1, 3), axis=0) / 255
    np.testing.assert_allclose(seen["ball"][at.RGB : at.DATA], mean * (1.0, 0.5, 0.0), rtol=1e-6)


def test_what_its_material_makes_invisible_is_not_seen() -> None:
    model = own_world(POST + '<geom name="other" size="1"/>', rest=LOOKS.replace("0.1 1", "0.1 0"))
    assert [model.geom(geom).name for geom in visible(model)] == ["other"]


def test_a_thin_plate_is_touched_where_mujoco_finds_it_touched() -> None:
    """At its rim by tilted drones, and not by level ones of any heading just above it."""
    model = own_world('<geom name="plate" type="box" size="3 3 0.001" pos="0 0 1"/>')
    scene, data, count = read_surroundings(model, "blocks").scene, kinematic(model), 60
    poses, found, bounds = poses_at_touch(model, data, 3, count), np.zeros(count, np.int64), np.zeros(count)
    touch_all(scene, poses, *HULL, found, bounds)
    touched = [bool(contacts(model, data, pose)) for pose in poses]
    assert 0 < sum(touched) < count
    assert (found != NOTHING).tolist() == touched
    half = np.linspace(-1.5, 1.5, count)
    poses[:, 2:] = np.stack([half * 0 + 1.047, np.cos(half), half * 0, half * 0, np.sin(half)], axis=1)
    touch_all(scene, poses, *HULL, found, bounds)
    assert np.all(found == NOTHING)
