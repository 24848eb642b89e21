"""Navigate: worlds of clutter, the goal, and what ends a game."""

from contextlib import closing
from typing import Any

import numpy as np
import pytest

import uavaccel.envs  # noqa: F401 - registers
from tests.scenes import assert_bounded
from tests.test_still_scenes import HULL, cast_all, touch_all
from uavaccel.envs.kernel_batch import KernelBatch
from uavaccel.envs.kernel_games import GameMaker
from uavaccel.envs.navigate import Navigate, NavigateTask
from uavaccel.envs.observer import Onlooker
from uavaccel.envs.values import AT_REST
from uavaccel.kernels import fields
from uavaccel.kernels import scene as in_scene
from uavaccel.kernels.bodies import read_scene
from uavaccel.kernels.clutter_games import put_clutter
from uavaccel.rl.agents import reset_options
from uavaccel.sim import clutter as at
from uavaccel.sim.clutter import Clutter, sample_world
from uavaccel.sim.profile import PROFILES
from uavaccel.sim.world import World

GOAL_M = (30.0, 5.0, -2.0)


def test_a_world_is_a_function_of_its_seed() -> None:
    once, again, other = (sample_world(seed, Clutter(), GOAL_M).rows for seed in (3, 3, 4))
    assert once.tobytes() == again.tobytes() != other.tobytes()
    assert (at.BOX, at.CYLINDER) == (fields.BOX, fields.CYLINDER)
    assert reset_options("uavaccel/Navigate-v0", 3) == {"world": 3}, "which an evaluation flies as its game 3"


@pytest.mark.parametrize("gap_m", [0.0, 1.5])
def test_a_shape_is_nine_numbers_and_stands_where_there_is_room(gap_m: float) -> None:
    """Each key of the distribution by its own share of NumPy's numbers; start, goal and gaps are kept clear."""
    shares = {"boxes": 0.8, "cylinders": 0.6, "ellipsoids": 0.4, "spheres": 0.2}
    keys: dict[str, Any] = {"half_m": (0.3, 3.0), "clear_start_m": 9.0, "clear_goal_m": 7.0, "gap_m": gap_m}
    made = sample_world(1, Clutter(shapes=200, **keys, **shares), GOAL_M)
    share, x, y, *halves, z, turn, grey = np.random.default_rng(1).random((200, 9)).T
    kind = np.array(["box", "cylinder", "ellipsoid", "sphere"])[np.searchsorted([0.4, 0.7, 0.9], share, "right")]
    box, pillar, round_ = kind == "box", np.isin(kind, ["box", "cylinder"]), np.isin(kind, ["cylinder", "sphere"])
    half_x, half_y, half_z = (0.3 + 2.7 * half for half in halves)
    half_y, x, y = np.where(round_, half_x, half_y), -4.0 + 48.0 * x, -24.0 + 48.0 * y
    half_z = np.select([pillar, kind == "sphere"], [5.0, 0.0], half_z)
    yaw = np.where(round_, 0.0, 2.0 * np.arctan(np.tan(np.pi / 8) * (2.0 * turn - 1.0)))
    stands = np.ones(200, bool)
    for north, west, clear_m in ((0.0, 0.0, 9.0), (30.0, -5.0, 7.0)):
        right, up = north - x, west - y
        along, across = abs(np.cos(yaw) * right + np.sin(yaw) * up), abs(np.cos(yaw) * up - np.sin(yaw) * right)
        from_box = np.hypot(np.maximum(along - half_x, 0.0), np.maximum(across - half_y, 0.0))
        stands &= np.where(box, from_box, np.hypot(along, across) - np.maximum(half_x, half_y)) >= clear_m
    reach = np.where(box, np.hypot(half_x, half_y), np.maximum(half_x, half_y))
    for later in range(200 if gap_m else 0):
        before = np.flatnonzero(stands[:later])
        room = np.hypot(x[later] - x[before], y[later] - y[before]) - reach[later] - reach[before]
        stands[later] &= not (room < gap_m).any()
    height = np.where(stands, np.where(pillar, 5.0, 0.5 + 4.5 * z), at.PARKED_Z_M)
    expected = [x, y, height, half_x, half_y, half_z, np.cos(yaw), np.sin(yaw), 0.25 + 0.7 * grey]
    assert (made.names(), made.standing.tolist()) == (kind.tolist(), stands.tolist())
    np.testing.assert_allclose(made.rows[:, at.X :], np.stack(expected, axis=1), atol=1e-12)


