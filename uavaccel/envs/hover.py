"""`uavaccel/Hover-v0`: reach a waypoint that is sampled at reset, and stay there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar, Literal

import numpy as np

from uavaccel.config import Count, Speed
from uavaccel.envs.flight_env import FlightEnv
from uavaccel.envs.task import Positive, Task, distance, position_option
from uavaccel.envs.values import AnyMoment, Course, Info, Number
from uavaccel.kinematics import Kinematics


class HoverTask(Task):
    """Observations: the vector to the waypoint, attitude, velocity and body rate (13,); m, m/s and rad/s."""

    flat_state: ClassVar[bool] = True
    reset_options: ClassVar[tuple[str, ...]] = ("waypoint_m",)
    observation: Literal["state"] = "state"
    """What the agent observes: the state as numbers."""
    speed_m_s: Speed = 2.0
    """Speed of a command at full deflection, m/s."""
    reach_m: Positive = 3.0
    """Half the side, in metres, of the cube around the start from which waypoints are sampled."""
    radius_m: Positive = 0.5
    """Distance from the waypoint, in metres, that counts as being there."""
    hold_s: Positive = 1.0
    """Uninterrupted simulated seconds at the waypoint that win the game."""
    max_commands: Count = 60
    """Commands after which a game is truncated."""

    def sample(self, random: np.random.Generator, options: Mapping[str, object]) -> Course:
        drawn = random.uniform(-self.reach_m, self.reach_m, 3) - (0.0, 0.0, self.altitude_m)
        return {"waypoint_m": position_option(options, "waypoint_m", drawn), "held_s": 0.0}

    def fields(self, state: Kinematics, course: Course) -> Sequence[Number]:
        """List the vector to the waypoint, and the state without its position."""
        way_m = [there - here for there, here in zip(course["waypoint_m"], state.position_m, strict=True)]
        return [*way_m, *super().fields(state, course)[3:]]

    def advance(self, before: AnyMoment, now: AnyMoment) -> Course:
        there = distance_m(now) <= self.radius_m
        return {**now.course, "held_s": (now.course["held_s"] + self.t_move_s) * there}

    def reward(self, before: AnyMoment, now: AnyMoment) -> Number:
        """Return 1 per metre nearer and per second held, plus 10 for success and minus 1 for failure."""
        held_s = self.t_move_s * (now.course["held_s"] > 0)
        ends = 10.0 * self.success(now) - 1.0 * self.failure(now)
        return distance_m(before) - distance_m(now) + held_s + ends

    def success(self, now: AnyMoment) -> Number:
        return now.free & (now.course["held_s"] >= self.hold_s - 1e-9)

    def info(self, now: AnyMoment) -> Info:
        return {"distance_m": distance_m(now), **now.course}


def distance_m(now: AnyMoment) -> Number:
    """Return the distance from the waypoint, metres."""
    return distance(now.course["waypoint_m"], now.position_m)


class Hover(FlightEnv[HoverTask]):
    """Flies to waypoints; `reset` samples one, or takes `options={"waypoint_m": [north, east, down]}`."""

    task_class = HoverTask
