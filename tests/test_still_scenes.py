"""Any still scene as arrays: rays, touches and flights in it, against MuJoCo's own."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit
from numpy.typing import NDArray

from tests.clutter import KINDS, clutter
from uavaccel.envs.hover import Hover
from uavaccel.envs.kernel_batch import KernelBatch
from uavaccel.errors import UserError
from uavaccel.kernels import casting
from uavaccel.kernels import scene as at
from uavaccel.kernels.bodies import read_surroundings
from uavaccel.kernels.scene import Scene, as_seen, empty_scene
from uavaccel.kernels.scene_touching import NOTHING, deepest_shape, nearest_shape
from uavaccel.kernels.still import read_scene
from uavaccel.kernels.worlds import Recipe, count_of, draw_worlds, put_world, worlds_of
from uavaccel.sim.scene import model as scenes

SEEN = np.array([1, 0, 1, 0, 1, 1], np.uint8)  # groups that the drone's camera may see
HULL = (0.3418, 0.045)
FAR_M = 1000.0
TOLERANCE_M = 1e-6  # of MuJoCo's own search for contacts


@njit(error_model="numpy")
def cast_all(scene: Any, origin: Any, rays: Any, distances: Any, items: Any, normals: Any) -> None:
    for ray in range(len(rays)):
        direction = rays[ray, 0], rays[ray, 1], rays[ray, 2]
        from_ = origin[0], origin[1], origin[2]
        distances[ray], items[ray], normal = casting.cast(scene, 0, from_, direction, np.float32(FAR_M))
        normals[ray, 0], normals[ray, 1], normals[ray, 2] = normal


@njit(error_model="numpy")
def touch_all(scene: Any, poses: Any, radius: float, half: float, found: Any, bounds: Any) -> None:
    for pose in range(len(poses)):
        found[pose], _ = deepest_shape(scene, 0, poses[pose], radius, half, (0, 1))
        bounds[pose] = nearest_shape(scene, 0, poses[pose], (0, 1))


def kinematic(model: mujoco.MjModel) -> mujoco.MjData:
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return data


@pytest.mark.parametrize("kind", [*KINDS, "all"])
def test_rays_meet_what_mujocos_rays_meet(kind: str) -> None:
    """Within 1e-4 m and 1e-5 of the distance; but for silhouettes the same object, and its normal."""
    model = mujoco.MjModel.from_xml_string(clutter(3, KINDS if kind == "all" else [kind, "sphere"]))
    scene, data, random = read_scene(model, seen=True), kinematic(model), np.random.default_rng(5)
    others = 0
    for _ in range(8):
        origin = np.array([*random.uniform(-12, 12, 2), random.uniform(1.5, 7.0)], np.float32)
        rays = random.normal(size=(1000, 3)) * (1.0, 1.0, 0.5)
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


@settings(deadline=None, max_examples=12)
@given(st.integers(0, 2**32 - 1))
def test_the_hull_touches_what_mujoco_finds_it_to_touch(seed: int) -> None:
    model = mujoco.MjModel.from_xml_string(clutter(seed, count=24))
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
def test_flights_among_turned_shapes_are_those_of_the_exact_simulator() -> None:
    """The same bytes until the first touch, at the same tick, of the same object."""
    task: dict[str, Any] = {"altitude_m": 2.0, "radius_m": 0.3, "max_commands": 25, "speed_m_s": 3.0}
    count, hit = 8, []
    headings = 2 * np.pi * np.arange(count) / count  # each keeps its way
    actions = np.random.default_rng(3).uniform((-0.4, -0.4, -0.3), (0.4, 0.4, 0.4), (40, count, 3))
    actions[:, :, :2] += 0.6 * np.stack([np.cos(headings), np.sin(headings)], axis=1)
    actions = actions.astype(np.float32)
    with closing(KernelBatch(Hover, count, threads=1, **task)) as batch:
        alone = [Hover(**task) for _ in range(count)]
        batch.reset(seed=7)
        for lane, environment in enumerate(alone):
            environment.reset(seed=7 + lane)
        over = [False] * count
        for each in actions:
            batch.step_async(each)
            seen, rewards, terminated, truncated, infos = batch.step_wait()
            for lane, environment in enumerate(alone):
                if over[lane]:
                    continue
                expected = environment.step(each[lane])
                assert infos[lane] == expected[4]
                assert seen[lane].tobytes() == expected[0].tobytes()
                assert (rewards[lane], terminated[lane], truncated[lane]) == expected[1:4]
                over[lane] = bool(expected[2] or expected[3])
                hit += [expected[4]["collision"]] * over[lane]
        for environment in alone:
            environment.close()
    assert sum(each is not None for each in hit) >= count // 4
    assert len(set(hit)) >= 3


def test_a_world_knows_its_shapes_by_name() -> None:
    model = mujoco.MjModel.from_xml_string(clutter(1))
    around = read_surroundings(model)
    assert isinstance(around.scene, Scene)
    assert sorted(around.names) == sorted(model.geom(geom).name for geom in range(model.ngeom) if geom in still(model))


def still(model: mujoco.MjModel) -> set[int]:
    return set(np.flatnonzero(model.geom_bodyid == 0).tolist())


# --- worlds drawn at random -------------------------------------------------------------------------------


MIXED = Recipe(density=0.12, spheres=1.0, ellipsoids=1.0, gap_m=0.2, half_m=12.0, near_m=10.0, far_m=20.0)


def draw(recipe: Recipe, seeds: list[int], seen: bool = False) -> tuple[Scene, NDArray[np.float64]]:
    scene, ways = worlds_of(recipe, len(seeds), seen), np.zeros((len(seeds), 6))
    draw_worlds(scene, recipe, np.array(seeds), ways)
    return scene, ways


def test_a_world_is_a_function_of_its_seed() -> None:
    scene, ways = draw(MIXED, [5, 8, 5])
    again, same = draw(MIXED, [7, 8])
    assert all((own[0] == own[2]).all() for own in (*scene[:4], ways))
    assert (scene.shapes[1] == again.shapes[1]).all()
    assert (ways[1] == same[1]).all()
    assert not (scene.shapes[0] == scene.shapes[1]).all()
    kinds = [int(kind) for kind in scene.shapes[0, 1 : int(scene.frame[0, at.SHAPES]), at.KIND]]
    assert sorted(set(kinds)) == sorted([at.BOX, at.CYLINDER, at.CAPSULE, at.ELLIPSOID])


def test_start_and_goal_are_free_and_gaps_are_kept() -> None:
    scene, ways = draw(MIXED, list(range(20)))
    for world, way in enumerate(ways):
        shapes = scene.shapes[world, 1 : int(scene.frame[world, at.SHAPES])]
        places = shapes[:, at.CENTRE : at.CENTRE + 2]
        boxes = shapes[:, at.KIND] == at.BOX
        half = shapes[:, at.HALF : at.HALF + 2]
        reach = np.where(boxes, np.linalg.norm(half, axis=1), half.max(axis=1))
        for end in (way[:2], way[3:5]):
            assert (np.linalg.norm(places - end, axis=1) - reach >= MIXED.clear_m).all()
        apart = np.linalg.norm(places[:, None] - places, axis=2) - reach - reach[:, None]
        assert (apart[~np.eye(len(shapes), dtype=bool)] >= MIXED.gap_m).all()
        assert MIXED.near_m - 1e-9 <= np.hypot(*(way[3:5] - way[:2])) <= MIXED.far_m + 1e-9
        assert (shapes[:, at.CENTRE + 2] + shapes[:, at.HALF + 2] <= MIXED.high_m + 1e-9).all()
        assert len(shapes) >= 0.9 * count_of(MIXED)


def test_the_grid_hides_nothing() -> None:
    """Rays and bounds through the cells are those of all shapes, one after the other."""
    scene, _ = draw(MIXED, [3])
    seen = as_seen(scene)
    bare, random = [each._replace(frame=each.frame.copy()) for each in (scene, seen)], np.random.default_rng(0)
    for each in bare:
        each.frame[:, at.LOOSE] = each.frame[:, at.SHAPES]
    rays = random.normal(size=(3000, 3)) * (1.0, 1.0, 0.3)
    rays = (rays / np.linalg.norm(rays, axis=1, keepdims=True)).astype(np.float32)
    for _ in range(4):
        origin = random.uniform((-14, -14, 0.2), (14, 14, 8)).astype(np.float32)
        both = [(np.zeros(3000, np.float32), np.zeros(3000, np.int64), np.zeros((3000, 3), np.float32)) for _ in bare]
        cast_all(seen, origin, rays, *both[0])
        cast_all(bare[1], origin, rays, *both[1])
        assert (both[0][0] == both[1][0]).all()
    poses = np.zeros((400, 7))
    poses[:, :3], poses[:, 3] = random.uniform((-14, -14, 0.1), (14, 14, 8), (400, 3)), 1.0
    found, bounds = np.zeros((2, 400), np.int64), np.zeros((2, 400))
    touch_all(scene, poses, *HULL, found[0], bounds[0])
    touch_all(bare[0], poses, *HULL, found[1], bounds[1])
    assert (found[0] == found[1]).all()
    assert (bounds[0] <= bounds[1]).all()
    assert (bounds[0] >= np.minimum(bounds[1], 2.99 * MIXED.cell_m)).all()


def test_a_scene_becomes_a_world_among_others() -> None:
    model = mujoco.MjModel.from_xml_string(clutter(3, ("box", "sphere"), count=20))
    one, many = read_scene(model), empty_scene(3, 30, 4000, 3000, seen=False)
    put_world(many, 1, one)
    pose = np.array([[3.0, 1.0, 1.5, 1, 0, 0, 0]])
    alone, there = (np.zeros(1, np.int64), np.zeros(1)), (np.zeros(1, np.int64), np.zeros(1))
    touch_all(one, pose, *HULL, *alone)
    touch_all(many._replace(**{name: getattr(many, name)[1:] for name in many._fields[:4]}), pose, *HULL, *there)
    assert (alone[0], alone[1]) == (there[0], there[1])
    with pytest.raises(UserError, match="does not fit"):
        put_world(many, 0, read_scene(mujoco.MjModel.from_xml_string(clutter(3, count=60))))


@pytest.mark.parametrize(
    ("keys", "text"),
    [
        ({"small_m": 0.0}, "small_m"),
        ({"near_m": 40.0}, "near_m"),
        ({"cell_m": 0.0}, "cell_m"),
        ({"boxes": -1.0}, "share"),
    ],
)
def test_recipes_that_ask_for_nothing_are_refused(keys: dict[str, float], text: str) -> None:
    with pytest.raises(UserError, match=text):
        worlds_of(MIXED._replace(**keys), 1)
