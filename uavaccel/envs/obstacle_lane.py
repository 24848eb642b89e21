"""`uavaccel/ObstacleLane-v0`: fly 150 m down a lane of obstacles, seen through a DVS (paper, section III-C1).

All that the paper leaves open is chosen here: task, actions and reward are this project's own.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from gymnasium import spaces
from pydantic import Field, field_validator, model_validator

from uavaccel.config import Count, Height, Seconds, validate
from uavaccel.envs.conditions import LATENCY, OF_DIFFICULTY, OF_TASK, Ranges, corners, keys_of
from uavaccel.envs.flight_env import FlightEnv
from uavaccel.envs.sensors import ContextKind, ContextPlanes
from uavaccel.envs.task import AnyLayout, Task
from uavaccel.envs.values import AnyMoment, Course, Info, Number
from uavaccel.errors import UserError
from uavaccel.kinematics import Vector
from uavaccel.sim.lane import (
    HULL_RADIUS_M,
    LENGTH_M,
    SPLIT_SIZE,
    WIDTH_M,
    Difficulty,
    LaneFile,
    Split,
    is_walled_off,
    lane_seed,
    parse_lane,
    sample_layout,
)

Reward = Annotated[float, Field(ge=-1e6, le=1e6)]
MOST_HEADINGS = 360
STANDARD_HEADINGS_DEG = (-60.0, -30.0, 0.0, 30.0, 60.0)
Heading = Annotated[float, Field(ge=-360.0, le=360.0)]


class LaneTask(Task):
    """The task of an `ObstacleLane` environment. T_move, T_sample and speed are the paper's (section III-C1)."""

    scene: ClassVar[str] = "lane"
    reset_options: ClassVar[tuple[str, ...]] = ("lane",)
    sees_start: ClassVar[bool] = False

    split: Split = "training"
    """Set from which lanes are sampled: training, evaluation, on which variants are chosen, or test, for numbers that
    are published. They share no lane."""
    difficulty: Difficulty = Difficulty()
    """Distribution of the sampled lanes."""
    lane: LaneFile | None = None
    """One lane for all games instead of sampled ones: a mapping, or the name of its YAML file."""
    observation: Literal["dvs", "state", "colour", "depth"] = "dvs"
    """What the agent observes: event images, the state as numbers, colour pictures or depth pictures."""
    knows: tuple[ContextKind, ...] = ()
    """Extra observations, as planes beside the pictures: last_action, frame_age."""
    randomise: Ranges | None = None
    """Ranges of the conditions that are sampled for each game; None: nothing is randomised."""

    t_move_s: Seconds = 1.0
    """T_move, the simulated seconds of a command."""
    t_sample_s: Seconds = 0.33
    """T_sample, the simulated seconds between two samples of a command."""
    headings_deg: Annotated[tuple[Heading, ...], Field(max_length=MOST_HEADINGS)] = STANDARD_HEADINGS_DEG
    """The actions, as directions of flight in degrees: 0 along the lane, positive to the east."""
    altitude_m: Height = 2.0
    """Height in metres that every command holds, as AirSim's moveByVelocityZ; SimpleFlight responds more slowly the
    higher it is."""
    max_commands: Count = 300
    """Commands after which a game is truncated."""

    progress_reward: Reward = 0.1
    """Reward per metre northwards."""
    collision_reward: Reward = -1.0
    """Reward of a collision, which ends the game."""
    goal_reward: Reward = 0.0
    """Reward for reaching the lane's end."""
    wall_reward: Reward = 0.0
    """Reward of a command that ends at a wall, falling with the square of the distance from the centre line to 0 there:
    the walls are plain, and an event camera hardly sees them."""

    @field_validator("lane", mode="before", json_schema_input_type=LaneFile | str | None)
    @classmethod
    def _written_out(cls, lane: object) -> object:
        return parse_lane(lane)

    @field_validator("headings_deg")
    @classmethod
    def _any_heading(cls, headings: tuple[float, ...]) -> tuple[float, ...]:
        if not headings:
            raise ValueError("needs at least one heading")
        if len(set(headings)) < len(headings):
            raise ValueError("must not have one heading twice")
        return headings

    @model_validator(mode="after")
    def _can_be_flown(self) -> Self:
        ranges = {} if self.randomise is None else self.randomise.given()
        wrong = {
            f"lane: obstacles close it from wall to wall; the drone needs a gap above {2 * HULL_RADIUS_M:g} m": (
                self.lane is not None and is_walled_off(self.lane.layout())
            ),
            "knows needs pictures, beside which it is told: observation dvs, colour or depth": (
                self.knows and self.observation == "state"
            ),
            "knows must not name one thing twice": len(set(self.knows)) < len(self.knows),
            f"action = {self.action}: the lane's actions are headings; Hover and Gates take it": (
                self.action != "velocity"
            ),
            "randomise.latency_scale needs timing virtual: no other clock has modelled latencies": (
                LATENCY in ranges and self.timing != "virtual"
            ),
            f"randomise needs drawn lanes for {', '.join(OF_DIFFICULTY)}: leave lane out": (
                self.lane is not None and set(ranges) & set(OF_DIFFICULTY)
            ),
        }
        if why := next((why for why, holds in wrong.items() if holds), None):
            raise ValueError(why)
        if self.randomise is None:
            return self
        for ends in corners(ranges, alone=not self.randomise.all_sampled):
            keys = self.model_dump(mode="json", exclude={"randomise", "lane"})
            extreme = keys_of(ends)
            for part in ("difficulty", "latency"):
                extreme[part] = keys[part] | extreme[part]
            validate(type(self), {**keys, **extreme, "randomise": None}, "randomise")
        return self

    def context_planes(self) -> ContextPlanes | None:
        """Make the planes that `knows` names; None without any."""
        if not self.knows:
            return None
        return ContextPlanes(self.knows, self.headings_deg, self.frames_per_command * self.history)

    @property
    def scenery(self) -> str:
        """Scenery of the lane."""
        return (self.lane or self.difficulty).scenery

    @property
    def typical_s(self) -> float:
        """Simulated seconds of a game that gets far, for estimates of the duration."""
        return min(self.max_commands * self.t_move_s, 1.3 * LENGTH_M / self.speed_m_s)

    def wire_lane(self, index: int) -> dict[str, object]:
        """Return lane `index` of the split, or the user's lane, in the form of Client.set_lane.

        Raises UserError for an index of a million or more.
        """
        if self.lane is not None:
            return self.lane.model_dump(mode="json")
        return {"seed": self._seed_of(index), "difficulty": self.difficulty.model_dump(mode="json")}

    def _seed_of(self, index: int) -> int:
        if not 0 <= index < SPLIT_SIZE:
            raise UserError(f"lane {index} does not exist: lanes are 0 to {SPLIT_SIZE - 1}")
        return lane_seed(self.split, index)

    def action_space(self) -> spaces.Discrete:
        """Return the space of actions, one for each heading."""
        return spaces.Discrete(len(self.headings_deg))

    @property
    def directions(self) -> Sequence[Vector]:
        """Unit vectors of the headings, NED."""
        headings = [math.radians(heading) for heading in self.headings_deg]
        return [(math.cos(heading), math.sin(heading), 0.0) for heading in headings]

    @property
    def held_z_m(self) -> float:
        return -self.altitude_m

    def sample(self, random: np.random.Generator, options: Mapping[str, Any]) -> Course:
        """Sample a lane of the split, or take the one that the options name."""
        sampled = int(random.integers(SPLIT_SIZE))
        try:
            return {"lane": operator.index(options.get("lane", sampled))}
        except TypeError:
            raise UserError(f"reset: option lane = {options['lane']!r} must be a whole number") from None

    def sample_conditions(self, random: np.random.Generator, games: int) -> Mapping[str, float]:
        if self.randomise is None:
            return {}
        flown = games if self.split == "training" else self.randomise.widen_over_games
        return self.randomise.widened(flown, self._usual()).sample(random)

    def _usual(self) -> dict[str, tuple[float, float]]:
        """Return the task's own conditions, as ranges."""
        keys = {**self.difficulty.model_dump(), **self.model_dump(include=set(OF_TASK))}
        keys[LATENCY] = self.latency.scale
        return {name: key if isinstance(key, tuple) else (key, key) for name, key in keys.items()}

    def with_conditions(self, conditions: Mapping[str, float]) -> Self:
        if not conditions:
            return self
        keys = keys_of(conditions)
        for part in ("difficulty", "latency"):
            keys[part] = getattr(self, part).model_copy(update=keys[part])
        return self.model_copy(update=keys)

    def layout(self, course: Course) -> object:
        return self.wire_lane(course["lane"])

    def lane_layout(self, course: Course) -> AnyLayout | None:
        own = type(self).layout, type(self).wire_lane
        if self.lane is not None or own != (LaneTask.layout, LaneTask.wire_lane):
            return super().lane_layout(course)
        return sample_layout(self._seed_of(course["lane"]), self.difficulty)

    def reward(self, before: AnyMoment, now: AnyMoment) -> Number:
        progress_m = now.position_m[0] - before.position_m[0]
        ends = self.goal_reward * self.success(now) + self.collision_reward * self.failure(now)
        from_middle = 2.0 * now.position_m[1] / WIDTH_M
        return self.progress_reward * progress_m + self.wall_reward * (from_middle * from_middle) + ends

    def success(self, now: AnyMoment) -> Number:
        """Return whether it has reached the lane's end without a collision (paper, section III-C3)."""
        return now.free & (now.position_m[0] >= LENGTH_M)

    def info(self, now: AnyMoment) -> Info:
        """Return the distance flown north and the lane's index."""
        return {"distance_m": now.position_m[0], "lane": now.course["lane"]}


class ObstacleLane(FlightEnv[LaneTask]):
    """Flies lanes; `reset` samples one, or takes `options={"lane": index}` of the task's split."""

    task_class = LaneTask
