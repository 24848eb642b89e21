"""The control loop of an agent that needs time to think: the environment goes on meanwhile, then its actions follow."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any, Literal, cast, get_args

import numpy as np
from gymnasium import spaces
from gymnasium.vector.utils import batch_space

from uavaccel.clock import positive_clock_speed
from uavaccel.errors import UserError
from uavaccel.limits import CLOCK_SPEEDS, MOST_ACTIONS
from uavaccel.realtime.plant import Action, Passed, Period, Plant, copied
from uavaccel.units import ceil_div, real, whole

Command = Literal["adsc", "tcsc"]
Meanwhile = Literal["hold", "default"]


@dataclass
class LoopOptions:
    """How an agent and its environment take turns. Raises UserError for values that do not fit.

    Under "adsc" the environment goes on while the agent thinks, at `clock_speed` simulated seconds per second of wall
    time; under "tcsc" it is paused. An action is a `chunk` of so many, a control period each, of which `execute`
    are applied before the next observation; what is left of the chunk goes on while the agent thinks, and after it
    `meanwhile`: the action applied last ("hold"), or the `default_action`, which is zero in a Box. With `overlap` the
    agent observes `execute` periods after its last observation, or as soon as its actions are on their way if its
    thinking took longer; without it, `execute` periods after its actions arrived, as the paper's client does.

    `period_s` are the simulated seconds of a control period, where the environment does not say. `observe_age` and
    `observe_actions` append to the observation, which is flat then, how old the last one was when its action was
    applied, in simulated seconds, and the latest actions.
    """

    command: Command = "adsc"
    clock_speed: float = 1.0
    meanwhile: Meanwhile = "hold"
    default_action: Any = None
    chunk: int = 1
    execute: int | None = None
    overlap: bool = False
    period_s: float | None = None
    observe_age: bool = False
    observe_actions: int = 0
    speed: Fraction = field(init=False)

    def __post_init__(self) -> None:
        for name, kind in (("command", Command), ("meanwhile", Meanwhile)):
            if (value := getattr(self, name)) not in get_args(kind):
                raise UserError(f"{name}: must be {' or '.join(map(repr, get_args(kind)))}, not {value!r}")
        self.execute = self.chunk if self.execute is None else self.execute
        for name, least in {"chunk": 1, "execute": 1, "observe_actions": 0}.items():
            value = getattr(self, name)
            if (count := whole(value)) is None or not least <= count <= MOST_ACTIONS:
                raise UserError(f"{name}: must be a count of actions, {least} to {MOST_ACTIONS}, not {value!r}")
            setattr(self, name, count)
        if self.execute > self.chunk:
            raise UserError(f"execute: must be at most chunk = {self.chunk}, not {self.execute}")
        speed, (slowest, fastest) = real(self.clock_speed), CLOCK_SPEEDS
        self.speed = positive_clock_speed(self.clock_speed if speed is None else speed)
        if not slowest <= self.speed <= fastest:
            raise UserError(f"clock_speed must be {slowest:g} to {fastest:g}, not {self.clock_speed}")

    def action_space(self, single: spaces.Space[Any]) -> spaces.Space[Any]:
        """Return the space of a chunk of actions. Raises UserError for a space whose actions do not stack."""
        if self.chunk == 1:
            return single
        if isinstance(single, spaces.Box) or (isinstance(single, spaces.Discrete) and single.start == 0):
            stacked: spaces.Space[Any] = batch_space(single, self.chunk)
            return stacked
        raise UserError(f"chunk: actions of a {type(single).__name__} do not stack; use chunk=1")

    def idle_action(self, single: spaces.Space[Any]) -> Action:
        """Return the action before an agent's first one. Raises UserError without a default in a space but Box."""
        if self.default_action is None:
            if isinstance(single, spaces.Box):
                return np.clip(np.zeros(single.shape, single.dtype), single.low, single.high)
            raise UserError(f"default_action: a {type(single).__name__} has no neutral action; name one")
        action = copied(self.default_action)
        if isinstance(single, spaces.Box):
            try:
                action = np.asarray(action, single.dtype)
            except (TypeError, ValueError):  # no array of numbers
                action = None
        if action is None or not single.contains(action):
            raise UserError(f"default_action: {self.default_action!r} is not in {single}")
        return action


