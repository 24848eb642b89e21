"""The obstacle lane: how hard it is, what is drawn for it, a lane of one's own, and a way through it."""

from __future__ import annotations

import dataclasses
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import ndimage

from tests.lanes import free_distance_m
from uavaccel.config import load_yaml, validate
from uavaccel.errors import UserError
from uavaccel.kinematics import VelocityGoal
from uavaccel.sim.flight import of_velocity
from uavaccel.sim.lane import (
    LENGTH_M,
    MAX_OBSTACLES,
    SPLIT_SIZE,
    WIDTH_M,
    Difficulty,
    LaneFile,
    LaneLayout,
    Split,
    clearance_m,
    is_walled_off,
    lane_seed,
    layout_from,
    parse_lane,
    sample_layout,
)
from uavaccel.sim.world import World
from uavaccel.suites.lane_path import plan_path
from uavaccel.wire.image_api import lane_layout

EVALUATION_LANES = [sample_layout(lane_seed("evaluation", index)) for index in range(300)]


def equal(a: LaneLayout, b: LaneLayout) -> bool:
    fields = [field.name for field in dataclasses.fields(LaneLayout)]
    return all(np.array_equal(getattr(a, field), getattr(b, field)) for field in fields)


# --- drawn lanes --------------------------------------------------------------------------------------------------


def test_straight_flight_fails() -> None:
    """Straight ahead at most 5 % of 300 evaluation lanes are free, at the best lateral offset at most 10 %."""
    offsets = np.arange(-4.65, 4.66, 0.05)
    free = np.array([[free_distance_m(layout, y) == LENGTH_M for y in offsets] for layout in EVALUATION_LANES])
    assert np.mean([free_distance_m(layout, 0.0) == LENGTH_M for layout in EVALUATION_LANES]) <= 0.05
    assert free.mean(axis=0).max() <= 0.10


@pytest.mark.parametrize(("split", "first"), [("evaluation", 0), ("training", 1_000_000), ("test", 2_000_000)])
def test_a_million_lanes_belong_to_each_split_and_none_to_two(split: Split, first: int) -> None:
    assert [lane_seed(split, index) for index in (0, 1, 999_999)] == [first, first + 1, first + 999_999]
    for index in (-1, SPLIT_SIZE):
        with pytest.raises(ValueError, match="must be at least 0"):
            lane_seed(split, index)


