"""Navigate over arrays: clutter as scenes, flights and pictures against the exact simulator's, and as tensors."""

from __future__ import annotations

from contextlib import closing
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch as th
from numpy.typing import NDArray

import uavaccel.envs  # noqa: F401 - registers
from tests.host_kernels import host_kernels  # noqa: F401 - a fixture
from tests.lanes import collisions_side_by_side
from tests.test_still_scenes import HULL, cast_all, touch_all
from uavaccel.envs.kernel_batch import KernelBatch
from uavaccel.envs.kernel_games import GameMaker
from uavaccel.envs.navigate import Navigate, NavigateTask
from uavaccel.kernels import scene as at
from uavaccel.sim import clutter as of
from uavaccel.sim.clutter import Clutter, sample_world

LANES = 3
FAST: dict[str, Any] = {"speed_m_s": 6.0, "clutter": {"shapes": 250}, "max_commands": 12}


def actions(random: np.random.Generator, count: int) -> NDArray[np.float32]:
    return random.uniform((0.2, -1.0, -0.3), (1.0, 1.0, 0.3), (count, 3)).astype(np.float32)


def test_the_grid_of_a_world_hides_nothing() -> None:
    """Rays and bounds through the cells are those of all shapes, one after the other."""
    maker, random = GameMaker(NavigateTask(clutter=Clutter(half_m=(0.3, 3.0)))), np.random.default_rng(0)
    games = maker.rows(2)
    drawn = maker.sample(random, 0)
    maker.write(drawn, games, 0)
    parked = [games.solids.shapes[0, 1:, at.BOUND] == 0.0, drawn.layout.rows[:, of.Z] == of.PARKED_Z_M]  # type: ignore[union-attr]
    np.testing.assert_array_equal(*parked)
    seen, solid = (scene._replace(frame=scene.frame.copy()) for scene in (games.scenes, games.solids))
    for each in (seen, solid):
        each.frame[:, at.LOOSE] = each.frame[:, at.SHAPES]
        each.shapes[0, 1:][parked[1], at.CENTRE + 2] = -1e3
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


def test_gaps_are_kept() -> None:
    made = sample_world(3, Clutter(shapes=256, gap_m=1.0), (30.0, 0.0, -2.0))
    rows = made.rows[made.standing]
    reach = np.where(rows[:, of.KIND] == of.BOX, np.hypot(rows[:, of.HALF_X], rows[:, of.HALF_Y]),
                     rows[:, [of.HALF_X, of.HALF_Y]].max(axis=1))  # fmt: skip
    places = rows[:, [of.X, of.Y]]
    apart = np.linalg.norm(places[:, None] - places, axis=2) - reach - reach[:, None]
    assert (apart[~np.eye(len(rows), dtype=bool)] >= 1.0).all()
    assert 50 < len(rows) < sample_world(3, Clutter(shapes=256), (30.0, 0.0, -2.0)).standing.sum()


def test_flights_are_those_of_the_exact_simulator() -> None:
    """The same bytes to the end of each game, and the same names of what was hit."""
    random = np.random.default_rng(1)
    keys = {"observation": "state", "split": "evaluation", **FAST}
    made: Any = gymnasium.make_vec("uavaccel/Navigate-v0", 4, simulator="kernels", **keys)
    with closing(made) as batch:
        assert isinstance(batch, KernelBatch)
        given = (actions(random, 4) for _ in range(1000))
        hit = collisions_side_by_side(batch, [Navigate(**keys) for _ in range(4)], 3, given)
    assert sum(each is not None for each in hit) >= 2


@pytest.mark.opengl
@pytest.mark.parametrize(
    ("kind", "size", "most_apart", "share"),
    [("depth", (64, 36), 1, 0.01), ("colour", (80, 44), 4, 0.02), ("dvs", (64, 36), 1, 0.05)],
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
            given = actions(random, 1)
            ours, theirs = batch.step(given)[0], alone.step(given[0])[0]
    alone.close()
    assert np.mean(apart) <= share


@pytest.mark.parametrize(
    "keys",
    [
        {"observation": "depth", "also_state": True},
        {"observation": "dvs", "picture_size": (32, 20), "dvs_shot_noise_hz": 5.0, "image_noise": 2.0},
    ],
)
@pytest.mark.usefixtures("host_kernels")
def test_a_batch_of_tensors_flies_as_the_cpus(keys: dict[str, Any]) -> None:
    """Worlds, goals and seeds that are dealt on the device are those that the host samples."""
    from uavaccel.envs.cuda_batch import CudaBatch

    keys, random, ends = {**FAST, **keys, "max_commands": 4}, np.random.default_rng(0), 0
    with (
        closing(CudaBatch(Navigate, LANES, **keys)) as batch,
        closing(KernelBatch(Navigate, LANES, autoreset_mode="SameStep", **keys)) as other,
    ):
        assert_equal(batch.reset(seed=5)[0], other.reset(seed=5)[0])
        for _ in range(9):
            given = actions(random, LANES)
            flown, expected = batch.step(th.from_numpy(given)), other.step(given)
            assert_equal(flown[0], expected[0])
            np.testing.assert_allclose(flown[1].numpy(), expected[1], rtol=0, atol=1e-6)
            for tensor, array in zip(flown[2:4], expected[2:4], strict=True):
                np.testing.assert_array_equal(tensor.numpy(), array)
            over = expected[2] | expected[3]
            for lane in np.flatnonzero(over):
                info, theirs = flown[4]["final_info"], expected[4]["final_info"]
                name = batch.object_names[info["collision"][lane]] if info["collision"][lane] >= 0 else None
                assert (name, info["world"][lane]) == (theirs["collision"][lane], theirs["world"][lane])
                np.testing.assert_allclose(info["goal_m"][lane].numpy(), theirs["goal_m"][lane], rtol=1e-14)
            ends += int(over.sum())
        again = batch.reset(options={"world": 7})[0]
        assert_equal(again, other.reset(options={"world": 7})[0])
    assert ends > LANES


def assert_equal(ours: Any, theirs: Any) -> None:
    if not isinstance(theirs, dict):
        ours, theirs = {"seen": ours}, {"seen": theirs}
    for name, array in theirs.items():
        np.testing.assert_array_equal(ours[name].numpy(), array)
