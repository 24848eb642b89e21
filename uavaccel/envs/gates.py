"""`uavaccel/Gates-v0`: fly north through a sequence of gates, each between two posts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, ClassVar, Self

import numpy as np
from pydantic import Field, model_validator

from uavaccel.config import Height, Speed
from uavaccel.envs.flight_env import FlightEnv
from uavaccel.envs.task import NotNegative, Positive, Task, distance, position_option
from uavaccel.envs.values import AnyMoment, Course, Number
from uavaccel.kinematics import Kinematics
from uavaccel.sim.lane import HULL_RADIUS_M, LENGTH_M, MAX_OBSTACLES, WIDTH_M

POST_M = 0.2  # half the side of a post
NEAREST_M = round(HULL_RADIUS_M + POST_M, 4)  # where a post would touch the vehicle at the start


class GatesTask(Task):
    """Observations "state": vectors to the next two gates, attitude, velocity and body rate (16,); m, m/s, rad/s.

    Beside pictures (`also_state`) the state tells nothing of the gates, which are to be seen: it is the distance below
    their centres, attitude, velocity and body rate (11,).
    """

    scene: ClassVar[str] = "lane"
    flat_state: ClassVar[bool] = True
    reset_options: ClassVar[tuple[str, ...]] = ("gates_m",)
    speed_m_s: Speed = 3.0
    """Speed of a command at full deflection, m/s."""
    altitude_m: Height = 2.0
    """Height of the start and of the gates' centres, metres."""
    gates: Annotated[int, Field(ge=1, le=MAX_OBSTACLES // 2)] = 5
    """Number of gates."""
    spacing_m: Annotated[float, Field(gt=NEAREST_M, le=LENGTH_M)] = 6.0
    """Metres between two gates."""
    spread_m: NotNegative = 2.0
    """Largest distance of a gate east or west of the centre line, metres."""
    half_width_m: Positive = 1.0
    """Half the width of a gate, metres."""
    half_height_m: Positive = 1.0
    """Half the height of a gate, metres."""

    @model_validator(mode="after")
    def _stand_in_the_lane(self) -> Self:
        if (long_m := self.gates * self.spacing_m) > LENGTH_M:
            raise ValueError(
                f"gates = {self.gates} with spacing_m = {self.spacing_m:g} need {long_m:g} m; "
                f"the lane is {LENGTH_M:g} m long"
            )
        if (wide_m := 2 * (self.spread_m + self.half_width_m + POST_M)) > WIDTH_M:
            raise ValueError(
                f"spread_m = {self.spread_m:g} with half_width_m = {self.half_width_m:g} need {wide_m:g} m; "
                f"the lane is {WIDTH_M:g} m wide"
            )
        return self

    def sample(self, random: np.random.Generator, options: Mapping[str, object]) -> Course:
        north = self.spacing_m * np.arange(1, self.gates + 1)
        east = random.uniform(-self.spread_m, self.spread_m, self.gates)
        drawn = np.stack([north, east, np.full(self.gates, -self.altitude_m)], axis=1)
        return {"gates_m": position_option(options, "gates_m", drawn), "passed": 0, "missed": False}

    def layout(self, course: Course) -> object:
        beside_m = self.half_width_m + POST_M
        places = [(x, y + side) for x, y, _ in course["gates_m"] for side in (-beside_m, beside_m)]
        return {"obstacles": [{"x_m": x, "y_m": y, "half_side_m": POST_M} for x, y in places]}

    def fields(self, state: Kinematics, course: Course) -> Sequence[Number]:
        """List the vectors to the next two gates, at the end twice to the last, and the state without its position.

        Beside pictures, list the distance below the gates' centres in place of the vectors.
        """
        if self.observation != "state":
            return [state.position_m[2] + self.altitude_m, *super().fields(state, course)[3:]]
        gates, passed = course["gates_m"], course["passed"]
        coming = [*_gate(gates, passed), *_gate(gates, passed + 1)]
        ways_m = [there - here for there, here in zip(coming, (*state.position_m,) * 2, strict=True)]
        return [*ways_m, *super().fields(state, course)[3:]]

    def advance(self, before: AnyMoment, now: AnyMoment) -> Course:
        passed, start, end = now.course["passed"], before.position_m, now.position_m
        first, missed = passed, passed < 0
        ahead_m = end[0] - start[0]
        for number, (north, east, down) in enumerate(now.course["gates_m"]):
            due = (first <= number) & (missed == 0) & (start[0] < north) & (north <= end[0])
            share = (north - start[0]) / (ahead_m + (ahead_m == 0))
            beside_m = abs(start[1] + (end[1] - start[1]) * share - east)
            above_m = abs(start[2] + (end[2] - start[2]) * share - down)
            outside = (beside_m > self.half_width_m) | (above_m > self.half_height_m)
            missed = missed | (due & outside)
            passed = passed + (due & (outside == 0))
        return {**now.course, "passed": passed, "missed": missed}

    def reward(self, before: AnyMoment, now: AnyMoment) -> Number:
        """Return 1 per metre nearer to the next gate, plus 5 per gate passed and minus 5 for failure."""
        passed = before.course["passed"]
        gate_m = _gate(before.course["gates_m"], passed)
        nearer_m = distance(gate_m, before.position_m) - distance(gate_m, now.position_m)
        return nearer_m + 5.0 * (now.course["passed"] - passed) - 5.0 * self.failure(now)

    def success(self, now: AnyMoment) -> Number:
        return now.free & (now.course["passed"] == len(now.course["gates_m"]))

    def failure(self, now: AnyMoment) -> Number:
        return now.touched | now.course["missed"]


def _gate(gates: Sequence[Sequence[Number]], number: Number) -> list[Number]:
    """Return the position of gate `number`, or of the last one beyond it; arithmetic, so that it works on arrays."""
    last = len(gates) - 1
    chosen = [number == each for each in range(last)] + [number >= last]
    return [sum(is_it * gate[axis] for is_it, gate in zip(chosen, gates, strict=True)) for axis in range(3)]


class Gates(FlightEnv[GatesTask]):
    """Flies through gates; `reset` samples them, or takes `options={"gates_m": [[north, east, down], ...]}`."""

    task_class = GatesTask
