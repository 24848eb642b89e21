"""Real time on a simulated wall clock, for any Gymnasium environment: the same episode to the byte, every time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
from gymnasium.utils import RecordConstructorArgs

from uavaccel.errors import UserError
from uavaccel.realtime.control_loop import Command, ControlLoop, Extras, LoopOptions
from uavaccel.realtime.plant import HasWallClock, plant_of, refuse_real_time_in
from uavaccel.realtime.thinking import LATENCY_S, ThinkingTime, periods, sampled_ns, thinking_generator, thinking_time
from uavaccel.units import NS_PER_S

ITS_TASKS = (
    *("meanwhile", "default_action", "chunk", "overlap", "early", "head_start", "frozen_prefix", "ensemble"),
    *("period_s", "observe_planned"),
)
"""Options that an environment with clocks of its own decides itself."""


class RealTime(gymnasium.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """Let an environment go on while its agent thinks, on a simulated wall clock.

    Between an observation and the action that follows it `latency_s` of wall time pass, by default 0.05: seconds, a
    list of seconds to draw from, the name of a calibration file, "measured" (the time that the agent really takes; the
    one source that does not repeat), or any `ThinkingTime`. Or `delay_steps` pass: a count of control periods, or a
    list of counts to draw from, whatever the ClockSpeed. Under `command="adsc"` the environment goes on meanwhile, at
    `clock_speed` simulated seconds per second; under "tcsc" it is paused, as the paper's command makes it. See
    `LoopOptions` for the further arguments.

    One tick is a physics step of Gymnasium's MuJoCo environments, elsewhere a control period: `period_s`, or what the
    environment says itself (`dt`, `tau`, dm_control's). An action that arrives within a tick waits for its end. An
    environment that models the wall clock itself (uavaccel's own) keeps its clocks, which are charged with the thinking
    time: make it with `timing="virtual"`, the same command and ClockSpeed.

    Rewards are summed over all that passed since the last observation. Infos gain `thinking_s` (wall time),
    `meanwhile_s` (simulated, until the action was applied), and `wall_s` and `simulated_s` of the episode; with
    `frozen_prefix` also `planned` (chunk, ...): the actions of the next periods as they are applied unless others
    arrive. A wrapper inside counts ticks, not decisions: put episode statistics outside.

    Raises UserError for arguments that do not fit, for an environment that is in real time already, and, in a step,
    where that has not the length that the environment says.
    """

    keeps_real_time = True

    def __init__(
        self,
        env: gymnasium.Env[Any, Any],
        latency_s: object = None,
        command: Command = "adsc",
        clock_speed: float = 1.0,
        delay_steps: object = None,
        **keys: Any,
    ) -> None:
        given: dict[str, Any] = {"latency_s": latency_s, "command": command, "clock_speed": clock_speed}
        RecordConstructorArgs.__init__(self, **given, delay_steps=delay_steps, **keys)
        gymnasium.Wrapper.__init__(self, env)
        options = LoopOptions(command, clock_speed, **keys)
        self._clocked = env.unwrapped if isinstance(env.unwrapped, HasWallClock) else None
        self._loop = None
        refuse_real_time_in(env)
        if self._clocked is not None:
            check_clocks(self._clocked, options)
        else:
            self._loop = ControlLoop(plant_of(env, options.period_s), options, env.action_space)
            self._tick_s = self._loop.plant.tick_ns / NS_PER_S
        self.thinking = self._thinking_time(latency_s, delay_steps)
        self.action_space = options.action_space(env.action_space)
        self._extras = Extras(env.observation_space, env.action_space, options)
        self.observation_space = self._extras.space
        self._generator = np.random.default_rng()
        self._wall_ns = self._ticks = 0

    def reset(self, *, seed: int | None = None, options: Mapping[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode; a seed is the environment's, and that of thinking times drawn from now on."""
        if seed is not None:
            self._generator = thinking_generator(seed)
        observation, info = self.env.reset(seed=seed, options=None if options is None else dict(options))
        if self._loop is not None:
            self._loop.begin()
        self._extras.begin()
        self._wall_ns = self._ticks = 0
        observation = self._extras.told(observation, info, 0.0, self._loop)
        self.thinking.observed()
        return observation, info

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Let the thinking time pass, then apply the action; the reward is the sum of both."""
        thinking_ns, loop = sampled_ns(self.thinking, self._generator), self._loop
        self._extras.note(action)
        if loop is None:
            return self._command(action, thinking_ns)
        paused_ns = 0 if loop.goes_on else thinking_ns
        thought = loop.ticks_within(thinking_ns)
        if thought == 0 and loop.acts_singly:  # as most steps are, at the least cost
            ticks = loop.plant.period_ticks
            observation, reward, terminated, truncated, info = loop.step(action)
        else:
            before = loop.advance(thought) if thought else None
            passed = loop.act(action, thought if before is None else before.ticks, before)
            observation, reward, terminated, truncated, info, ticks = passed
        self._ticks += ticks
        self._wall_ns += loop.wall_ns(ticks) + paused_ns
        age_s = loop.waited * self._tick_s
        info["thinking_s"], info["meanwhile_s"] = thinking_ns / NS_PER_S, age_s
        info["wall_s"], info["simulated_s"] = self._wall_ns / NS_PER_S, self._ticks * self._tick_s
        observation = self._extras.told(observation, info, age_s, loop)
        self.thinking.observed()
        return observation, float(reward), terminated, truncated, info

    def _thinking_time(self, latency_s: object, delay_steps: object) -> ThinkingTime:
        if delay_steps is None:
            return thinking_time(LATENCY_S if latency_s is None else latency_s)
        if latency_s is not None:
            raise UserError("latency_s, delay_steps: each says how long the agent thinks; give one of them")
        if self._loop is None:
            name = type(self.env.unwrapped).__name__
            raise UserError(f"delay_steps: {name}'s own task says how long a step is; give latency_s")
        return periods(delay_steps, self._loop.wall_ns_of_periods)

    def _command(self, action: Any, thinking_ns: int) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Step an environment whose own clocks are charged with the thinking time."""
        assert self._clocked is not None
        self._clocked.charge(thinking_ns / NS_PER_S)
        observation, reward, terminated, truncated, info = self.env.step(action)
        age_s = thinking_ns / NS_PER_S * passing(self._clocked)
        info = {**info, "thinking_s": thinking_ns / NS_PER_S, "meanwhile_s": age_s}
        observation = self._extras.told(observation, info, age_s, None)
        self.thinking.observed()
        return observation, float(reward), terminated, truncated, info


def check_clocks(inside: Any, options: LoopOptions) -> None:
    """Raise UserError where an environment with clocks of its own, or a batch of them, differs from the options."""
    task, name = inside.task, type(inside).__name__
    if task.timing != "virtual":
        raise UserError(f"{name}: timing = {task.timing}: make it with timing='virtual' for real time")
    for key in ("command", "clock_speed"):
        if (there := getattr(task, key)) != (here := getattr(options, key)):
            raise UserError(f"{key}: {here!r} here, but {there!r} in {name}; give both the same")
    for key in ITS_TASKS:
        if getattr(options, key) != getattr(LoopOptions, key):
            raise UserError(
                f"{key}: leave it out: {name}'s own task says how long a step is, and what it does meanwhile"
            )


def passing(inside: Any) -> float:
    """Return the simulated seconds that pass in a second of wall time while the agent of such an environment thinks."""
    return float(inside.task.clock_speed) if inside.task.command == "adsc" else 0.0
