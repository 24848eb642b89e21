"""`uavaccel/Hover-v0`: reach a waypoint that is drawn at reset, and hold it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from uavaccel.envs.flight_env import FlightEnv
from uavaccel.envs.task import AnyMoment, Count, Moment, Positive, Task, distance, position_option
from uavaccel.envs.values import Course, Info, Number
from uavaccel.kinematics import Kinematics


class HoverTask(Task):
    """Observations: the way to the waypoint, attitude, velocity and body rate (13,); m, m/s and rad/s."""

    reset_options: ClassVar[tuple[str, ...]] = ("waypoint_m",)
    observation: Literal["state"] = "state"
    speed_m_s: Positive = 2.0
    reach_m: Positive = 3.0
    """Waypoints are drawn from the cube of that half side around the start."""
    radius_m: Positive = 0.5
    hold_s: Positive = 1.0
    """Time at the waypoint without a break that wins the game."""
    max_commands: Count = 60

    def draw(self, random: np.random.Generator, options: Mapping[str, object]) -> Course:
        drawn = random.uniform(-self.reach_m, self.reach_m, 3) - (0.0, 0.0, self.altitude_m)
        return {"waypoint_m": position_option(options, "waypoint_m", drawn), "held_s": 0.0}

    def fields(self, state: Kinematics, course: Course) -> Sequence[Number]:
        """The way to the waypoint, and the state but for its place."""
        way_m = [there - here for there, here in zip(course["waypoint_m"], state.position_m, strict=True)]
        return [*way_m, *super().fields(state, course)[3:]]

    def features(self, state: Kinematics, course: Course) -> NDArray[np.float32]:
        features: NDArray[np.float32] = super().features(state, course)[0]
        return features

    def advance(self, before: AnyMoment, now: AnyMoment) -> Course:
        there = distance_m(now) <= self.radius_m
        return {**now.course, "held_s": (now.course["held_s"] + self.t_move_s) * there}

    def reward(self, before: AnyMoment, now: AnyMoment) -> Number:
        """A point for each metre nearer and for each second held, and ten for the end of it."""
        held_s = self.t_move_s * (now.course["held_s"] > 0)
        ends = 10.0 * self.success(now) - 1.0 * self.failure(now)
        return distance_m(before) - distance_m(now) + held_s + ends

    def success(self, now: AnyMoment) -> Number:
        return now.free & (now.course["held_s"] >= self.hold_s - 1e-9)

    def info(self, now: Moment) -> Info:
        return {"distance_m": distance_m(now), **now.course}


def distance_m(now: AnyMoment) -> Number:
    """From the waypoint."""
    return distance(now.course["waypoint_m"], now.position_m)


class Hover(FlightEnv[HoverTask]):
    """`reset` draws a waypoint, or takes `options={"waypoint_m": [north, east, down]}`."""

    task_class = HoverTask
