"""What a layout says reaches the scene: contacts where obstacles stand, wind that blows, light and colours seen."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from tests.lanes import collision_object, free_distance_m
from tests.scenes import COLUMNS, ROWS, Pose, Scene, assert_bounded, cast_rays, object_names
from uavaccel.errors import UserError
from uavaccel.resources import asset
from uavaccel.sim.lane import (
    HULL_RADIUS_M,
    MAX_OBSTACLES,
    Difficulty,
    LaneLayout,
    apply_layout,
    clearance_m,
    layout_from,
    obstacle_geoms,
    sample_layout,
)
from uavaccel.sim.objects import SceneObjects
from uavaccel.sim.profile import NATIVE
from uavaccel.sim.vehicle.autopilot import RATE, VELOCITY, Goal
from uavaccel.sim.world import World

START = Pose((0.0, 0.0, -10.0), (0.0, 0.0, 0.0))


def one_post(x_m: float, y_m: float, half_width_m: float = 0.4, cylinder: bool = False) -> LaneLayout:
    shape = "radius_m" if cylinder else "half_side_m"
    return layout_from({"obstacles": [{"x_m": x_m, "y_m": y_m, shape: half_width_m}]}, "test")


def touched(scene: Scene, x_m: float, y_m: float, z_m: float = -10.0) -> str:
    """Name of what the drone touches when it is at a NED place."""
    model, data = scene
    data.qpos[:7] = (x_m, -y_m, -z_m, 1.0, 0.0, 0.0, 0.0)
    data.qvel[:] = 0.0
    mujoco.mj_step(model, data)
    assert (data.sensor("collision").data[0] > 0) == bool(collision_object(model, data))
    return collision_object(model, data)


# --- contacts -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("cylinder", [False, True])
@pytest.mark.parametrize("z_m", [-1.0, -10.0, -19.5])
def test_free_distance_is_where_mujoco_finds_the_contact(lane_scene: Scene, cylinder: bool, z_m: float) -> None:
    """From the ground to the top of the post, at its front, its edge and beside its corner."""
    layout = one_post(30.0, 1.0, cylinder=cylinder)
    apply_layout(*lane_scene, layout)
    for offset in (0.3, 0.5, 1.0, 1.6):
        touch = free_distance_m(layout, offset)
        assert clearance_m(layout, (touch, offset)) == pytest.approx(0.0, abs=1e-9)
        for north, found in ((touch - 0.02, ""), (touch + 0.02, "obstacle_00")):
            assert touched(lane_scene, north, offset, z_m) == found
    assert touched(lane_scene, 30.0, 1.0, -20.2) == ""


def test_clearance_is_to_the_nearest_of_posts_and_walls() -> None:
    """By hand: beside, before, at the corner of a square post, around a cylinder, at a wall, inside."""
    square, cylinder = one_post(30.0, 1.0, 0.5), one_post(30.0, 1.0, 0.5, cylinder=True)
    places = np.array([(28.0, 1.0), (30.0, -1.0), (32.5, 4.1), (28.5, 0.0), (10.0, -4.0), (30.2, 1.0)])
    hull = HULL_RADIUS_M
    walls = np.array([4.0, 4.0, 0.9, 5.0, 1.0, 4.0])
    around = np.array([1.5, 1.5, np.hypot(2.0, 2.6), np.hypot(1.0, 0.5), 99.0, 0.0])
    np.testing.assert_allclose(clearance_m(square, places), np.minimum(walls, around) - hull)
    around = np.array([1.5, 1.5, np.hypot(2.5, 3.1) - 0.5, np.hypot(1.5, 1.0) - 0.5, 99.0, 0.2 - 0.5])
    np.testing.assert_allclose(clearance_m(cylinder, places), np.minimum(walls, around) - hull)
    np.testing.assert_allclose(clearance_m(layout_from({"obstacles": []}, "test"), places), walls - hull)


def test_walls_and_ground_are_hit_by_name(lane_scene: Scene) -> None:
    apply_layout(*lane_scene, one_post(30.0, 4.0))
    assert touched(lane_scene, 3.0, 4.7) == "wall_east"
    assert touched(lane_scene, 3.0, -4.7) == "wall_west"
    assert touched(lane_scene, 3.0, 0.0, z_m=-0.02) == "ground"
    assert touched(lane_scene, 3.0, 0.0) == ""


def test_every_obstacle_of_a_new_layout_is_hit_where_it_stands(lane_scene: Scene) -> None:
    """MuJoCo's tree of bounding boxes follows the obstacles: none is missed, and nothing is left behind."""
    for seed in (1, 2):
        layout = sample_layout(seed)
        apply_layout(*lane_scene, layout)
        for index, (x, y) in enumerate(zip(layout.x_m, layout.y_m, strict=True)):
            assert touched(lane_scene, x - 0.6, float(np.clip(y, -4.4, 4.4))) == f"obstacle_{index:02d}"
    apply_layout(*lane_scene, layout_from({"obstacles": []}, "test"))
    for x, y in zip(layout.x_m, layout.y_m.clip(-4, 4), strict=True):
        assert touched(lane_scene, x, y) == ""


