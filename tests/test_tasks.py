"""Tasks: reward, success and ends as functions of what happened, and the environment that all of them share."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import closing
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.opengl import needs_opengl
from uavaccel.clock import VirtualClock
from uavaccel.envs.checks import within
from uavaccel.envs.flight_env import FlightEnv
from uavaccel.envs.gates import Gates, GatesTask
from uavaccel.envs.hover import HoverTask
from uavaccel.envs.obstacle_lane import LaneTask, ObstacleLane
from uavaccel.envs.sensors import DepthCamera, blank_frame
from uavaccel.envs.stopwatch import Stopwatch
from uavaccel.envs.task import Task
from uavaccel.envs.values import AT_REST, Collisions, Course, Moment
from uavaccel.kinematics import Kinematics
from uavaccel.sim.lane import LaneLayout

STILL = np.zeros(3, np.float32)


def moment(position_m: tuple[float, float, float], course: Course, commands: int = 1, hit: str | None = None) -> Moment:
    return Moment(replace(AT_REST, position_m=position_m), position_m, hit, commands, course)


def test_what_many_games_hit_is_compared_by_name() -> None:
    hit = Collisions(np.array([-1, 0, 1]), ("ground", "post"))
    assert [(hit == name).tolist() for name in ("post", "tree")] == [[False, False, True], [False] * 3]
    assert (hit != "ground").tolist() == [True, False, True]


# --- the lane -------------------------------------------------------------------------------------------------------


def test_a_lane_of_ones_own_is_the_layout_wherever_it_is_flown() -> None:
    class Own(LaneTask):
        def wire_lane(self, index: int) -> dict[str, object]:
            return {"obstacles": [{"x_m": 10.0 + index, "y_m": 0.0, "radius_m": 0.5}]}

    found = Own().lane_layout({"lane": 3})
    assert isinstance(found, LaneLayout)
    assert (found.x_m.tolist(), found.round.tolist()) == ([13.0], [True])


def test_t_th_of_wall_timers_is_the_latency_or_a_tenth_of_a_sample() -> None:
    keys: dict[str, Any] = {"profile": "airsim", "t_move_s": 1.0, "t_sample_s": 0.33, "t_th_wall_s": 0.001}
    assert [HoverTask(**keys, clock_speed=speed).t_th_ns for speed in (10.0, 100.0)] == [10_000_000, 33_000_000]


def test_beside_pictures_gates_are_to_be_seen() -> None:
    """The state is the vehicle's own: wherever the gates are, it is the same, and it knows how high it is."""
    task = GatesTask(observation="depth", also_state=True, altitude_m=3.0)
    state = replace(AT_REST, position_m=(1.0, 2.0, -2.5), linear_velocity_m_s=(4.0, 5.0, 6.0))
    near, far = (task.fields(state, {"gates_m": [[x, 0.0, -3.0]] * 2, "passed": 0}) for x in (2.0, 9.0))
    assert list(near) == list(far)
    assert (near[0], list(near[5:8])) == (0.5, [4.0, 5.0, 6.0])
    assert task.observation_space()["state"].shape == np.shape(near)
    assert {down for *_, down in task.sample(np.random.default_rng(0), {})["gates_m"]} == {-3.0}


def test_depths_are_shown_up_to_50_m() -> None:
    camera = DepthCamera(blank_frame("depth"))
    depth_m = np.repeat(np.repeat(np.array([[0.0, 10.0], [50.0, 400.0]], np.float32), 72, axis=0), 128, axis=1)
    levels = camera.frame(AT_REST, depth_m, {})
    assert levels.shape == (1, 36, 64)
    assert levels.dtype == np.uint8
    assert levels[0, [9, 9, 27, 27], [16, 48, 16, 48]].tolist() == [0, 51, 255, 255]


# --- gates ----------------------------------------------------------------------------------------------------------

TWO = {"gates_m": [[6.0, 1.0, -2.0], [12.0, -1.0, -2.0]], "passed": 0, "missed": False}


def course_after(start: tuple[float, float, float], end: tuple[float, float, float], **course: Any) -> Course:
    task = GatesTask(half_width_m=1.0, half_height_m=0.8)
    return task.advance(moment(start, {**TWO, **course}), moment(end, {**TWO, **course}))


@pytest.mark.parametrize(
    ("start", "end", "passed", "missed"),
    [
        ((5.0, 1.0, -2.0), (5.9, 1.0, -2.0), 0, False),  # before it
        ((5.0, 1.0, -2.0), (6.0, 1.0, -2.0), 1, False),
        ((5.0, -1.0, -2.0), (7.0, 1.5, -2.0), 1, False),  # 0.75 m beside its middle when it crossed
        ((5.0, -1.0, -2.0), (7.0, 0.5, -2.0), 0, True),  # 1.25 m
        ((5.0, 1.0, -1.5), (7.0, 1.0, -2.7), 1, False),
        ((5.0, 1.0, -2.0), (7.0, 1.0, -4.0), 0, True),  # 1 m above it
        ((5.0, 1.2, -2.0), (13.0, -0.4, -2.0), 2, False),  # both in one command
        ((5.0, 1.2, -2.0), (13.0, 1.0, -2.0), 1, True),  # the first of both
        ((5.0, -1.4, -2.0), (13.0, -1.0, -2.0), 0, True),  # the second of both: too late
        ((7.0, 1.0, -2.0), (5.0, 1.0, -2.0), 0, False),  # backwards
    ],
)
def test_a_gate_is_passed_where_its_plane_is_crossed(start: Any, end: Any, passed: int, missed: bool) -> None:
    after = course_after(start, end)
    assert (after["passed"], after["missed"], after["gates_m"]) == (passed, missed, TWO["gates_m"])


