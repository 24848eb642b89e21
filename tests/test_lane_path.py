"""A way through the lane: planned, kept clear of everything, and flown."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from uavaccel.errors import UserError
from uavaccel.kinematics import VelocityGoal
from uavaccel.sim.lane.layout import LENGTH_M, LaneLayout, clearance_m, lane_seed, layout_from, sample_layout
from uavaccel.sim.vehicle.goal import of_velocity
from uavaccel.sim.world import World
from uavaccel.suites.lane_path import plan_path


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
    [(0, 10.0, 0.25, 1.0), (10, 10.0, 0.25, 1.0), (150, 3.0, 0.4, 1.0), (290, 10.0, 0.25, 0.5)],
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
    ends = places[:: round(command_s * 100), 0]
    assert places[-1, 0] == pytest.approx(LENGTH_M, abs=1.1 * command_s)
    assert places[-1, 0] > LENGTH_M - 0.1
    assert ends[-1] < LENGTH_M


@pytest.mark.parametrize("index", range(5, 300, 25))
def test_every_lane_has_a_path(index: int) -> None:
    """Five headings at 1 m/s and SimpleFlight's slow answer at 10 m, where it is slowest, are enough."""
    assert 150 <= len(plan_path(evaluation_lane(index))) <= 175


def test_a_path_is_straight_where_nothing_is_near_and_keeps_off_where_there_is_room() -> None:
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
