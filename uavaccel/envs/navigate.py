"""`uavaccel/Navigate-v0`: a goal 20 to 40 m off, through a world of random clutter."""

from __future__ import annotations

import math
import operator
from collections.abc import Mapping, Sequence
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from uavaccel.config import Count, Height, Speed
from uavaccel.envs.flight_env import FlightEnv
from uavaccel.envs.task import TURNED, Mirror, Positive, Task, distance
from uavaccel.envs.values import AnyMoment, Course, Info, Number
from uavaccel.errors import UserError
from uavaccel.kinematics import Kinematics
from uavaccel.sim.clutter import ASIDE_M, NORTH_M, Clutter, ClutterLayout, sample_world
from uavaccel.sim.lane import SPLIT_SIZE, Split, lane_seed

NEAR_M, FAR_M = 15.0, 2.0  # the distance that counts as 1, and the most that is told
GOAL_MOST_M = 43.0
HEIGHTS_M = (0.3, 6.0)
Pixels = Annotated[int, Field(ge=16, le=256)]


class NavigateTask(Task):
    """Fly north past pillars, spheres and ellipsoids to a goal, which wins; a collision, or leaving the area, loses."""

    scene: ClassVar[str] = "clutter"
    reset_options: ClassVar[tuple[str, ...]] = ("world",)
    flat_state: ClassVar[bool] = True

    observation: Literal["dvs", "state", "colour", "depth"] = "depth"
    """What the agent observes: depth, event images, colour, or the state: goal and velocity."""
    speed_m_s: Speed = 3.0
    """Speed of a velocity at full deflection, m/s."""
    altitude_m: Height = 2.0
    """Height of start and goal above the ground, metres."""
    max_commands: Count = 200
    """Commands after which a game is truncated."""
    clutter: Clutter = Clutter()
    """The distribution of the worlds."""
    picture_size: tuple[Pixels, Pixels] = (64, 36)
    """Columns and rows of pictures, which are frames as they are; those of 256 x 144 are reduced to 64 x 36."""
    split: Split = "training"
    """Which worlds are flown: those for training, for evaluation, or for the test of what was chosen in these."""
    goal_m: tuple[Positive, Positive] = (20.0, 40.0)
    """Range of distances from start to goal, metres."""
    goal_bearing_deg: Annotated[float, Field(ge=0.0, le=30.0)] = 30.0
    """Largest bearing of the goal to either side of straight ahead, degrees."""
    also_attitude: bool = False
    """Whether the state also has the attitude, as a quaternion, and the body's rates, rad/s: 7 numbers more."""
    reach_m: Positive = 1.0
    """Distance from the goal, in metres, that wins."""

    @model_validator(mode="after")
    def _goal_is_in_the_area(self) -> Self:
        if not self.goal_m[0] <= self.goal_m[1] <= GOAL_MOST_M:
            raise ValueError(f"goal_m = {list(self.goal_m)}: must be a range of metres up to {GOAL_MOST_M:g}")
        if not HEIGHTS_M[0] < self.altitude_m < HEIGHTS_M[1]:
            raise ValueError(f"altitude_m = {self.altitude_m:g}: must be within {HEIGHTS_M[0]:g} to {HEIGHTS_M[1]:g}")
        return self

    def sample(self, random: np.random.Generator, options: Mapping[str, object]) -> Course:
        world, far, aside = int(random.integers(SPLIT_SIZE)), float(random.random()), float(random.random())
        try:
            world = operator.index(options.get("world", world))  # type: ignore[arg-type]
            lane_seed(self.split, world)
        except (TypeError, ValueError):
            raise UserError(
                f"reset: option world = {options['world']!r}: must be an index from 0 to {SPLIT_SIZE - 1}"
            ) from None
        goal_m = self.goal_m[0] + far * (self.goal_m[1] - self.goal_m[0])
        bearing = math.radians(self.goal_bearing_deg) * (2.0 * aside - 1.0)
        return {"world": world, "goal_m": [goal_m * math.cos(bearing), goal_m * math.sin(bearing), -self.altitude_m]}

    def layout(self, course: Course) -> Mapping[str, object]:
        seed, clutter = lane_seed(self.split, course["world"]), self.clutter.model_dump(mode="json")
        return {"clutter": clutter, "seed": seed, "goal_m": list(course["goal_m"])}

    def lane_layout(self, course: Course) -> ClutterLayout:
        return sample_world(lane_seed(self.split, course["world"]), self.clutter, course["goal_m"])

    def fields(self, state: Kinematics, course: Course) -> Sequence[Number]:
        """List the direction to the goal, its distance in 15 m, at most 2, and the velocity; perhaps the attitude."""
        way_m = [there - here for there, here in zip(course["goal_m"], state.position_m, strict=True)]
        far_m = distance(course["goal_m"], state.position_m)
        far = far_m / NEAR_M
        told = far - (far - FAR_M) * (far > FAR_M)
        attitude = (*state.orientation_wxyz, *state.angular_velocity_rad_s) if self.also_attitude else ()
        return [*(each / (far_m + 1e-3) for each in way_m), told, *state.linear_velocity_m_s, *attitude]

    def mirrored(self) -> Mirror:
        attitude = (8, -9, 10, -11, -12, 13, -14) if self.also_attitude else ()
        return Mirror((1, -2, 3, 4, 5, -6, 7, *attitude), TURNED[self.action])

    def reward(self, before: AnyMoment, now: AnyMoment) -> Number:
        """Return 0.3 per metre nearer to the goal, 5 for success, -12 for failure, and -0.01."""
        return 0.3 * (distance_m(before) - distance_m(now)) + 5.0 * self.success(now) - 12.0 * self.failure(now) - 0.01

    def success(self, now: AnyMoment) -> Number:
        return now.free & (distance_m(now) <= self.reach_m)

    def failure(self, now: AnyMoment) -> Number:
        north, east, down = now.position_m
        outside = (north < NORTH_M[0]) | (north > NORTH_M[1]) | (abs(east) > ASIDE_M)
        return now.touched | outside | (-down < HEIGHTS_M[0]) | (-down > HEIGHTS_M[1])

    def info(self, now: AnyMoment) -> Info:
        return {"distance_m": distance_m(now), **now.course}


def distance_m(now: AnyMoment) -> Number:
    """Return the distance from the goal, metres."""
    return distance(now.course["goal_m"], now.position_m)


class Navigate(FlightEnv[NavigateTask]):
    """Flies to goals through clutter; `reset` samples world and goal, or takes `options={"world": index}`."""

    task_class = NavigateTask