class ControlLoop:
    """The loop that applies an agent's actions to a plant, and the planned or idle ones while the agent thinks.

    It keeps copies: an agent may reuse the array of its last action.
    """

    def __init__(self, plant: Plant, options: LoopOptions, action_space: spaces.Space[Any]) -> None:
        self.plant, self.options = plant, options
        self.goes_on = options.command == "adsc"
        self.acts_singly = options.chunk == 1
        self._default = options.idle_action(action_space) if self.goes_on else None
        self._holds = options.meanwhile == "hold"
        self._act_ticks = (options.execute or 1) * plant.period_ticks
        self._numerator, denominator = options.speed.as_integer_ratio()
        self._tick_wall = plant.tick_ns * denominator  # wall ns of `numerator` ticks
        self.begin()

    def begin(self) -> None:
        """Begin an episode, with nothing planned and the default action as the last one."""
        self.plant.reset()
        self._planned: deque[tuple[Action, int]] = deque()
        self._idle = self._default

    def ticks_within(self, wall_ns: int) -> int:
        """Return the ticks that pass while an agent thinks: an action waits for the end of the tick it arrives in."""
        return ceil_div(wall_ns * self._numerator, self._tick_wall) if self.goes_on else 0

    def wall_ns(self, ticks: int) -> int:
        """Return the wall time of a number of ticks."""
        return ceil_div(ticks * self._tick_wall, self._numerator)

    def act_ticks(self, thinking_ticks: int) -> int:
        """Return the ticks from an action's arrival to the next observation."""
        return max(self._act_ticks - thinking_ticks, 0) if self.options.overlap else self._act_ticks

    def step(self, action: Action) -> Period:
        """Apply a single action for its control period; no time has passed since the last observation."""
        if self._planned:
            self._planned.clear()
        if self._holds:
            self._idle = copied(action)
        return self.plant.step(action)

    def act(self, action: Action, ticks: int, before: Passed | None = None) -> Passed:
        """Apply the agent's actions, which have just arrived, for a number of ticks; 0 if thinking outlasted them.

        Raises UserError for a chunk of another length than the options say.
        """
        chunk, action = self.options.chunk, copied(action)
        if chunk > 1 and np.shape(action)[:1] != (chunk,):
            raise UserError(f"action: must be a chunk of {chunk}, not of shape {np.shape(action)}")
        self._planned = deque((one, self.plant.period_ticks) for one in (action if chunk > 1 else [action]))
        return before if ticks == 0 and before is not None else self.advance(ticks, before)

    def advance(self, ticks: int, before: Passed | None = None) -> Passed:
        """Let at least one tick pass under the planned actions, and return the result added to that of `before`."""
        left = ticks
        while True:
            action, count = self._planned.popleft() if self._planned else (self._idle, left)
            if count > left:
                self._planned.appendleft((action, count - left))
                count = left
            if self._holds:
                self._idle = action
            passed = self.plant.advance(action, count)
            if before is not None:
                total, ticks = before.reward + passed.reward, before.ticks + passed.ticks
                passed = passed._replace(reward=total, ticks=ticks)
            before = passed
            left -= count
            if left == 0 or passed.over:
                return before


class Extras:
    """Optional entries of an observation, which is flat then: the age of the last one, and the latest actions.

    Raises UserError where observations are not arrays.
    """

    def __init__(self, observation: spaces.Space[Any], action: spaces.Space[Any], options: LoopOptions) -> None:
        self.space, self._action = observation, action
        self._age, count = options.observe_age, options.observe_actions
        self._latest: deque[Any] = deque(maxlen=count)
        self.any = self._age or count > 0
        if not self.any:
            return
        if not isinstance(observation, spaces.Box):
            raise UserError(f"observe_age, observe_actions: need a Box of observations, not {observation}")
        bounds = [(observation.low.ravel(), observation.high.ravel())]
        if self._age:
            bounds.append((np.zeros(1), np.full(1, np.inf)))
        if count:
            self._size, flat = spaces.flatdim(action), cast(spaces.Box, spaces.flatten_space(action))
            bounds += [(np.minimum(flat.low, 0), np.maximum(flat.high, 0))] * count
        self._type = np.result_type(observation.dtype, np.float32)
        low, high = (np.concatenate(ends).astype(self._type) for ends in zip(*bounds, strict=True))
        self.space = spaces.Box(low, high, dtype=self._type.type)

    def begin(self) -> None:
        """Begin an episode, with zeros for the latest actions."""
        self._latest.extend(np.zeros(self._size) for _ in range(self._latest.maxlen or 0))

    def note(self, action: Action) -> None:
        if self._latest.maxlen:
            self._latest.append(np.asarray(spaces.flatten(self._action, action), float))

    def added(self, observation: Any, age_s: float) -> Any:
        """Return the observation with the age in simulated seconds and the latest actions, the last one last."""
        if not self.any:
            return observation
        age = [np.array([age_s])] if self._age else []
        return np.concatenate([np.ravel(observation), *age, *self._latest]).astype(self._type)