def test_mujoco_has_the_shapes_where_the_layout_has_them() -> None:
    import mujoco

    world, made = World("clutter", PROFILES["native"]), sample_world(3, Clutter(), GOAL_M)
    world.set_clutter(sample_world(4, Clutter(shapes=200), GOAL_M))  # of which nothing is left
    world.set_clutter(made)
    assert_bounded(world.model)
    gone = [world.model.geom(f"clutter_{number:03}") for number in range(len(made), 256)]
    assert {(float(geom.pos[2]), float(geom.rgba[3])) for geom in gone} == {(at.PARKED_Z_M, 0.0)}
    for name, row in zip(range(len(made)), made.rows, strict=True):
        geom = world.data.geom(f"clutter_{name:03}")
        assert np.allclose(geom.xmat.reshape(3, 3)[:2, 0], row[[at.COS, at.SIN]], atol=1e-12)
        assert (geom.xpos == row[at.X : at.Z + 1]).all()
        radii = row[[at.HALF_X] * 3] if row[at.KIND] == at.CAPSULE else row[at.HALF_X : at.HALF_Z + 1]
        np.testing.assert_allclose(world.model.geom_aabb[geom.id, 3:], radii)
    games = GameMaker(NavigateTask()).rows(1)
    put_clutter(made.rows, games.solids, games.scenes, 0)
    standing = np.flatnonzero(made.standing)
    geoms = np.array([world.model.geom(f"clutter_{number:03}").id for number in standing])
    read, put = read_scene(world.model, geoms=geoms), games.solids.shapes[0, -len(made.rows) :][standing]
    of_geom = dict(zip(read.shapes[0, :, in_scene.GEOM].astype(int).tolist(), read.shapes[0], strict=True))
    for geom, shape in zip(geoms.tolist(), put, strict=True):
        wide, deep = shape[in_scene.HALF : in_scene.HALF + 2]
        assert shape[in_scene.REACH] > (np.hypot(wide, deep) if shape[in_scene.KIND] == at.BOX else max(wide, deep))
        for part in (in_scene.KIND, in_scene.BOUND, slice(in_scene.CENTRE, in_scene.RGB)):
            np.testing.assert_allclose(shape[part], of_geom[geom][part], atol=1e-9)
    row = made.rows[made.standing & (made.rows[:, at.KIND] == at.CYLINDER)][0]
    hit = np.zeros(1, np.int32)
    start = row[[at.X, at.Y]] - (3.0, 0.0)
    mujoco.mj_kinematics(world.model, world.data)
    far = mujoco.mj_ray(world.model, world.data, [*start, 8.0], [1.0, 0.0, 0.0], None, 1, -1, hit)
    assert far <= 3.0 - row[at.HALF_X] + 1e-12


@pytest.mark.parametrize(("metres", "told"), [(7.5, 0.5), (29.0, 29.0 / 15.0), (45.0, 2.0)])
def test_a_goals_distance_is_told_in_15_m_up_to_2(metres: float, told: float) -> None:
    assert NavigateTask().fields(AT_REST, {"goal_m": [0.0, metres, 0.0]})[3] == pytest.approx(told)


def test_a_drone_that_flies_at_a_pillar_collides_with_it_by_name() -> None:
    env = Navigate(observation="state", split="evaluation", clutter={"boxes": 1, "cylinders": 0, "ellipsoids": 0,
                   "spheres": 0, "shapes": 256, "half_m": [0.8, 0.8]})  # fmt: skip
    env.reset(seed=1)
    over, info = False, dict[str, object]()
    while not over:
        _, reward, over, late, info = env.step(np.array([1.0, 0.0, 0.0], np.float32))
        assert not late
    assert str(info["collision"]).startswith("clutter_")
    assert reward < -4.0
    env.close()


@pytest.mark.opengl
@pytest.mark.parametrize("kind", ["depth", "colour", "dvs"])
@pytest.mark.parametrize(("size", "shape"), [((64, 36), (36, 64)), ((80, 40), (40, 80)), ((256, 144), (36, 64))])
def test_pictures_have_the_size_that_is_asked_for(kind: str, size: tuple[int, int], shape: tuple[int, int]) -> None:
    """And films show whole ones, whatever that is."""
    env, onlooker = Navigate(observation=kind, picture_size=list(size)), Onlooker()
    env.add_observer(onlooker)
    seen, _ = env.reset(seed=1)
    assert seen.shape[1:] == shape
    for _ in range(2):
        seen = env.step(np.array([1.0, 0.0, 0.0], np.float32))[0]
    assert env.observation_space.contains(seen)
    assert seen.std() > 0.3
    assert {sample.image.shape for sample in onlooker.samples} == {(144, 256)}
    env.close()


