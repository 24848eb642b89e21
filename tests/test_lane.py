"""The obstacle lane: how hard it is, that it can be flown, and that its obstacles are where the layout says."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from uavaccel.config import validate
from uavaccel.errors import UserError
from uavaccel.kinematics import VelocityGoal
from uavaccel.resources import asset
from uavaccel.sim.lane import path as lane_path
from uavaccel.sim.lane.file import layout_from, load_layout
from uavaccel.sim.lane.layout import (
    EVALUATION_SEEDS,
    HULL_RADIUS_M,
    LENGTH_M,
    MAX_OBSTACLES,
    WIDTH_M,
    Difficulty,
    LaneLayout,
    blocked,
    clearance_m,
    draw_layout,
    free_distance_m,
    lane_seed,
)
from uavaccel.sim.lane.path import plan_path
from uavaccel.sim.lane.scene import apply_layout, collision_object, obstacle_geoms
from uavaccel.sim.profile import NATIVE
from uavaccel.sim.world import World

Scene = tuple[mujoco.MjModel, mujoco.MjData]
EVALUATION_LANES = [draw_layout(lane_seed("evaluation", index)) for index in range(300)]


@pytest.fixture(scope="module")
def scene() -> Scene:
    model = mujoco.MjModel.from_xml_path(str(asset("mjcf/lane.xml")))
    return model, mujoco.MjData(model)


def one_post(x_m: float, y_m: float, half_width_m: float = 0.4, cylinder: bool = False) -> LaneLayout:
    shape = "radius_m" if cylinder else "half_side_m"
    return layout_from({"obstacles": [{"x_m": x_m, "y_m": y_m, shape: half_width_m}]}, "test")


def equal(a: LaneLayout, b: LaneLayout) -> bool:
    fields = [field.name for field in dataclasses.fields(LaneLayout)]
    return all(np.array_equal(getattr(a, field), getattr(b, field)) for field in fields)


def test_straight_flight_fails() -> None:
    """Straight ahead at most 5 % of 300 evaluation lanes are free, at the best lateral offset at most 10 %."""
    offsets = np.arange(-4.65, 4.66, 0.05)
    free = np.array([[not blocked(layout, y) for y in offsets] for layout in EVALUATION_LANES])
    assert np.mean([not blocked(layout, 0.0) for layout in EVALUATION_LANES]) <= 0.05
    assert free.mean(axis=0).max() <= 0.10


@pytest.mark.parametrize("index", range(0, 300, 10))
def test_every_lane_has_a_path(index: int) -> None:
    """Five headings at 1 m/s and SimpleFlight's slow answer at 10 m, where it is slowest, are enough."""
    layout = EVALUATION_LANES[index]
    plan = plan_path(layout)
    assert 150 <= len(plan) <= 175
    assert {round(float(np.hypot(*command)), 9) for command in plan} == {lane_path.SPEED_M_S}
    assert plan == plan_path(layout)


def test_the_simulator_flies_a_planned_path_to_the_end() -> None:
    world = World("lane", NATIVE)
    layout = EVALUATION_LANES[0]
    world.set_lane(layout)
    world.reset()
    clearance = []
    for north, east in plan_path(layout, height_m=10.0):
        world.fly_velocity(VelocityGoal((north, east, 0.0), height_m=-10.0, yaw_is_rate=False))
        for _ in range(4):
            world.advance(125)
            clearance.append(clearance_m(layout, world.kinematics().position_m[:2]))
    assert world.collision_tick is None
    assert world.kinematics().position_m[0] >= LENGTH_M
    assert min(clearance) > 0.2


def test_a_walled_off_lane_has_no_path() -> None:
    posts = [{"x_m": 20.0, "y_m": y, "half_side_m": 1.0} for y in range(-4, 5, 2)]
    with pytest.raises(UserError, match="no path"):
        plan_path(layout_from({"obstacles": posts}, "test"))


