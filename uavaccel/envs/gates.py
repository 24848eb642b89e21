"""`uavaccel/Gates-v0`: fly north through a sequence of gates, each between two posts."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from uavaccel.envs.flight_env import FlightEnv
from uavaccel.envs.task import Count, Course, Moment, NotNegative, Positive, Task, position_option
from uavaccel.kinematics import Kinematics

POST_M = 0.2  # half the side of a post


class GatesTask(Task):
    """Observations "state": the ways to the next two gates, attitude, velocity and body rate (16,); m, m/s, rad/s."""

    scene: ClassVar[str] = "lane"
    reset_options: ClassVar[tuple[str, ...]] = ("gates_m",)
    speed_m_s: Positive = 3.0
    altitude_m: Positive = 2.0
    gates: Count = 5
    spacing_m: Positive = 6.0
    spread_m: NotNegative = 2.0
    """Gates are drawn so far east or west of the middle, at most."""
    half_width_m: Positive = 1.0
    half_height_m: Positive = 1.0

    def draw(self, random: np.random.Generator, options: Mapping[str, Any]) -> Course:
        north = self.spacing_m * np.arange(1, self.gates + 1)
        east = random.uniform(-self.spread_m, self.spread_m, self.gates)
        drawn = np.stack([north, east, np.full(self.gates, -self.altitude_m)], axis=1)
        return {"gates_m": position_option(options, "gates_m", drawn), "passed": 0, "missed": False}

    def layout(self, course: Course) -> Any:
        beside_m = self.half_width_m + POST_M
        places = [(x, y + side) for x, y, _ in course["gates_m"] for side in (-beside_m, beside_m)]
        return {"obstacles": [{"x_m": x, "y_m": y, "half_side_m": POST_M} for x, y in places]}

    def features(self, state: Kinematics, course: Course) -> NDArray[np.float32]:
        coming = (course["gates_m"][course["passed"] :] or course["gates_m"][-1:]) * 2
        ways = np.subtract([coming[0], coming[1]], state.position_m).ravel()
        return np.concatenate([ways, super().features(state, course)[0, 3:]]).astype(np.float32)

    def advance(self, before: Moment, now: Moment) -> Course:
        passed, missed = now.course["passed"], False
        start, way = np.array(before.position_m), np.subtract(now.position_m, before.position_m)
        for gate in now.course["gates_m"][passed:]:
            if not missed and start[0] < gate[0] <= now.position_m[0]:
                _, beside_m, above_m = abs(start + way * (gate[0] - start[0]) / way[0] - gate)
                missed = bool(beside_m > self.half_width_m or above_m > self.half_height_m)
                passed += not missed
        return {**now.course, "passed": passed, "missed": missed}

    def reward(self, before: Moment, now: Moment) -> float:
        """A point for each metre nearer to the gate that was next, five for each passed; five less for a failure."""
        gate_m, passed = before.course["gates_m"][before.course["passed"]], before.course["passed"]
        nearer_m = math.dist(gate_m, before.position_m) - math.dist(gate_m, now.position_m)
        return nearer_m + 5.0 * (now.course["passed"] - passed) - 5.0 * self.failure(now)

    def success(self, now: Moment) -> bool:
        return now.collision is None and now.course["passed"] == len(now.course["gates_m"])

    def failure(self, now: Moment) -> bool:
        return now.collision is not None or now.course["missed"]


class Gates(FlightEnv):
    """`reset` draws gates, or takes `options={"gates_m": [[north, east, down], ...]}`."""

    task_class = GatesTask
