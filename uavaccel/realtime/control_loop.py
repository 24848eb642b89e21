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
from uavaccel.realtime.plant import Action, Passed, Period, Plant, copied, counted
from uavaccel.units import CLOCK_SPEEDS, ceil_div, real

Command = Literal["adsc", "tcsc"]
Meanwhile = Literal["hold", "default"]
MOST_ACTIONS = 4_096  # of a chunk, or observed


@dataclass
class LoopOptions:
    """How an agent and its environment take turns. Raises UserError for values that do not fit.

    Under "adsc" the environment goes on while the agent thinks, at `clock_speed` simulated seconds per second of wall
    time; under "tcsc" it is paused. An action is a `chunk` of so many, a control period each, of which `execute`
    are applied before the next observation; what is left of the chunk goes on while the agent thinks. Where that queue
    runs dry, `meanwhile` follows: the action applied last ("hold"), or the `default_action`, which is zero in a Box.

    The agent observes again `execute` periods after its actions arrived, as the paper's client does. With `overlap`
    (asynchronous inference) it observes `execute` periods after its last observation, or as soon as its actions are on
    their way if its thinking took longer. With `early` it begins to think so many periods before its `execute` actions
    have been applied, and the next chunk waits for their end. With `head_start` an episode begins with its first
    actions, not with its first observation.

    With `frozen_prefix` a chunk begins at its observation: the actions for periods that had passed when it arrived are
    dropped, since those of the chunk before have been applied there, the prefix that real-time chunking freezes (Black
    et al., arXiv 2506.07339). With `ensemble` = m all chunks that have an action for a period are averaged there, the
    oldest with weight 1, the i-th after it with exp(-m i): temporal ensembling (Zhao et al., arXiv 2304.13705).

    `period_s` are the simulated seconds of a control period, where the environment does not say. `observe_age`,
    `observe_actions` and `observe_planned` append to the observation, which is flat then, how old the last one was
    when its action was applied, in simulated seconds, the latest actions, and the actions of the next periods as they
    are applied unless others arrive.
    """

    command: Command = "adsc"
    clock_speed: float = 1.0
    meanwhile: Meanwhile = "hold"
    default_action: Any = None
    chunk: int = 1
    execute: int | None = None
    overlap: bool = False
    early: int = 0
    head_start: bool = False
    frozen_prefix: bool = False
    ensemble: float | None = None
    period_s: float | None = None
    observe_age: bool = False
    observe_actions: int = 0
    observe_planned: int = 0
    speed: Fraction = field(init=False)

    def __post_init__(self) -> None:
        for name, kind in (("command", Command), ("meanwhile", Meanwhile)):
            if (value := getattr(self, name)) not in get_args(kind):
                raise UserError(f"{name}: must be {' or '.join(map(repr, get_args(kind)))}, not {value!r}")
        self.execute = self.chunk if self.execute is None else self.execute
        for name, least in {"chunk": 1, "execute": 1, "early": 0, "observe_actions": 0, "observe_planned": 0}.items():
            setattr(self, name, counted(name, getattr(self, name), least, MOST_ACTIONS, " actions"))
        self._check_chunks()
        speed, (slowest, fastest) = real(self.clock_speed), CLOCK_SPEEDS
        self.speed = positive_clock_speed(self.clock_speed if speed is None else speed)
        if not slowest <= float(self.speed) <= fastest:
            raise UserError(f"clock_speed must be {slowest:g} to {fastest:g}, not {self.clock_speed}")

    def _check_chunks(self) -> None:
        assert self.execute is not None
        if self.execute > self.chunk:
            raise UserError(f"execute: must be at most chunk = {self.chunk}, not {self.execute}")
        if self.early >= self.execute and self.early:
            raise UserError(f"early: must be less than execute = {self.execute}, not {self.early}")
        if self.early and self.overlap:
            raise UserError("early, overlap: each says when the agent observes again; give one of them")
        for name in ("frozen_prefix", "ensemble"):
            if self.chunk == 1 and getattr(self, name) not in (False, None):
                raise UserError(f"{name}: needs a chunk of 2 or more actions")
        weight = real(self.ensemble)
        if self.ensemble is not None and not (weight is not None and 0 <= weight < float("inf")):
            raise UserError(f"ensemble: must be a number of 0 or more, such as 0.01, not {self.ensemble!r}")
        self.ensemble = weight

    def action_space(self, single: spaces.Space[Any]) -> spaces.Space[Any]:
        """Return the space of a chunk of actions. Raises UserError for a space whose actions do not stack."""
        if self.ensemble is not None and not isinstance(single, spaces.Box):
            raise UserError(f"ensemble: actions of a {type(single).__name__} have no mean")
        if self.chunk == 1:
            return single
        if isinstance(single, spaces.Box) or (isinstance(single, spaces.Discrete) and single.start == 0):
            return batch_space(single, self.chunk)
        raise UserError(f"chunk: actions of a {type(single).__name__} do not stack; use chunk=1")

    def idle_action(self, single: spaces.Space[Any]) -> Action:
        """Return the action before an agent's first one. Raises UserError without a default in a space but Box."""
        if self.default_action is None:
            if isinstance(single, spaces.Box):
                return np.clip(np.zeros(single.shape, single.dtype), single.low, single.high)
            raise UserError(f"default_action: a {type(single).__name__} has no neutral action; name one")
        action = copied(self.default_action)
        if isinstance(single, spaces.Box | spaces.MultiBinary | spaces.MultiDiscrete):  # whose actions are arrays
            try:
                action = np.asarray(action, single.dtype)
            except (TypeError, ValueError):  # no array of numbers
                action = None
        if action is None or not single.contains(action):
            raise UserError(f"default_action: {self.default_action!r} is not in {single}")
        return action