# --- over arrays -----------------------------------------------------------------------------------------------------


def test_the_grid_of_a_world_hides_nothing() -> None:
    """Rays and bounds through the cells are those of all shapes, one after the other."""
    maker, random = GameMaker(NavigateTask(clutter=Clutter(half_m=(0.3, 3.0)))), np.random.default_rng(0)
    games = maker.rows(2)
    drawn = maker.sample(random, 0)
    maker.write(drawn, games, 0)
    parked = [games.solids.shapes[0, 1:, in_scene.BOUND] == 0.0, drawn.layout.rows[:, at.Z] == at.PARKED_Z_M]  # type: ignore[union-attr]
    np.testing.assert_array_equal(*parked)
    seen, solid = (scene._replace(frame=scene.frame.copy()) for scene in (games.scenes, games.solids))
    for each in (seen, solid):
        each.frame[:, in_scene.LOOSE] = each.frame[:, in_scene.SHAPES]
        each.shapes[0, 1:][parked[1], in_scene.CENTRE + 2] = -1e3
    rays = random.normal(size=(2000, 3)) * (1.0, 1.0, 0.3)
    rays = (rays / np.linalg.norm(rays, axis=1, keepdims=True)).astype(np.float32)
    for _ in range(4):
        origin = random.uniform((-4, -20, 0.2), (40, 20, 8)).astype(np.float32)
        through, all_ = (
            (np.zeros(2000, np.float32), np.zeros(2000, np.int64), np.zeros((2000, 3), np.float32)) for _ in range(2)
        )
        cast_all(games.scenes, origin, rays, *through)
        cast_all(seen, origin, rays, *all_)
        np.testing.assert_array_equal(through[0], all_[0])
    poses = np.zeros((300, 7))
    poses[:, :3], poses[:, 3] = random.uniform((-4, -24, 0.1), (44, 24, 8), (300, 3)), 1.0
    found, bounds = np.zeros((2, 300), np.int64), np.zeros((2, 300))
    for row, scene in enumerate((games.solids, solid)):
        touch_all(scene, poses, *HULL, found[row], bounds[row])
    np.testing.assert_array_equal(*(found >= 0))  # of several that are touched as deeply, any may be named
    assert (bounds[0] <= bounds[1]).all()


@pytest.mark.opengl
@pytest.mark.parametrize(
    ("kind", "size", "most_apart", "share"),
    [("depth", (64, 36), 1, 0.01), ("colour", (80, 44), 1, 0.02), ("dvs", (64, 36), 0, 0.01)],
)
def test_pictures_are_nearly_those_of_opengl(kind: str, size: tuple[int, int], most_apart: int, share: float) -> None:
    random = np.random.default_rng(2)
    keys: dict[str, Any] = {"observation": kind, "picture_size": size, "also_state": True}
    alone = Navigate(**keys)
    with closing(KernelBatch(Navigate, 1, **keys)) as batch:
        ours, theirs, apart = batch.reset(seed=4)[0], alone.reset(seed=4)[0], []
        for _ in range(4):
            assert ours["image"].shape[1:] == theirs["image"].shape
            assert ours["state"][0].tobytes() == theirs["state"].tobytes()
            apart.append(np.abs(ours["image"][0].astype(int) - theirs["image"]) > most_apart)
            given = random.uniform((0.2, -1.0, -0.3), (1.0, 1.0, 0.3), (1, 3)).astype(np.float32)
            ours, theirs = batch.step(given)[0], alone.step(given[0])[0]
    alone.close()
    assert np.mean(apart) <= share


def test_a_games_first_picture_is_its_own_whichever_games_begin_with_it() -> None:
    keys: Any = {"clutter": {"shapes": 250}, "observation": "depth", "picture_size": [32, 20], "threads": 1}
    with (
        closing(KernelBatch(Navigate, 3, autoreset_mode="Disabled", **keys)) as batch,
        closing(KernelBatch(Navigate, 1, **keys)) as alone,
    ):
        before, _ = batch.reset(seed=3)
        seen, _ = batch.reset(seed=[7, 8, 9], options={"reset_mask": np.array([False, True, True])})
        expected = [before[0], *(alone.reset(seed=seed)[0][0] for seed in (8, 9))]
        for lane, picture in enumerate(expected):
            np.testing.assert_array_equal(seen[lane], picture)
        assert len({picture.tobytes() for picture in expected}) == 3