def test_clients_find_the_obstacles_of_a_layout_alone(lane_world: World) -> None:
    """Whatever stood there before."""
    for layout, found in ((sample_layout(1), 28), (one_post(30.0, 1.0), 1)):
        lane_world.set_lane(layout)
        names = SceneObjects(lane_world).names()
        assert names == [*("ground",), *(f"obstacle_{index:02d}" for index in range(found)), "wall_east", "wall_west"]


def test_a_lane_is_as_in_a_new_world_whatever_was_flown_there() -> None:
    """All of MuJoCo's model, the vehicle's parameters, and the flight: nothing is left of lanes before."""
    heavy: dict[str, Any] = {"mass_ratio": 1.3, "thrust_ratio": 1.2, "wind_m_s": 2.0}
    used = World("lane", NATIVE)
    for seed, difficulty in enumerate((heavy, {**heavy, "scenery": "forest", "obstacles_per_row": 1}, {}, heavy)):
        layout, new = sample_layout(seed, Difficulty(**difficulty)), World("lane", NATIVE)
        for world in (used, new):
            world.set_lane(layout)
            world.reset()
            world.lead.set_goal(Goal((3.0, 0.0, 0.0, 0.3), VELOCITY, VELOCITY, RATE))
            world.advance(50)
        np.testing.assert_equal(arrays_of(used.model), arrays_of(new.model))
        assert_bounded(used.model)
        assert used.lead.parameters == new.lead.parameters
        assert used.lead.kinematics() == new.lead.kinematics()


def arrays_of(model: mujoco.MjModel) -> dict[str, NDArray[Any]]:
    """All that a model has in arrays, by MuJoCo's names."""
    found = {name: getattr(model, name) for name in dir(model)}
    return {name: array for name, array in found.items() if isinstance(array, np.ndarray)}


def test_too_many_obstacles_and_other_scenes_are_refused(lane_scene: Scene) -> None:
    blocks = mujoco.MjModel.from_xml_path(str(asset("mjcf/blocks.xml")))
    assert len(obstacle_geoms(lane_scene[0])) == MAX_OBSTACLES
    assert len(obstacle_geoms(blocks)) == 0
    with pytest.raises(UserError, match=r"^the scene is no lane, whose obstacles, light and wind a layout sets$"):
        apply_layout(blocks, mujoco.MjData(blocks), sample_layout(0))


# --- wind ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("wind_m_s", [(6.0, 0.0, 0.0), (0.0, -8.0, 0.0), (-5.0, 5.0, 0.0), (0.0, 0.0, 4.0)])
def test_wind_pushes_a_hovering_drone_the_way_it_blows(lane_world: World, wind_m_s: tuple[float, float, float]) -> None:
    """At first by the drag of the air that streams past a level vehicle at rest: c rho v |v| / m along each axis."""
    lane_world.set_lane(layout_from({"obstacles": [], "wind_m_s": wind_m_s}, "test"))
    lane_world.reset()
    lane_world.advance(1)
    parameters = lane_world.lead.parameters
    density = 101325.0 * (1 - 0.0065 * 132.0 / 288.15) ** 5.255877 / 287.053 / (288.15 - 0.0065 * 132.0)
    wind = np.array(wind_m_s)
    push = np.array(parameters["drag_factor_m2"]) * density * wind * np.abs(wind) / parameters["mass_kg"]
    np.testing.assert_allclose(lane_world.lead.kinematics().linear_acceleration_m_s2, push, rtol=2e-3, atol=1e-3)
    lane_world.set_lane(layout_from({"obstacles": []}, "test"))
    lane_world.reset()
    lane_world.advance(1)
    np.testing.assert_allclose(lane_world.lead.kinematics().linear_acceleration_m_s2, 0.0, atol=1e-3)


# --- what is seen -------------------------------------------------------------------------------------------------


def look(world: World, **lane: Any) -> NDArray[np.float64]:
    """The picture from the start of a lane as a user writes it; (144, 256, 3), red, green, blue."""
    world.set_lane(layout_from({"obstacles": []} | lane, "test"))
    return world.camera(COLUMNS, ROWS).colour(world.data).astype(float)


LANE = {
    "west": ((75.0, -5.1, -10.0), (85.0, 0.1, 10.0)),
    "east": ((75.0, 5.1, -10.0), (85.0, 0.1, 10.0)),
    "ground": ((75.0, 0.0, 1.0), (600.0, 600.0, 1.0)),
}


def pixels_of(name: str, **posts: Any) -> NDArray[np.bool_]:
    """Where the picture from the start shows a wall, the ground or one of the posts, away from the edges."""
    seen = cast_rays(START, LANE | posts)
    return seen.inside() & (seen.box == [*LANE, *posts].index(name))