class ControlLoop:
    """The loop that applies an agent's actions to a plant, and the planned or idle ones while the agent thinks.

    It keeps copies: an agent may reuse the array of its last action. `goes_on` says whether time passes until the next
    actions arrive, `waited` for how many ticks the last ones were waited for, from their observation on.
    """

    def __init__(self, plant: Plant, options: LoopOptions, action_space: spaces.Space[Any]) -> None:
        self.plant, self.options = plant, options
        self.acts_singly = options.chunk == 1
        self._runs = options.command == "adsc"
        looks_ahead = self._runs or options.frozen_prefix or options.observe_planned > 0
        self._default = options.idle_action(action_space) if looks_ahead else None
        self._holds = options.meanwhile == "hold"
        self._act_ticks = ((options.execute or 1) - options.early) * plant.period_ticks
        self._numerator, denominator = options.speed.as_integer_ratio()
        self._tick_wall = plant.tick_ns * denominator  # wall ns of `numerator` ticks
        self.begin()

    def begin(self) -> None:
        """Begin an episode, with nothing planned and the default action as the last one."""
        self.plant.reset()
        self._chunks: list[tuple[int, Any]] = []  # each with the tick at which it begins, the oldest first
        self._tick = self._queued = self.waited = 0
        self._idle = self._default
        self.goes_on = self._runs and not self.options.head_start

    def ticks_within(self, wall_ns: int) -> int:
        """Return the ticks that pass while an agent thinks: an action waits for the end of the tick it arrives in."""
        return ceil_div(wall_ns * self._numerator, self._tick_wall) if self.goes_on else 0

    def wall_ns(self, ticks: int) -> int:
        """Return the wall time of a number of ticks."""
        return ceil_div(ticks * self._tick_wall, self._numerator)

    def wall_ns_of_periods(self, periods: int) -> int:
        """Return the longest wall time within which no more than so many control periods pass.

        Raises UserError where fewer pass in it: where a tick takes less than a nanosecond of it.
        """
        ticks = periods * self.plant.period_ticks
        wall_ns = ticks * self._tick_wall // self._numerator
        if ceil_div(wall_ns * self._numerator, self._tick_wall) < ticks:
            tick_ns, speed = self.plant.tick_ns, self.options.clock_speed
            raise UserError(f"delay_steps: ticks of {tick_ns} ns are shorter than 1 ns at clock_speed {speed:g}")
        return wall_ns

    def step(self, action: Action) -> Period:
        """Apply a single action for its control period; no time has passed since the last observation."""
        self._chunks.clear()
        if self._holds:
            self._idle = copied(action)
        self.waited, self.goes_on = 0, self._runs
        return self.plant.step(action)

    def act(self, action: Action, waited: int, before: Passed | None = None) -> Passed:
        """Apply the agent's actions, which arrive `waited` ticks after their observation, up to the next observation.

        `before` is the result of those ticks, with nothing after it where the episode ended in them, or where thinking
        outlasted the actions. Raises UserError for a chunk of another length than the options say.
        """
        options, action = self.options, copied(action)
        if options.chunk > 1 and np.shape(action)[:1] != (options.chunk,):
            raise UserError(f"action: must be a chunk of {options.chunk}, not of shape {np.shape(action)}")
        if waited < self._queued and (before is None or not before.over):
            before = self.advance(self._queued - waited, before)
            waited = before.ticks
        self.waited = waited
        if before is not None and before.over:
            return before
        begins = self._tick - waited if options.frozen_prefix else self._tick
        older = self._chunks if options.ensemble is not None else []
        self._chunks = [*older, (begins, action if options.chunk > 1 else [action])]
        self._queued, self.goes_on = options.early * self.plant.period_ticks, self._runs
        ticks = max(self._act_ticks - waited, 0) if options.overlap else self._act_ticks
        return before if ticks == 0 and before is not None else self.advance(ticks, before)

    def advance(self, ticks: int, before: Passed | None = None) -> Passed:
        """Let at least one tick pass under the planned actions, and return the result added to that of `before`."""
        left = ticks
        while True:
            action, count = self._planned_at(self._tick)
            count = min(count or left, left)
            if self._holds:
                self._idle = action
            passed = self.plant.advance(action, count)
            self._tick += count
            if before is not None:
                passed = passed._replace(reward=before.reward + passed.reward, ticks=before.ticks + passed.ticks)
            before, left = passed, left - count
            if left == 0 or passed.over:
                return passed

    def planned(self, periods: int) -> list[Action]:
        """Return the actions at the beginnings of the next periods, as they are applied unless others arrive."""
        return [self._planned_at(self._tick + place * self.plant.period_ticks)[0] for place in range(periods)]

    def _planned_at(self, tick: int) -> tuple[Action, int]:
        """Return the action at a tick, the present one or a later one, and how many ticks it stays; 0: for good."""
        period, options = self.plant.period_ticks, self.options
        self._chunks = [each for each in self._chunks if self._tick < each[0] + options.chunk * period]
        there = [(tick - begins, chunk) for begins, chunk in self._chunks if tick < begins + options.chunk * period]
        if not there:
            dry = self._chunks[-1][1][-1] if self._chunks and self._holds else self._idle
            return dry, 0
        stays = min(period - since % period for since, _ in there)
        actions = [chunk[since // period] for since, chunk in there]
        if len(actions) == 1:
            return actions[0], stays
        weights = np.exp(-(options.ensemble or 0.0) * np.arange(len(actions)))
        mean = np.tensordot(weights / weights.sum(), np.asarray(actions, float), 1)
        return mean.astype(actions[0].dtype), stays


class Extras:
    """What an agent is told beside the observation: entries of it, which is flat then, and of the info.

    They are the age of the last observation, the latest actions, and the planned ones. `single` is the space of one
    action, not of a chunk. Raises UserError where observations, or the actions among them, are not arrays.
    """

    def __init__(self, observation: spaces.Space[Any], single: spaces.Space[Any], options: LoopOptions) -> None:
        self.space, self._single, self._action = observation, single, options.action_space(single)
        self._age, count, self._periods = options.observe_age, options.observe_actions, options.observe_planned
        self._planned = options.chunk if options.frozen_prefix else 0
        self._latest: deque[Any] = deque(maxlen=count)
        self._any = self._age or count > 0 or self._periods > 0
        if not self._any:
            return
        if not isinstance(observation, spaces.Box):
            asked = "observe_age, observe_actions, observe_planned"
            raise UserError(f"{asked}: need a Box of observations, not {observation}")
        if (count or self._periods) and not single.is_np_flattenable:
            name = type(single).__name__
            raise UserError(f"observe_actions, observe_planned: actions of a {name} have no fixed length")
        bounds = [(observation.low.ravel(), observation.high.ravel())]
        if self._age:
            bounds.append((np.zeros(1), np.full(1, np.inf)))
        if count:
            self._size, flat = spaces.flatdim(self._action), cast(spaces.Box, spaces.flatten_space(self._action))
            bounds += [(np.minimum(flat.low, 0), np.maximum(flat.high, 0))] * count
        if self._periods:
            flat = cast(spaces.Box, spaces.flatten_space(single))
            bounds += [(flat.low, flat.high)] * self._periods
        self._type = np.result_type(observation.dtype, np.float32)
        low, high = (np.concatenate(ends).astype(self._type) for ends in zip(*bounds, strict=True))
        self.space = spaces.Box(low, high, dtype=self._type.type)

    def begin(self) -> None:
        """Begin an episode, with zeros for the latest actions."""
        self._latest.extend(np.zeros(self._size) for _ in range(self._latest.maxlen or 0))

    def note(self, action: Action) -> None:
        """Note an action before the environment, which may change it, is given it."""
        if self._latest.maxlen:
            self._latest.append(np.asarray(spaces.flatten(self._action, action), float))

    def told(self, observation: Any, info: dict[str, Any], age_s: float, loop: ControlLoop | None) -> Any:
        """Return the observation with its further entries, and add those of the info.

        They are the age in simulated seconds, the latest actions, the last one last, and those of the next periods.
        """
        if self._planned and loop is not None:
            info["planned"] = np.stack(loop.planned(self._planned))
        if not self._any:
            return observation
        age = [np.array([age_s])] if self._age else []
        planned = loop.planned(self._periods) if loop is not None else []
        flat = [spaces.flatten(self._single, action) for action in planned]
        return np.concatenate([np.ravel(observation), *age, *self._latest, *flat]).astype(self._type)