def test_the_next_two_gates_are_seen_and_have_posts() -> None:
    task = GatesTask(half_width_m=1.1)
    state = replace(AT_REST, position_m=(5.0, 1.0, -2.5), linear_velocity_m_s=(7.0, 8.0, 9.0))
    ways = [task.features(state, {**TWO, "passed": passed})[:6].tolist() for passed in (0, 1, 2)]
    assert ways == [[1, 0, 0.5, 7, -2, 0.5], [7, -2, 0.5] * 2, [7, -2, 0.5] * 2]
    np.testing.assert_array_equal(task.features(state, TWO)[6:], [1, 0, 0, 0, 7, 8, 9, 0, 0, 0])
    layout: Any = task.layout(TWO)
    posts = {(post["x_m"], round(post["y_m"], 9)): post["half_side_m"] for post in layout["obstacles"]}
    assert posts == {(6.0, 2.3): 0.2, (6.0, -0.3): 0.2, (12.0, 0.3): 0.2, (12.0, -2.3): 0.2}


# --- every task -------------------------------------------------------------------------------------------------------


@needs_opengl
@pytest.mark.parametrize("observation", ["colour", "dvs"])
def test_gates_are_seen_in_pictures(observation: str) -> None:
    with closing(Gates(observation=observation)) as environment:
        seen, *_ = environment.reset(seed=1)
        there = environment.step(np.array([0.5, 0, 0], np.float32))[0]
    assert environment.observation_space.contains(there)
    assert np.ptp(there) > 20
    assert (np.ptp(seen) > 20) == (observation == "colour")  # of the start there are no events


# --- the environment, with a task that shows what it gets ----------------------------------------------------------


class Shown(Task):
    """What is judged is the sum of the numbers of all commands, and what it is judged by is told."""

    t_sample_s: float = 0.1
    won_at: int = 1000

    def sample(self, random: np.random.Generator, options: Mapping[str, Any]) -> Course:
        return {"last": 0}

    def features(self, state: Kinematics, course: Course) -> NDArray[np.float32]:
        return np.zeros(1, np.float32)

    def advance(self, before: Moment, now: Moment) -> Course:
        return {**now.course, "last": now.course["last"] + now.commands}

    def reward(self, before: Moment, now: Moment) -> float:
        return 100.0 * before.commands + now.commands

    def success(self, now: Moment) -> bool:
        return now.course["last"] >= self.won_at

    def info(self, now: Moment) -> dict[str, Any]:
        return {"course": dict(now.course)}


class ShownEnv(FlightEnv[Shown]):
    task_class = Shown


def test_reward_and_ends_are_of_the_course_after_the_command() -> None:
    with closing(ShownEnv(won_at=3, max_commands=2)) as environment:
        environment.reset(seed=0)
        _, reward, *ends, info = environment.step(STILL)
        assert (reward, ends, info["is_success"], info["commands"]) == (1.0, [False, False], False, 1)
        _, reward, *ends, info = environment.step(STILL)
    assert (reward, ends, info["is_success"], info["course"]["last"]) == (102.0, [True, False], True, 3)


def test_lockstep_charges_nothing() -> None:
    with closing(ShownEnv(image_processing_s=0.05)) as environment:
        environment.reset(seed=0)
        environment.charge(0.5)
        info = environment.step(STILL)[4]
    assert info["wall_s"] == info["phase_s"]["simulation"] == pytest.approx(0.2)
    assert info["phase_s"]["inference"] == 0.0


def test_a_phase_that_raises_is_over() -> None:
    clock = VirtualClock()
    stopwatch = Stopwatch(clock)
    with pytest.raises(KeyError), stopwatch.phase("learning"):  # noqa: PT012 - it raises after some time
        clock.charge(10**9)
        raise KeyError
    clock.charge(10**9)
    stopwatch.switch(None)
    assert stopwatch.spent_s()["learning"] == 1.0
    stopwatch.switch("simulation")
    with stopwatch.aside("rendering"):
        clock.charge(2 * 10**9)
    clock.charge(4 * 10**9)  # again of the simulation
    stopwatch.switch(None)
    assert [stopwatch.spent_s()[phase] for phase in ("simulation", "rendering", "learning")] == [4.0, 2.0, 1.0]


# --- mistakes ------------------------------------------------------------------------------------------------------


def test_a_lane_may_be_a_number_of_numpys() -> None:
    with closing(ObstacleLane(observation="state")) as environment:
        info = environment.reset(options={"lane": np.int64(7)})[1]
    assert (info["lane"], type(info["lane"])) == (7, int)


def test_an_action_may_be_a_list_or_off_by_rounding() -> None:
    clipped = within(HoverTask().action_space(), [1.0 + 1e-9, -1.0, 0.5])
    assert (clipped.dtype, clipped.tolist()) == (np.float32, [1.0, -1.0, 0.5])
