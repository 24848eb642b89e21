"""Tasks that a user might write, over which the engines must agree: own goals, features, conditions and ends."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any, ClassVar, Self

import numpy as np
from gymnasium import spaces

from uavaccel.envs.flight_env import FlightEnv
from uavaccel.envs.obstacle_lane import LaneTask
from uavaccel.envs.task import Task, distance
from uavaccel.envs.values import Action, AnyMoment, Course, Info, Number
from uavaccel.kinematics import BodyRatesGoal, Kinematics, VelocityGoal


class PostTask(Task):
    """Fly to a post and past it with a heading of one's own: velocities, a turn rate, and speeds sampled per game."""

    scene: ClassVar[str] = "lane"
    speed_m_s: float = 2.0
    climb_m_s: float = 1.0
    altitude_m: float = 1.0
    max_commands: int = 6
    ends_at_touch: bool = True

    def action_space(self) -> spaces.Space[Action]:
        return spaces.Box(-1.0, 1.0, (4,), np.float32)

    def goal(self, action: Action) -> VelocityGoal:
        north, east, down, turn = action
        speed = self.speed_m_s
        return VelocityGoal((north * speed, east * speed, down * self.climb_m_s), None, turn * 1.5)

    def sample(self, random: np.random.Generator, options: Mapping[str, object]) -> Course:
        post = [2.0 + float(random.random()), float(random.uniform(-0.3, 0.3)), -1.0]
        return {"post_m": post, "fastest_m_s": 0.0, "turns": 0, "low": False}

    def sample_conditions(self, random: np.random.Generator, games: int) -> Mapping[str, float]:
        sampled = {"speed_m_s": random.uniform(1.0, 4.0), "altitude_m": random.uniform(0.7, 2.0)}
        return {name: float(value) for name, value in sampled.items()}

    def with_conditions(self, conditions: Mapping[str, float]) -> Self:
        return self.model_copy(update=dict(conditions))

    def layout(self, course: Course) -> object:
        north, east, _ = course["post_m"]
        return {"obstacles": [{"x_m": north, "y_m": east, "half_side_m": 0.4}], "wind_m_s": [0.5, 0.0, 0.0]}

    def features(self, state: Kinematics, course: Course) -> Any:
        way_m = [there - here for there, here in zip(course["post_m"], state.position_m, strict=True)]
        motion = [*state.linear_velocity_m_s[:2], state.angular_velocity_rad_s[2]]
        return [way_m, motion, [state.time_ns * 1e-9, course["fastest_m_s"], 1.0]]

    def advance(self, before: AnyMoment, now: AnyMoment) -> Course:
        north_m_s, was_m_s = now.state.linear_velocity_m_s[0], now.course["fastest_m_s"]
        fastest = was_m_s + (north_m_s - was_m_s) * (north_m_s > was_m_s)
        turned = (before.state.angular_velocity_rad_s[2] > 0) != (now.state.angular_velocity_rad_s[2] > 0)
        low = now.course["low"] | (now.state.position_m[2] > -0.6)
        return {**now.course, "fastest_m_s": fastest, "turns": now.course["turns"] + turned, "low": low}

    def reward(self, before: AnyMoment, now: AnyMoment) -> Number:
        passed_m = now.position_m[0] - before.position_m[0]
        hits = 3.0 * (now.collision == "obstacle_00") + 2.0 * (now.collision == "ground")
        seconds = (now.state.time_ns - before.state.time_ns) * 1e-9
        return passed_m - hits - 0.1 * seconds + 0.01 * before.commands - 0.5 * now.course["low"]

    def success(self, now: AnyMoment) -> Number:
        return now.free & (now.position_m[0] > now.course["post_m"][0])

    def failure(self, now: AnyMoment) -> Number:
        lost = (now.course["turns"] > 3) | (abs(now.state.linear_acceleration_m_s2[0]) > 9.0)
        return (now.touched & self.ends_at_touch) | lost

    def info(self, now: AnyMoment) -> Info:
        far_m = distance(now.course["post_m"], now.position_m)
        parts = [getattr(now.state, field.name) for field in fields(now.state)[1:]]
        state = [now.state.time_ns, *(number for part in parts for number in part)]
        return {"far_m": far_m, "state": state, **now.course}


