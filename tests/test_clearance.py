"""Leaving contacts out of the physics where nothing can be touched changes no flight."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from uavaccel.sim.clearance import Clearance
from uavaccel.sim.lane.layout import draw_layout
from uavaccel.sim.profile import AIRSIM, NATIVE
from uavaccel.sim.world import World


class Touchy(Clearance):
    """Never sure that nothing can be touched."""

    def free_s(self, parameters: object, state: object) -> float:
        return 0.0


def flight(world: World, seed: int, height_m: float) -> tuple[bytes, int | None, str]:
    """A reckless one of 40 s, as exact as can be."""
    world.reset((0.0, 0.0, -height_m))
    world.start_recording()
    rng = np.random.default_rng(seed)
    for _ in range(40):
        heading, speed = rng.uniform(-1, 1), rng.choice([1.0, 3.0, 8.0])
        goal = (speed * math.cos(heading), speed * math.sin(heading), -height_m * rng.uniform(0.2, 1.2))
        world.fly_velocity(goal, True, 0.0, True)
        for ticks in (165, 165, 170):
            world.advance(ticks)
    return world.samples().tobytes(), world.collision_tick, world.collision_object


@pytest.mark.slow
@pytest.mark.parametrize("scene", ["lane", "blocks"])
@pytest.mark.parametrize("profile", [NATIVE, AIRSIM], ids=lambda profile: profile.name)
def test_a_flight_is_the_same_with_contacts_looked_for_at_every_step(scene: str, profile: object) -> None:
    worlds = [World(scene, profile), World(scene, profile)]  # type: ignore[arg-type]
    worlds[1]._clearance = Touchy(worlds[1].model, worlds[1].data)
    collisions = []
    for seed in range(6):
        if scene == "lane":
            for world in worlds:
                world.set_lane(draw_layout(seed))
        once, always = (flight(world, seed, 2.0) for world in worlds)
        assert once == always
        collisions.append(once[1])
    assert scene == "blocks" or None not in collisions


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 20),
    north_m=st.floats(-5, 150),
    east_m=st.floats(-4.5, 4.5),
    height_m=st.floats(0.4, 15),
    velocity_m_s=st.tuples(*[st.floats(-15, 15)] * 3),
)
def test_what_is_called_free_is_out_of_reach(
    seed: int, north_m: float, east_m: float, height_m: float, velocity_m_s: tuple[float, float, float]
) -> None:
    world = lane_world()
    world.set_lane(draw_layout(seed))
    world.place((north_m, east_m, -height_m), velocity_m_s=velocity_m_s)
    free_s = world._clearance.free_s(world.parameters, world.state)
    if free_s == 0.0:
        return
    hull = world.model.geom("quadrotor_hull").id
    nearest_m = min(
        mujoco.mj_geomDistance(world.model, world.data, hull, geom, 50.0, None)
        for geom in np.flatnonzero(world.model.geom_bodyid == 0)
    )
    assert math.hypot(*velocity_m_s) * free_s < nearest_m


_worlds: list[World] = []


def lane_world() -> World:
    """One for all examples: it takes long to make."""
    if not _worlds:
        _worlds.append(World("lane", NATIVE))
    return _worlds[0]