def test_layouts_are_reproducible_and_differ_by_seed() -> None:
    assert equal(draw_layout(7), draw_layout(7))
    assert not equal(draw_layout(7), draw_layout(8))
    assert not equal(draw_layout(7), draw_layout(7, Difficulty(row_spacing_m=6.0)))


def test_no_lane_is_in_both_splits() -> None:
    evaluation = {lane_seed("evaluation", index) for index in (0, 1, EVALUATION_SEEDS - 1)}
    training = {lane_seed("training", index) for index in (0, 1, EVALUATION_SEEDS - 1)}
    assert max(evaluation) < min(training)
    with pytest.raises(ValueError, match="must be at least 0"):
        lane_seed("evaluation", EVALUATION_SEEDS)


@settings(max_examples=50, deadline=None)
@given(
    seed=st.integers(0, 2**63),
    per_row=st.integers(0, 4),
    spacing=st.floats(3.0, 40.0),
    gap=st.floats(0.8, 2.0),
)
def test_rows_keep_their_distances(seed: int, per_row: int, spacing: float, gap: float) -> None:
    difficulty = Difficulty(obstacles_per_row=per_row, row_spacing_m=spacing, min_gap_m=gap, half_width_m=0.3)
    layout = draw_layout(seed, difficulty)
    assert len(layout) <= MAX_OBSTACLES
    assert np.all(np.abs(layout.y_m) <= WIDTH_M / 2)
    assert np.all(layout.x_m < LENGTH_M)
    if per_row:
        rows = layout.y_m.reshape(-1, per_row)
        assert np.all(np.diff(rows, axis=1) >= 0.6 + gap - 1e-9)
        assert np.allclose(np.diff(layout.x_m[::per_row]), spacing)


def test_difficulty_sets_light_textures_and_wind() -> None:
    plain = draw_layout(3, Difficulty(light=(1.0, 1.0), texture_variation=0.0))
    assert plain.light == 1.0
    assert not plain.texture.any()
    assert plain.wind_m_s == (0.0, 0.0, 0.0)
    assert np.hypot(*draw_layout(3, Difficulty(wind_m_s=4.0)).wind_m_s[:2]) == pytest.approx(4.0)


def test_a_row_that_does_not_fit_is_refused() -> None:
    with pytest.raises(UserError, match=r"difficulty\.yaml: .*need .* m; the lane is 10 m wide"):
        validate(Difficulty, {"obstacles_per_row": 4, "min_gap_m": 3.0}, "difficulty.yaml")


@pytest.mark.parametrize("cylinder", [False, True])
def test_free_distance_is_where_mujoco_finds_the_contact(scene: Scene, cylinder: bool) -> None:
    model, data = scene
    layout = one_post(30.0, 1.0, cylinder=cylinder)
    apply_layout(model, data, layout)
    for offset in (0.3, 0.5, 1.0, 1.6):
        touch = free_distance_m(layout, offset)
        assert clearance_m(layout, (touch, offset)) == pytest.approx(0.0, abs=1e-9)
        for north, found in ((touch - 0.02, ""), (touch + 0.02, "obstacle_00")):
            assert place_and_step(model, data, north, offset) == found


def test_free_distance_beside_everything() -> None:
    layout = one_post(30.0, 1.0)
    assert free_distance_m(layout, 1.0 + 0.4 + HULL_RADIUS_M + 0.001) == LENGTH_M
    assert free_distance_m(layout, 4.9) == 0.0


def place_and_step(
    model: mujoco.MjModel, data: mujoco.MjData, x_m: float, y_m: float, z_m: float = -10.0
) -> str:
    """Name of what the drone touches when it is at a NED place."""
    data.qpos[:7] = (x_m, -y_m, -z_m, 1.0, 0.0, 0.0, 0.0)
    data.qvel[:] = 0.0
    mujoco.mj_step(model, data)
    assert (data.sensor("collision").data[0] > 0) == bool(collision_object(model, data))
    return collision_object(model, data)


