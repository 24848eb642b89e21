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

from uavaccel.config import validate
from uavaccel.envs.conditions import LATENCY, OF_DIFFICULTY, OF_TASK, Ranges, corners, keys_of
from uavaccel.envs.flight_env import CONDITIONS, FlightEnv
from uavaccel.envs.task import AnyMoment, Count, Moment, Task
from uavaccel.envs.told import ContextPlanes, Knowledge
from uavaccel.envs.values import Course, Info, Number
from uavaccel.errors import UserError
from uavaccel.kinematics import Vector
from uavaccel.limits import Height, Seconds
from uavaccel.sim.lane.file import LaneFile, parse_lane
from uavaccel.sim.lane.layout import (
    EVALUATION_SEEDS,
    LENGTH_M,
    WIDTH_M,
    Difficulty,
    LaneLayout,
    Split,
    draw_layout,
    lane_seed,
)

Reward = Annotated[float, Field(ge=-1e6, le=1e6)]
MOST_HEADINGS = 360
Heading = Annotated[float, Field(ge=-360.0, le=360.0)]


class LaneTask(Task):
    """What an `ObstacleLane` environment is made of. T_move, T_sample and speed are the paper's (III-C1)."""

    scene: ClassVar[str] = "lane"
    reset_options: ClassVar[tuple[str, ...]] = ("lane",)
    sees_start: ClassVar[bool] = False

    split: Split = "training"
    """Which lanes are drawn; no lane is both a training and an evaluation lane."""
    difficulty: Difficulty = Difficulty()
    """How hard the lane is, and what the weather and the vehicle are like."""
    lane: LaneFile | None = None
    """One lane for all games, instead of drawn ones: written out, or the name of its YAML file."""
    observation: Literal["dvs", "state", "colour", "depth"] = "dvs"
    """What the agent sees: event-camera images, states, colour or depth images."""

    knows: tuple[Knowledge, ...] = ()
    """What the agent is told beside its pictures: last_action, frame_age."""

    randomise: Ranges | None = None
    """What is drawn anew for each game, wherever the task is flown; None: nothing."""

    t_move_s: Seconds = 1.0
    """Simulated seconds of a command."""
    t_sample_s: Seconds = 0.33
    """Simulated seconds between two samples during a command."""
    headings_deg: Annotated[tuple[Heading, ...], Field(max_length=MOST_HEADINGS)] = (
        -60.0,
        -30.0,
        0.0,
        30.0,
        60.0,
    )
    """The actions: directions of flight, 0 along the lane, positive to the east."""
    altitude_m: Height = 2.0
    """Height that every command holds, as AirSim's moveByVelocityZ; SimpleFlight answers slower the higher it is."""
    max_commands: Count = 300
    """After so many commands the episode is truncated."""

    progress_reward: Reward = 0.1
    """A metre northwards."""
    collision_reward: Reward = -1.0
    """Added when something is touched, which ends the episode."""
    goal_reward: Reward = 0.0
    """Added when the end is reached without a collision."""
    wall_reward: Reward = 0.0
    """Of a command that ends at one of the walls; elsewhere less, with the square of the distance from the middle. The
    walls are plain, and an event camera hardly sees them."""

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
    def _tells_beside_pictures(self) -> LaneTask:
        if self.knows and self.observation == "state":
            raise ValueError(
                "knows needs pictures, beside which it is told: observation dvs, colour or depth"
            )
        if len(set(self.knows)) < len(self.knows):
            raise ValueError("knows must not name one thing twice")
        return self

    @model_validator(mode="after")
    def _ends_can_be_flown(self) -> LaneTask:
        if self.randomise is None:
            return self
        ranges = self.randomise.given()
        if LATENCY in ranges and self.timing != "virtual":
            raise ValueError(
                "randomise.latency_scale needs timing virtual: no other clock has modelled latencies"
            )
        if self.lane is not None and set(ranges) & set(OF_DIFFICULTY):
            raise ValueError(f"randomise needs drawn lanes for {', '.join(OF_DIFFICULTY)}: leave lane out")
        for ends in corners(ranges, alone=not self.randomise.all_drawn):
            keys = self.model_dump(mode="json", exclude={"randomise", "lane"})
            drawn = keys_of(ends)
            for part in ("difficulty", "latency"):
                drawn[part] = keys[part] | drawn[part]
            validate(LaneTask, keys | drawn, "randomise")
        return self

    def told(self) -> ContextPlanes | None:
        """Its last action and the age of its frames, where `knows` says so."""
        if not self.knows:
            return None
        return ContextPlanes(self.knows, self.headings_deg, self.frames_per_command * self.history)

    @property
    def scenery(self) -> str:
        """That of the lane, drawn or one's own."""
        return (self.lane or self.difficulty).scenery

    @property
    def typical_s(self) -> float:
        """Simulated seconds of a game that gets far, for estimates."""
        return min(self.max_commands * self.t_move_s, 1.3 * LENGTH_M / self.speed_m_s)

    def wire_lane(self, index: int) -> dict[str, object]:
        """Lane `index` of the split, or the own one, as Client.set_lane takes it. Raises UserError past a million."""
        if self.lane is not None:
            return self.lane.model_dump(mode="json")
        return {"seed": self._seed_of(index), "difficulty": self.difficulty.model_dump(mode="json")}

    def _seed_of(self, index: int) -> int:
        if not 0 <= index < EVALUATION_SEEDS:
            raise UserError(f"lane {index} does not exist: lanes are 0 to {EVALUATION_SEEDS - 1}")
        return lane_seed(self.split, index)

    def action_space(self) -> spaces.Discrete:
        """The headings."""
        return spaces.Discrete(len(self.headings_deg))

    @property
    def directions(self) -> Sequence[Vector]:
        """Of the headings."""
        headings = [math.radians(heading) for heading in self.headings_deg]
        return [(math.cos(heading), math.sin(heading), 0.0) for heading in headings]

    @property
    def held_z_m(self) -> float:
        return -self.altitude_m

    def draw(self, random: np.random.Generator, options: Mapping[str, Any]) -> Course:
        """A lane of the split, or the one that the options name."""
        drawn = int(random.integers(EVALUATION_SEEDS))
        try:
            return {"lane": operator.index(options.get("lane", drawn))}
        except TypeError:
            raise UserError(f"reset: option lane = {options['lane']!r} must be a whole number") from None

    def draw_conditions(self, random: np.random.Generator, games: int) -> Mapping[str, float]:
        if self.randomise is None:
            return {}
        flown = games if self.split == "training" else self.randomise.widen_over_games
        return self.randomise.widened(flown, self._usual()).draw(random)

    def _usual(self) -> dict[str, tuple[float, float]]:
        """What games are flown under where nothing is randomised."""
        keys = {**self.difficulty.model_dump(), **self.model_dump(include=set(OF_TASK))}
        keys[LATENCY] = self.latency.scale
        return {name: each if isinstance(each, tuple) else (each, each) for name, each in keys.items()}

    def under(self, conditions: Mapping[str, float]) -> Self:
        if not conditions:
            return self
        keys = keys_of(conditions)
        for part in ("difficulty", "latency"):
            keys[part] = getattr(self, part).model_copy(update=keys[part])
        return self.model_copy(update=keys)

    def layout(self, course: Course) -> object:
        return self.wire_lane(course["lane"])

    def drawn(self, course: Course) -> LaneLayout | None:
        own = type(self).layout, type(self).wire_lane
        if self.lane is not None or own != (LaneTask.layout, LaneTask.wire_lane):
            return super().drawn(course)
        return draw_layout(self._seed_of(course["lane"]), self.difficulty)

    def reward(self, before: AnyMoment, now: AnyMoment) -> Number:
        progress_m = now.position_m[0] - before.position_m[0]
        ends = self.goal_reward * self.success(now) + self.collision_reward * self.failure(now)
        from_middle = 2.0 * now.position_m[1] / WIDTH_M
        return self.progress_reward * progress_m + self.wall_reward * (from_middle * from_middle) + ends

    def success(self, now: AnyMoment) -> Number:
        """The lane's end without a collision (paper, section III-C3)."""
        return now.free & (now.position_m[0] >= LENGTH_M)

    def info(self, now: Moment) -> Info:
        """How far north it got, the lane's index, and the conditions, where they were drawn."""
        drawn = {name: now.course[name] for name in (CONDITIONS,) if name in now.course}
        return {"distance_m": float(now.position_m[0]), "lane": now.course["lane"], **drawn}


class ObstacleLane(FlightEnv[LaneTask]):
    """The lane; `reset` draws one, or takes `options={"lane": index}` of the task's split."""

    task_class = LaneTask