def ambient_and_sun(light: float, azimuth_rad: float, normal: tuple[float, float, float]) -> float:
    """Brightness of a face with an outward NED normal, full daylight from everywhere being 0.45 and the sun's 0.65."""
    sun = (np.cos(0.9) * np.cos(azimuth_rad), np.cos(0.9) * np.sin(azimuth_rad), np.sin(0.9))
    return float(light * (0.45 + 0.65 * max(0.0, -np.dot(sun, normal))))


@pytest.mark.opengl
@pytest.mark.parametrize(("light", "azimuth_rad"), [(1.0, 0.8), (0.6, 0.8), (0.8, -0.8), (0.3, 0.2)])
def test_light_and_the_suns_heading_are_seen(lane_world: World, light: float, azimuth_rad: float) -> None:
    """Against the same lane at 0.8 of daylight with the sun due north: walls, ground and the front of a post."""
    obstacles = [{"x_m": 8.0, "y_m": 1.0, "half_side_m": 1.0, "texture": "white"}]
    reference = look(lane_world, light=0.8, sun_azimuth_rad=0.0, obstacles=obstacles)
    picture = look(lane_world, light=light, sun_azimuth_rad=azimuth_rad, obstacles=obstacles)
    for name, normal in (
        ("west", (0.0, 1.0, 0.0)),
        ("east", (0.0, -1.0, 0.0)),
        ("ground", (0.0, 0.0, -1.0)),
        ("front", (-1.0, 0.0, 0.0)),
    ):
        where = pixels_of(name, front=((8.0, 1.0, -10.0), (1.0, 1.0, 10.0)))
        ratio = ambient_and_sun(light, azimuth_rad, normal) / ambient_and_sun(0.8, 0.0, normal)
        assert picture[where].mean() / reference[where].mean() == pytest.approx(ratio, rel=0.03)


def hue(picture: NDArray[np.float64], where: NDArray[np.bool_]) -> tuple[float, float]:
    """Green and blue over red."""
    red, green, blue = picture[where].mean(axis=0)
    return green / red, blue / red


@pytest.mark.opengl
@pytest.mark.parametrize("swapped", [False, True])
def test_walls_and_ground_wear_their_own_textures(lane_world: World, swapped: bool) -> None:
    """Hues of the colours in lane.xml; only one of the two changes at a time."""
    brick, grass = swapped, not swapped
    picture = look(
        lane_world, wall_texture="brick" if brick else "concrete", ground_texture="grass" if grass else "asphalt"
    )
    ground = (1.35, 0.75) if grass else (1.03, 1.0)
    wall = (0.74, 0.62) if brick else (1.0, 0.97)
    assert hue(picture, pixels_of("ground")) == pytest.approx(ground, abs=0.04)
    for name in ("west", "east"):
        assert hue(picture, pixels_of(name)) == pytest.approx(wall, abs=0.04)


@pytest.mark.opengl
def test_obstacles_wear_their_own_textures(lane_world: World) -> None:
    """Four posts side by side, every other one round."""
    hues = {"red": (0.28, 0.22), "white": (1.0, 1.0), "yellow": (0.8, 0.1), "blue": (0.55 / 0.35, 1 / 0.35)}
    places = dict(zip(hues, (-3.0, -1.0, 1.0, 3.0), strict=True))
    picture = look(
        lane_world,
        obstacles=[
            {"x_m": 9.0, "y_m": y, "radius_m" if name in ("white", "blue") else "half_side_m": 0.6, "texture": name}
            for name, y in places.items()
        ],
    )
    posts = {name: ((9.0, y, -10.0), (0.6, 0.25, 10.0)) for name, y in places.items()}
    for name, wanted in hues.items():
        assert hue(picture, pixels_of(name, **posts)) == pytest.approx(wanted, rel=0.12)


@pytest.mark.opengl
@pytest.mark.parametrize("cylinder", [False, True])
def test_obstacles_have_their_own_shapes_and_the_rest_is_not_seen(lane_world: World, cylinder: bool) -> None:
    """Before the middle of the face, and 0.4 m towards the lane's middle, where a cylinder has receded."""
    y, near = 3.0, 9.0 - 0.6 - 0.46
    look(lane_world, obstacles=[{"x_m": 9.0, "y_m": y, "radius_m" if cylinder else "half_side_m": 0.6}])
    camera, data = lane_world.camera(COLUMNS, ROWS), lane_world.data
    depth_m = camera.depth(data)[72]
    middle, edge = int(128 + 128 * y / near), int(128 + 128 * (y - 0.4) / near)
    east = (edge + 0.5 - 128) / 128 * near
    bulge = 0.6 - np.sqrt(0.36 - (east - y) ** 2) if cylinder else 0.0
    assert depth_m[middle] == pytest.approx(near, abs=0.05)
    assert depth_m[edge] - near == pytest.approx(bulge, abs=0.09)
    seen = object_names(lane_world.model, camera.segmentation(data))
    assert seen == ["ground", "obstacle_00", "wall_east", "wall_west"]