@settings(max_examples=50)
@given(
    seed=st.integers(0, 2**63),
    per_row=st.integers(0, 4),
    first=st.floats(2.0, 30.0),
    spacing=st.floats(3.0, 40.0),
    gap=st.floats(0.8, 2.0),
)
def test_rows_keep_their_distances(seed: int, per_row: int, first: float, spacing: float, gap: float) -> None:
    """From the first up to half a spacing before the end, unless there are too few obstacles for so many."""
    difficulty = Difficulty(
        first_row_m=first, obstacles_per_row=per_row, row_spacing_m=spacing, min_gap_m=gap, half_width_m=0.3
    )
    layout = sample_layout(seed, difficulty)
    wanted = [first + spacing * row for row in range(100) if first + spacing * row < 150.0 - spacing / 2]
    np.testing.assert_allclose(layout.x_m, np.repeat(wanted[: 64 // max(per_row, 1)], per_row))
    assert np.all(np.abs(layout.y_m) <= WIDTH_M / 2)
    assert (layout.half_width_m == 0.3).all()
    assert not layout.round.any()
    if per_row:
        assert np.all(np.diff(layout.y_m.reshape(-1, per_row), axis=1) >= 0.6 + gap - 1e-9)


def drawn(difficulty: Difficulty, count: int = 2000) -> list[LaneLayout]:
    return [sample_layout(seed, difficulty) for seed in range(count)]


def assert_uniform(values: NDArray[np.float64], low: float, high: float) -> None:
    """By its ends, and by the largest distance of the sample's distribution from the straight line."""
    share = np.sort((values - low) / (high - low))
    assert 0.0 <= share[0] < 0.01
    assert 0.99 < share[-1] <= 1.0
    assert np.abs(share - (np.arange(len(share)) + 0.5) / len(share)).max() < 2.0 / len(share) ** 0.5


def test_light_sun_and_wind_are_drawn_evenly() -> None:
    layouts = drawn(Difficulty(light=(0.2, 0.6), wind_m_s=4.0, obstacles_per_row=1, row_spacing_m=100.0))
    assert_uniform(np.array([layout.light for layout in layouts]), 0.2, 0.6)
    assert_uniform(np.array([layout.sun_azimuth_rad for layout in layouts]), -1.0, 1.0)
    north, east, down = np.array([layout.wind_m_s for layout in layouts]).T
    np.testing.assert_allclose(np.hypot(north, east), 4.0)
    assert not down.any()
    assert_uniform(np.arctan2(east, north), -np.pi, np.pi)


@pytest.mark.parametrize(("varied", "share"), [(1.0, 1.0), (0.5, 0.5), (0.0, 0.0)])
def test_a_share_of_the_textures_is_drawn_evenly(varied: float, share: float) -> None:
    layouts = drawn(Difficulty(texture_variation=varied))
    textures = np.concatenate([layout.texture for layout in layouts])
    for indices, kinds in (
        (textures, 4),
        (np.array([layout.wall_texture for layout in layouts]), 2),
        (np.array([layout.ground_texture for layout in layouts]), 2),
    ):
        counts = np.bincount(indices, minlength=kinds) / len(indices)
        wanted = np.full(kinds, share / kinds) + (1 - share) * (np.arange(kinds) == 0)
        np.testing.assert_allclose(counts, wanted, atol=4 * 0.5 / len(indices) ** 0.5)
    walls, grounds = ([getattr(layout, name) for layout in layouts] for name in ("wall_texture", "ground_texture"))
    if share:
        assert abs(np.corrcoef(walls, grounds)[0, 1]) < 0.1


def test_lateral_places_are_uniform_among_those_that_keep_the_gap() -> None:
    """Less the least distance to those before, a row is as many sorted uniform numbers; and rows differ."""
    layouts = drawn(Difficulty(obstacles_per_row=3, half_width_m=0.5, min_gap_m=1.5, row_spacing_m=60.0), 1500)
    rows = np.array([layout.y_m.reshape(-1, 3)[:2] for layout in layouts])
    slack = rows + 5.0 - 2.5 * np.arange(3)
    assert_uniform(slack.ravel(), 0.0, 5.0)
    np.testing.assert_allclose(slack.mean(axis=(0, 1)), 5.0 * np.array([1, 2, 3]) / 4, atol=0.1)
    assert abs(np.corrcoef(slack[:, 0, 1], slack[:, 1, 1])[0, 1]) < 0.1


def test_a_lane_is_walled_off_where_no_way_leads_through() -> None:
    """By filling a grid of places where the hull is free, with 5 cm more or less of room."""
    rng, found = np.random.default_rng(0), Counter[bool]()
    places = np.stack(np.meshgrid(np.linspace(8, 14, 121), np.linspace(-5, 5, 201), indexing="ij"), axis=-1)
    for count in (5, 6, 7) * 10:
        layout = dataclasses.replace(
            layout_from({"obstacles": []}, "test"),
            x_m=rng.uniform(10, 10.6, count),
            y_m=(np.arange(count) + rng.uniform(0, 1, count)) * (10 / count) - 5,
            half_width_m=rng.uniform(0.6, 1.2, count),
            round=rng.random(count) < 0.5,
        )
        room_m = clearance_m(layout, places.reshape(-1, 2)).reshape(places.shape[:2])
        ways = [ndimage.label(room_m > margin_m)[0] for margin_m in (0.05, -0.05)]
        surely, perhaps = (bool({*way[0]} & {*way[-1]} - {0}) for way in ways)
        if surely == perhaps:
            assert is_walled_off(layout) is not surely
            found[surely] += 1
    assert min(found[True], found[False]) > 5


def test_a_row_that_does_not_fit_is_refused() -> None:
    with pytest.raises(UserError, match=r"difficulty\.yaml: .*need 11.4 m; the lane is 10 m wide"):
        validate(Difficulty, {"obstacles_per_row": 4, "min_gap_m": 3.0}, "difficulty.yaml")
    with pytest.raises(UserError, match="need 10 m; the lane is 10 m wide"):
        validate(Difficulty, {"obstacles_per_row": 3, "half_width_m": 0.5, "min_gap_m": 4.0}, "difficulty.yaml")
    assert validate(Difficulty, {"obstacles_per_row": 4, "min_gap_m": 2.5}, "difficulty.yaml")
    assert Difficulty(mass_ratio=1.5), "it can just climb"


# --- a lane of one's own ------------------------------------------------------------------------------------------

WRITTEN = """
obstacles:
  - {x_m: 12, y_m: 0.5, half_side_m: 0.4}
  - {x_m: 20, y_m: -2, radius_m: 0.6, texture: yellow}
wall_texture: brick
ground_texture: grass
light: 0.8
sun_azimuth_rad: -0.3
wind_m_s: [1, -2, 0.5]
"""


def test_a_lane_of_ones_own_or_one_that_says_little(tmp_path: Path) -> None:
    path = tmp_path / "lane.yaml"
    path.write_text(WRITTEN)
    expected = LaneLayout(
        x_m=np.array([12.0, 20.0]), y_m=np.array([0.5, -2.0]), half_width_m=np.array([0.4, 0.6]),
        round=np.array([False, True]), texture=np.array([0, 2]), wall_texture=1, ground_texture=1,
        light=0.8, sun_azimuth_rad=-0.3, wind_m_s=(1.0, -2.0, 0.5),
    )  # fmt: skip
    assert equal(layout_from(load_yaml(path), str(path)), expected)
    lane = parse_lane(str(path))
    assert isinstance(lane, LaneFile)
    assert equal(lane_layout(lane.model_dump()), expected)
    assert parse_lane(load_yaml(path)) == lane
    path.write_text(WRITTEN.replace("radius_m", "radius"))
    with pytest.raises(UserError, match=r"lane\.yaml: .*obstacles.1.radius"):
        parse_lane(str(path))

    layout = layout_from({"obstacles": []}, "bright, calm and plain")
    assert (layout.light, layout.wind_m_s, layout.sun_azimuth_rad) == (1.0, (0.0, 0.0, 0.0), 0.5)
    assert (layout.wall_texture, layout.ground_texture, len(layout)) == (0, 0, 0)


def test_a_lane_is_a_seed_a_seed_with_a_difficulty_or_a_mapping() -> None:
    assert equal(lane_layout(5), sample_layout(5))
    assert equal(lane_layout({"seed": 5}), sample_layout(5))
    windy = {"seed": 5, "difficulty": {"wind_m_s": 3.0}}
    assert equal(lane_layout(windy), sample_layout(5, Difficulty(wind_m_s=3.0)))
    assert parse_lane(windy) is windy
    assert parse_lane(5) == 5
    for wrong in (True, 1.5, {"seed": "a"}):
        with pytest.raises(ValueError, match="a lane is a seed"):
            lane_layout(wrong)
    with pytest.raises(UserError, match=r"difficulty: .*wind_m_s"):
        lane_layout({"seed": 5, "difficulty": {"wind_m_s": -1.0}})


@pytest.mark.parametrize(("mapping", "said"), [
    ({}, "key 'obstacles' is missing"),
    ({"obstacles": [], "lihgt": 1}, "did you mean 'light'"),
    ({"obstacles": [{"x_m": 9, "y_m": 0}]}, "obstacles.0 = .*radius_m"),
    ({"obstacles": [{"x_m": 9, "y_m": 0, "radius_m": 1, "half_side_m": 1}]}, "obstacles.0 = .*radius_m"),
    ({"obstacles": [{"x_m": 9, "y_m": "left", "radius_m": 1}]}, "obstacles.0.y_m"),
    ({"obstacles": [{"x_m": 151, "y_m": 0, "radius_m": 1}]}, "obstacles.0.x_m"),
    ({"obstacles": [{"x_m": 9, "y_m": -5.1, "radius_m": 1}]}, "obstacles.0.y_m"),
    ({"obstacles": [], "sun_azimuth_rad": 1e300}, "sun_azimuth_rad"),
    ({"obstacles": [{"x_m": 0.7, "y_m": 0, "radius_m": 0.4}]}, "within 0.3418 m of the start"),
    ({"obstacles": [{"x_m": 9, "y_m": 0, "radius_m": 1}] * (MAX_OBSTACLES + 1)}, "at most 64"),
])  # fmt: skip
def test_a_wrong_lane_is_refused(mapping: dict[str, Any], said: str) -> None:
    with pytest.raises(UserError, match=f"lane.yaml: .*{said}"):
        layout_from(mapping, "lane.yaml")


# --- a way through ----------------------------------------------------------------------------------------------------


def evaluation_lane(index: int) -> LaneLayout:
    return sample_layout(lane_seed("evaluation", index))


def fly(commands: list[tuple[float, float]], height_m: float, command_s: float) -> NDArray[np.float64]:
    """Places (n, 2) north and east every 10 ms of SimpleFlight's linear answer to the commands, by small steps.

    tilt_goal = k (u - v) / (1 + k height), tilt' = (tilt_goal - tilt) / 0.2 s, v' = g tilt - 0.008 v.
    """
    gain, step_s = 0.2 * np.pi / 5.5, 0.005
    place, velocity, tilt = np.zeros((3, 2))
    places = []
    for command in np.array(commands):
        for step in range(round(command_s / step_s)):
            goal = gain * (command - velocity) / (1 + gain * height_m)
            place = place + step_s * velocity
            velocity, tilt = (
                velocity + step_s * (9.80665 * tilt - 0.008 * velocity),
                tilt + step_s * (goal - tilt) / 0.2,
            )
            if step % 2 == 1:
                places.append(place)
    return np.array(places)


@pytest.mark.parametrize(
    ("index", "height_m", "margin_m", "command_s"),
    [(10, 10.0, 0.25, 1.0), (150, 3.0, 0.4, 1.0), (290, 10.0, 0.25, 0.5), (3, 10.0, 0.25, 0.1)],
)
def test_a_planned_path_keeps_its_margin_and_arrives(
    index: int, height_m: float, margin_m: float, command_s: float
) -> None:
    layout = evaluation_lane(index)
    plan = plan_path(layout, height_m, margin_m, command_s)
    assert plan == plan_path(layout, height_m, margin_m, command_s)
    np.testing.assert_allclose(np.hypot(*np.array(plan).T), 1.0)
    places = fly(plan, height_m, command_s)
    assert clearance_m(layout, places).min() > margin_m - 0.06  # it looks every fifth of a command
    step_s = max(command_s, 0.5)
    ends = places[:: round(step_s * 100), 0]
    assert places[-1, 0] == pytest.approx(LENGTH_M, abs=1.1 * step_s)
    assert places[-1, 0] > LENGTH_M - 0.1
    assert ends[-1] < LENGTH_M


@pytest.mark.parametrize("index", range(5, 300, 60))
def test_every_lane_has_a_path(index: int) -> None:
    """Five headings at 1 m/s and SimpleFlight's slow answer at 10 m, where it is slowest, are enough."""
    assert 150 <= len(plan_path(evaluation_lane(index))) <= 175


def test_a_path_is_straight_or_keeps_off_where_there_is_room() -> None:
    empty = layout_from({"obstacles": []}, "test")
    assert set(plan_path(empty)) == {(1.0, 0.0)}
    beside = layout_from({"obstacles": [{"x_m": 40.0, "y_m": 1.0, "half_side_m": 0.3}]}, "test")
    places = fly(plan_path(beside, margin_m=0.05), 10.0, 1.0)
    nearest = clearance_m(beside, places).min()
    assert places[:, 1].min() < -0.1
    assert nearest > 0.5  # of 0.36 straight ahead


@pytest.mark.parametrize("gap_m", [1.4, 2.0])
def test_a_gap_is_taken_up_to_the_margin_and_no_further(gap_m: float) -> None:
    """Straight ahead the hull, of 0.3418 m, has the rest of half a gap to either side, which is the most there is."""
    there_is_m = gap_m / 2 - 0.3418
    posts = [{"x_m": 20.0, "y_m": side * (gap_m / 2 + 2.0), "half_side_m": 2.0} for side in (-1, 1)]
    layout = layout_from({"obstacles": posts}, "test")
    places = fly(plan_path(layout, margin_m=there_is_m - 0.01), 10.0, 1.0)
    assert clearance_m(layout, places).min() == pytest.approx(there_is_m, abs=0.02)
    with pytest.raises(UserError, match="no path through this lane keeps"):
        plan_path(layout, margin_m=there_is_m + 0.01)


def test_the_simulator_flies_a_planned_path_to_the_end(lane_world: World) -> None:
    layout = evaluation_lane(0)
    lane_world.set_lane(layout)
    lane_world.reset()
    clearance = []
    for north, east in plan_path(layout, height_m=10.0):
        lane_world.lead.set_goal(of_velocity(VelocityGoal((north, east, 0.0), height_m=-10.0, yaw_is_rate=False)))
        for _ in range(4):
            lane_world.advance(125)
            clearance.append(clearance_m(layout, lane_world.lead.kinematics().position_m[:2]))
    assert lane_world.lead.collision_tick is None
    assert lane_world.lead.kinematics().position_m[0] >= LENGTH_M
    assert min(clearance) > 0.2