def test_walls_and_ground_are_hit_and_named(scene: Scene) -> None:
    model, data = scene
    apply_layout(model, data, draw_layout(0))
    assert place_and_step(model, data, 3.0, 4.7) == "wall_east"
    assert place_and_step(model, data, 3.0, -4.7) == "wall_west"
    assert place_and_step(model, data, 3.0, 0.0, z_m=-0.02) == "ground"
    assert place_and_step(model, data, 3.0, 0.0) == ""


def test_every_obstacle_of_a_new_layout_is_hit_where_it_stands(scene: Scene) -> None:
    """MuJoCo's tree of bounding boxes follows the obstacles: none is missed, and nothing is left behind."""
    model, data = scene
    for seed in (1, 2):
        layout = draw_layout(seed)
        apply_layout(model, data, layout)
        for index, (x, y) in enumerate(zip(layout.x_m, layout.y_m, strict=True)):
            assert (
                place_and_step(model, data, x - 0.6, float(np.clip(y, -4.4, 4.4))) == f"obstacle_{index:02d}"
            )
    apply_layout(model, data, layout_from({"obstacles": []}, "test"))
    assert all(
        place_and_step(model, data, x, y) == ""
        for x, y in zip(layout.x_m, layout.y_m.clip(-4, 4), strict=True)
    )


def test_a_flight_ends_at_the_step_of_the_collision() -> None:
    world = World("lane", NATIVE)
    layout = one_post(3.0, 0.0)
    world.set_lane(layout)
    world.reset()
    world.fly_velocity(VelocityGoal((1.0, 0.0, 0.0)))
    world.advance(5000)
    assert world.collision_tick is not None
    assert world.collision_object == "obstacle_00"
    assert world.kinematics().position_m[0] == pytest.approx(free_distance_m(layout, 0.0), abs=0.02)


def test_a_layout_survives_the_reset_of_the_data(scene: Scene) -> None:
    model, data = scene
    apply_layout(model, data, one_post(30.0, 1.0))
    mujoco.mj_resetData(model, data)
    assert place_and_step(model, data, 29.5, 1.0) == "obstacle_00"


def test_too_many_obstacles_and_other_scenes_are_refused(scene: Scene) -> None:
    blocks = mujoco.MjModel.from_xml_path(str(asset("mjcf/blocks.xml")))
    assert len(obstacle_geoms(scene[0])) == MAX_OBSTACLES
    with pytest.raises(UserError, match="the scene 0"):
        apply_layout(blocks, mujoco.MjData(blocks), draw_layout(0))


def test_a_layout_of_ones_own(tmp_path: Path) -> None:
    path = tmp_path / "lane.yaml"
    path.write_text(
        "obstacles:\n"
        "  - {x_m: 12, y_m: 0.5, half_side_m: 0.4}\n"
        "  - {x_m: 20, y_m: -2, radius_m: 0.6, texture: yellow}\n"
        "light: 0.8\n"
    )
    layout = load_layout(path)
    assert layout.round.tolist() == [False, True]
    assert layout.half_width_m.tolist() == [0.4, 0.6]
    assert layout.texture.tolist() == [0, 2]
    assert layout.light == 0.8


@pytest.mark.parametrize(
    ("mapping", "said"),
    [
        ({}, "key 'obstacles' is missing"),
        ({"obstacles": [], "lihgt": 1}, "did you mean 'light'"),
        ({"obstacles": [{"x_m": 9, "y_m": 0}]}, "obstacles.0 = .*radius_m"),
        ({"obstacles": [{"x_m": 9, "y_m": "left", "radius_m": 1}]}, "obstacles.0.y_m"),
        ({"obstacles": [{"x_m": 0.5, "y_m": 0, "radius_m": 0.4}]}, "within 0.3418 m of the start"),
        ({"obstacles": [{"x_m": 9, "y_m": 0, "radius_m": 1}] * (MAX_OBSTACLES + 1)}, "at most 64"),
    ],
)
def test_a_wrong_layout_is_refused(mapping: dict[str, object], said: str) -> None:
    with pytest.raises(UserError, match=f"lane.yaml: .*{said}"):
        layout_from(mapping, "lane.yaml")