class Post(FlightEnv[PostTask]):
    task_class = PostTask


class SpinTask(Task):
    """Turn about the vertical as fast as asked, by three of the body's rates and a throttle that is held."""

    flat_state: ClassVar[bool] = True
    sees_start: ClassVar[bool] = False
    max_commands: int = 8
    rate_deg_s: float = 90.0
    t_move_s: float = 0.04
    t_sample_s: float = 0.02

    def action_space(self) -> spaces.Space[Action]:
        return spaces.Discrete(3)

    def goal(self, action: Action) -> BodyRatesGoal:
        turn = action - 1  # whole numbers and truth values, as numbers of a goal
        return BodyRatesGoal(turn > 1, 0.1 * turn, turn * self.rate_deg_s * 0.0174, 0.6)

    def sample(self, random: np.random.Generator, options: Mapping[str, object]) -> Course:
        return {"asked_rad_s": float(random.uniform(-1.0, 1.0))}

    def fields(self, state: Kinematics, course: Course) -> Sequence[Number]:
        return [state.angular_velocity_rad_s[2] - course["asked_rad_s"], *state.orientation_wxyz, 0.5]

    def reward(self, before: AnyMoment, now: AnyMoment) -> Number:
        off = now.state.angular_velocity_rad_s[2] - now.course["asked_rad_s"]
        return -off * off  # as one rounds it in Python and in arrays, unlike a power

    def success(self, now: AnyMoment) -> Number:
        return False


class Spin(FlightEnv[SpinTask]):
    task_class = SpinTask


class PairTask(Task):
    """Fly by two numbers at once, each backwards, still or ahead, under conditions; the course is nested."""

    flat_state: ClassVar[bool] = True
    max_commands: int = 4

    def action_space(self) -> spaces.Space[Action]:
        return spaces.MultiDiscrete([3, 3])

    def goal(self, action: Action) -> VelocityGoal:
        north, east = action - 1
        return VelocityGoal((north * self.speed_m_s, np.array([-1, 0, 1], np.float32)[east + 1], 0), -10)

    def sample_conditions(self, random: np.random.Generator, games: int) -> Mapping[str, float]:
        return {"speed_m_s": float(random.uniform(1.0, 2.0))}

    def with_conditions(self, conditions: Mapping[str, float]) -> Self:
        return self.model_copy(update=dict(conditions))

    def sample(self, random: np.random.Generator, options: Mapping[str, object]) -> Course:
        return {"aim": {"at_m": float(random.random()), "legs_m": [[1.0], [2.0, 3.0]]}, "seen": [{"times": 0}]}

    def advance(self, before: AnyMoment, now: AnyMoment) -> Course:
        [seen], aim = now.course["seen"], now.course["aim"]
        near = abs(now.position_m[0] - aim["at_m"]) < 0.5
        legs_m = [*aim["legs_m"][:1], [2.0, aim["legs_m"][1][1] + 0.25]]
        return {"aim": {**aim, "legs_m": legs_m}, "seen": [{"times": seen["times"] + near}]}

    def reward(self, before: AnyMoment, now: AnyMoment) -> Number:
        return now.position_m[0] * now.course["seen"][0]["times"] + now.course["aim"]["legs_m"][1][1]

    def success(self, now: AnyMoment) -> Number:
        return False

    def info(self, now: AnyMoment) -> Info:
        return {"near": now.course["seen"][0]["times"]}


class FewTask(LaneTask):
    """Lanes of the usual difficulty, of which only three are flown."""

    def sample(self, random: np.random.Generator, options: Mapping[str, object]) -> Course:
        return {"lane": int(random.integers(3))}


class Few(FlightEnv[FewTask]):
    task_class = FewTask


class Pair(FlightEnv[PairTask]):
    task_class = PairTask
