"""Leaving contacts out of the physics where nothing can be touched changes no flight."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any, cast

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.simulating import put_vehicle
from uavaccel.kinematics import VelocityGoal
from uavaccel.sim.flight import of_velocity
from uavaccel.sim.lane import layout_from, sample_layout
from uavaccel.sim.profile import AIRSIM, NATIVE
from uavaccel.sim.vehicle import clearance
from uavaccel.sim.vehicle.clearance import Clearance
from uavaccel.sim.world import World


class Touchy(Clearance):
    """Never sure that nothing can be touched."""

    def free_s(self, parameters: object, state: object) -> float:
        return 0.0


def flight(world: World, seed: int, height_m: float) -> tuple[bytes, int | None, str]:
    """A reckless one of 20 s, as exact as can be."""
    world.reset((0.0, 0.0, -height_m))
    world.start_recording()
    rng = np.random.default_rng(seed)
    for _ in range(20):
        heading, speed = rng.uniform(-1, 1), rng.choice([1.0, 3.0, 8.0])
        velocity = (speed * math.cos(heading), speed * math.sin(heading), 0.0)
        world.lead.set_goal(of_velocity(VelocityGoal(velocity, height_m=-height_m * rng.uniform(0.2, 1.2))))
        for ticks in (165, 165, 170):
            world.advance(ticks)
    touched = getattr(world.lead.contact_log.first, "object", "")
    return world.recorder.rows().tobytes(), world.lead.collision_tick, touched


@pytest.mark.slow
@pytest.mark.parametrize("scene", ["lane", "blocks"])
@pytest.mark.parametrize("profile", [NATIVE, AIRSIM], ids=lambda profile: profile.name)
def test_a_flight_is_the_same_with_contacts_looked_for_at_every_step(scene: str, profile: object) -> None:
    worlds = [World(scene, profile), World(scene, profile)]  # type: ignore[arg-type]
    worlds[1].clearance = Touchy(worlds[1].model, worlds[1].data)
    collisions = []
    for seed in range(3 if scene == "lane" else 1):
        if scene == "lane":
            layout = sample_layout(seed)
            if seed % 2:
                layout = replace(layout, wind_m_s=(4.0, -3.0, 0.0), mass_ratio=0.87, thrust_ratio=1.13)
            for world in worlds:
                world.set_lane(layout)
        once, always = (flight(world, seed, 2.0) for world in worlds)
        assert once == always
        collisions.append(once[1])
    assert scene == "blocks" or None not in collisions


# --- the bound, by brute force ----------------------------------------------------------------------------


def turned_to(direction: NDArray[np.float64]) -> tuple[float, float, float, float]:
    """The attitude whose thrust, along the body's -z, points there (NED unit vector)."""
    up = np.array([0.0, 0.0, -1.0])
    axis, cosine = np.cross(up, direction), float(up @ direction)
    if cosine < -1 + 1e-9:
        return (0.0, 1.0, 0.0, 0.0)
    w = math.sqrt((1 + cosine) / 2)
    x, y, z = axis / (2 * w)
    return (w, float(x), float(y), float(z))


def rocket(world: World) -> None:
    """Full thrust whatever happens, and no turning: the worst that a flight may be."""
    world.lead.parameters["min_throttle"] = 1.0
    world.lead.parameters["rate_gain"] = 0.0
    for name in ("rotor_input", "rotor_lagged", "rotor_output"):
        world.lead.state[name] = 1.0


TARGETS = {  # a place near, and the direction to what is to be hit
    "ground": ((5.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
    "wall": ((5.0, 5.0, -8.0), (0.0, 1.0, 0.0)),
    "post": ((20.0 - 0.5, 0.3, -6.0), (1.0, 0.0, 0.0)),
}
POSTS = {"obstacles": [{"x_m": 20.0, "y_m": 0.3, "half_side_m": 0.5}, {"x_m": 40.0, "y_m": 0.0, "radius_m": 0.5}]}


@pytest.mark.parametrize("speed_m_s", [0.0, 4.0, 14.0])
@pytest.mark.parametrize("wind_m_s", [0.0, 18.0])
@pytest.mark.parametrize("target", TARGETS)
def test_no_flight_into_something_is_missed(target: str, speed_m_s: float, wind_m_s: float) -> None:
    """Straight at it from many distances, thrust, speed and wind all towards it: frozen at the same tick and place."""
    world = lane_world()
    world.set_lane(layout_from(POSTS, "test"))
    place, direction = (np.array(vector) for vector in TARGETS[target])
    usual, touchy = world.clearance, Touchy(world.model, world.data)
    for distance_m in (0.4, 0.5, 0.7, 1.0, 1.5, 2.2, 3.0, 4.0):
        ends = []
        for world.clearance in (usual, touchy):
            world.reset()
            rocket(world)
            world.lead.state["wind"] = wind_m_s * direction
            start = tuple(place - distance_m * direction)
            put_vehicle(world, start, turned_to(direction), tuple(speed_m_s * direction))
            for _ in range(100):
                world.advance(4)
            touched = getattr(world.lead.contact_log.first, "object", "")
            ends.append((world.lead.collision_tick, touched, world.lead.kinematics()))
        world.clearance = usual
        assert ends[0] == ends[1]
        assert ends[0][0] is not None


def strongest_acceleration(gains: Any, airspeed_m_s: float) -> float:
    craft = [gains[name] for name in ("max_thrust_n", "drag_factor_m2", "mass_kg", "gravity_m_s2")]
    return float(clearance.strongest_acceleration(*[*craft, airspeed_m_s]))


@given(seed=st.integers(0, 2**32), speed_m_s=st.floats(0, 15), wind_m_s=st.floats(0, 20), height_m=st.floats(0.0, 60.0))
def test_no_flight_accelerates_more_than_the_strongest(
    seed: int, speed_m_s: float, wind_m_s: float, height_m: float
) -> None:
    """Newton's law in numpy: thrust, drag on the widest face and weight in a line, up to the gust's gain of speed."""
    world = lane_world()
    gains = world.lead.parameters
    rng = np.random.default_rng(seed)
    density = 1.2250 * (1 - 0.0065 * (gains["ground_altitude_m"] + height_m) / 288.15) ** 4.2559
    airspeed = speed_m_s + wind_m_s + rng.uniform(0, clearance.GUST_M_S)
    share = np.append(rng.normal(size=2) * rng.choice([0, 0.1, 1]), 1.0)
    along = np.abs(share / np.linalg.norm(share))
    drag = np.linalg.norm(gains["drag_factor_m2"] * density * (airspeed * along) ** 2)
    thrust = 4 * gains["max_thrust_n"] * density / 1.2250
    strongest = (thrust + drag) / gains["mass_kg"] + gains["gravity_m_s2"]
    assert strongest_acceleration(gains, speed_m_s + wind_m_s) >= strongest


@given(distance_m=st.floats(1e-3, 50), speed_m_s=st.floats(0, 15), strongest=st.floats(1, 200))
def test_nothing_arrives_before_its_time(distance_m: float, speed_m_s: float, strongest: float) -> None:
    """In steps of a thousandth of it: neither there yet, nor faster by more than a gust; and no time is given away."""
    free_s = clearance.time_to.py_func(distance_m, speed_m_s, strongest)
    times = np.linspace(0, free_s, 1001)
    gained = strongest * times
    travelled = np.append(0, np.cumsum(np.diff(times) * (speed_m_s + (gained[1:] + gained[:-1]) / 2)))
    assert travelled[-1] <= distance_m * (1 + 1e-9)
    assert gained[-1] <= clearance.GUST_M_S * (1 + 1e-9)
    assert travelled[-1] > 0.999 * distance_m or gained[-1] > 0.999 * clearance.GUST_M_S


@given(
    north_m=st.floats(-5, 60),
    east_m=st.floats(-4.5, 4.5),
    height_m=st.floats(0.4, 15),
    velocity_m_s=st.tuples(*[st.floats(-15, 15)] * 3),
    wind_m_s=st.tuples(*[st.floats(-10, 10)] * 3),
)
def test_the_free_time_is_to_the_nearest_of_ground_walls_and_posts(
    north_m: float,
    east_m: float,
    height_m: float,
    velocity_m_s: tuple[float, float, float],
    wind_m_s: tuple[float, float, float],
) -> None:
    """Distances in numpy; the hull fits into a ball of its own half diagonal. Within MuJoCo's own distance, too."""
    world = lane_world()
    world.set_lane(layout_from(POSTS, "test"))
    put_vehicle(world, (north_m, east_m, -height_m), velocity_m_s=velocity_m_s)
    world.lead.state["wind"] = wind_m_s
    free_s = world.clearance.free_s(world.lead.parameters, world.lead.state)
    centres = np.array([[75.0, 5.1, 10.0], [75.0, -5.1, 10.0], [20.0, 0.3, 10.0], [40.0, 0.0, 10.0]])
    halves = np.array([[85.0, 0.1, 10.0], [85.0, 0.1, 10.0], [0.5, 0.5, 10.0], [0.5, 0.5, 10.0]])
    outside = np.maximum(np.abs(np.array([north_m, east_m, height_m]) - centres) - halves, 0.0)
    nearest_m = min(np.linalg.norm(outside, axis=1).min(), height_m)
    room_m = nearest_m - math.hypot(0.3418, 0.045) - 0.01
    speed = float(np.linalg.norm(world.lead.state["velocity"]))
    airspeed = speed + float(np.linalg.norm(wind_m_s))
    strongest = strongest_acceleration(world.lead.parameters, airspeed)
    assert free_s == pytest.approx(clearance.time_to.py_func(room_m, speed, strongest), abs=1e-9)
    records, of_kernels = (world.lead.parameters, world.lead.state), cast(Any, clearance.free_s.py_func)
    fields = [SimpleNamespace(**{name: record[name] for name in record.dtype.names or ()}) for record in records]
    assert of_kernels(*fields, room_m) == pytest.approx(free_s, abs=1e-9), "as kernels compute it"
    hull = world.model.geom("quadrotor_hull").id
    true_m = min(
        mujoco.mj_geomDistance(world.model, world.data, hull, geom, 70.0, None)
        for geom in np.flatnonzero(world.model.geom_bodyid == 0)
    )
    assert free_s == 0.0 or room_m < true_m


DRONE = "<body name='quadrotor' pos='0 0 10'><freejoint/><geom name='hull' size='.1'/></body>"
POST = "<geom name='post' type='box' size='.5 .5 5' pos='30 0 5'/>"


@pytest.mark.parametrize(
    ("old", "new", "free"),
    [
        ("<body", "<body", True),
        ("pos='30", "solref='.05 1' friction='2 1 1' group='4' pos='30", True),
        (POST, "<body name='ball' pos='0 0 30'><freejoint/><geom size='.1'/></body>", False),
        ("pos='30", "margin='.5' pos='30", False),
        ("pos='30", "gap='.5' pos='30", False),
        ("name='hull'", "name='hull' margin='.5'", False),
        ("</worldbody>", "</worldbody><contact><pair geom1='hull' geom2='post'/></contact>", False),
        ("<worldbody>", "<option o_margin='.5'><flag override='enable'/></option><worldbody>", False),
    ],
)
def test_where_things_move_or_act_from_afar_nothing_is_ever_free(old: str, new: str, free: bool) -> None:
    """MuJoCo finds contacts at a distance where it is told so, and those of pairs whatever their geoms may touch."""
    text = f"<mujoco><worldbody>{DRONE}{POST}</worldbody></mujoco>"
    assert old in text
    model = mujoco.MjModel.from_xml_string(text.replace(old, new))
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    world = lane_world()
    world.reset()
    assert (Clearance(model, data).free_s(world.lead.parameters, world.lead.state) > 0.1) == free


@pytest.mark.parametrize("poison", [math.nan, math.inf])
def test_a_flight_that_diverged_is_never_free(poison: float) -> None:
    world = lane_world()
    world.reset()
    world.lead.state["velocity"] = (poison, 0.0, 0.0)
    assert world.clearance.free_s(world.lead.parameters, world.lead.state) == 0.0
    world.reset()


def test_what_is_moved_is_seen_at_once() -> None:
    """The vehicle to a wall, or a post to the vehicle, while contacts are left out."""
    for move in ("vehicle", "post"):
        world = lane_world()
        world.set_lane(layout_from({"obstacles": []}, "test"))
        world.reset((12.0, 0.0, -10.0))
        world.advance(40)
        assert world.model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_CONTACT
        if move == "vehicle":
            put_vehicle(world, (12.0, 4.7, -10.0))
        else:
            world.set_lane(layout_from({"obstacles": [{"x_m": 12.0, "y_m": 0.3, "radius_m": 0.4}]}, "test"))
        world.advance(2)
        assert getattr(world.lead.contact_log.first, "object", "") == (
            "wall_east" if move == "vehicle" else "obstacle_00"
        )


@cache
def made() -> tuple[World, dict[str, Any]]:
    world = World("lane", NATIVE)
    return world, {name: world.lead.parameters[name].copy() for name in ("min_throttle", "rate_gain")}


def lane_world() -> World:
    """One for all examples, as made: it takes long to make."""
    world, as_made = made()
    for name, value in as_made.items():  # which `rocket` changes
        world.lead.parameters[name] = value
    world.lead.state["wind"] = 0.0
    return world


def test_a_reset_hovers_where_and_as_it_is_told(lane_world: World) -> None:
    """Half a turn to the right of north is south; without a place it starts anew, looking north."""
    south = (0.0, 0.0, 0.0, 1.0)
    lane_world.reset((3.0, -1.0, -5.0), south)
    for _ in range(2):
        state = lane_world.lead.kinematics()
        assert state.position_m == pytest.approx((3.0, -1.0, -5.0), abs=1e-6)
        assert np.abs(state.orientation_wxyz) == pytest.approx(south, abs=1e-6)
        lane_world.advance(100)
    lane_world.reset()
    state = lane_world.lead.kinematics()
    assert (state.position_m, state.orientation_wxyz) == ((0.0, 0.0, -10.0), (1.0, 0.0, 0.0, 0.0))
