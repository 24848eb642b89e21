"""Real time on a simulated wall clock, for any Gymnasium environment: the same flight to the byte, every time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
from gymnasium.utils import RecordConstructorArgs

from uavaccel.errors import UserError
from uavaccel.realtime.control_loop import Command, ControlLoop, Extras, LoopOptions
from uavaccel.realtime.plant import HasWallClock, plant_of, refuse_real_time_in
from uavaccel.realtime.thinking import sampled_ns, thinking_time
from uavaccel.units import NS_PER_S

_STREAM = 0x7EA1  # of the generator of thinking times, which leaves the environment's draws as they are


class RealTime(gymnasium.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """Let an environment go on while its agent thinks, on a simulated wall clock.

    Between an observation and the action that follows it `latency_s` of wall time pass: seconds, a list of seconds to
    draw from, the name of a calibration file, "measured" (the time that the agent really takes; the one source that
    does not repeat), or any `ThinkingTime`. Under `command="adsc"` the environment goes on meanwhile, at `clock_speed`
    simulated seconds per second; under "tcsc" it is paused, as the paper's command makes it. See `LoopOptions` for
    the further arguments.

    One tick is a physics step of Gymnasium's MuJoCo environments, elsewhere a control period: `period_s`, or what the
    environment says itself (`dt`, `tau`, dm_control's). An action that arrives within a tick waits for its end. A drone
    of this package keeps its own clocks: make it with `timing="virtual"`, the same command and ClockSpeed.

    Rewards are summed over all that passed since the last observation. Infos gain `thinking_s` (wall time),
    `meanwhile_s` (simulated), and `wall_s` and `simulated_s` of the episode. A wrapper inside counts ticks, not
    decisions: put episode statistics outside.

    Raises UserError for arguments that do not fit, for an environment that is in real time already, and, in a step,
    where that has not the length that the environment says.
    """

    keeps_real_time = True

    def __init__(
        self,
        env: gymnasium.Env[Any, Any],
        latency_s: object = 0.05,
        command: Command = "adsc",
        clock_speed: float = 1.0,
        **keys: Any,
    ) -> None:
        given: dict[str, Any] = {"latency_s": latency_s, "command": command, "clock_speed": clock_speed, **keys}
        RecordConstructorArgs.__init__(self, **given)
        gymnasium.Wrapper.__init__(self, env)
        options = LoopOptions(command, clock_speed, **keys)
        self.thinking = thinking_time(latency_s)
        self._drone = _drone(env, options)
        self._loop = None
        if self._drone is None:
            self._loop = ControlLoop(plant_of(env, options.period_s), options, env.action_space)
            self._tick_s = self._loop.plant.tick_ns / NS_PER_S
        self.action_space = options.action_space(env.action_space)
        self._extras = Extras(env.observation_space, self.action_space, options)
        self.observation_space = self._extras.space
        self._generator = np.random.default_rng()
        self._wall_ns = self._ticks = 0

    def reset(self, *, seed: int | None = None, options: Mapping[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode; a seed is the environment's, and that of thinking times drawn from now on."""
        if seed is not None:
            self._generator = np.random.default_rng([_STREAM, seed])
        observation, info = self.env.reset(seed=seed, options=None if options is None else dict(options))
        if self._loop is not None:
            self._loop.begin()
        self._extras.begin()
        self._wall_ns = self._ticks = 0
        observation = self._extras.added(observation, 0.0)
        self.thinking.observed()
        return observation, info

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Let the thinking time pass, then apply the action; the reward is the sum of both."""
        thinking_ns, loop = sampled_ns(self.thinking, self._generator), self._loop
        if self._extras.any:
            self._extras.note(action)  # the environment may change it
        if loop is None:
            return self._command(action, thinking_ns)
        undelayed = thinking_ns == 0 or not loop.goes_on
        if undelayed and loop.acts_singly:  # as most steps are, at the least cost
            thought, ticks = 0, loop.plant.period_ticks
            observation, reward, terminated, truncated, info = loop.step(action)
        else:
            thought = loop.ticks_within(thinking_ns)
            before = loop.advance(thought) if thought else None
            if before is None or not before.over:
                before = loop.act(action, loop.act_ticks(thought), before)
            observation, reward, terminated, truncated, info, ticks = before
        self._ticks += ticks
        self._wall_ns += loop.wall_ns(ticks) if loop.goes_on else loop.wall_ns(ticks) + thinking_ns
        age_s = min(thought, ticks) * self._tick_s if thought else 0.0
        info["thinking_s"], info["meanwhile_s"] = thinking_ns / NS_PER_S, age_s
        info["wall_s"], info["simulated_s"] = self._wall_ns / NS_PER_S, self._ticks * self._tick_s
        if self._extras.any:
            observation = self._extras.added(observation, age_s)
        self.thinking.observed()
        return observation, float(reward), terminated, truncated, info

    def _command(self, action: Any, thinking_ns: int) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Step a drone, whose own clocks are charged with the thinking time."""
        assert self._drone is not None
        self._drone.charge(thinking_ns / NS_PER_S)
        observation, reward, terminated, truncated, info = self.env.step(action)
        age_s = thinking_ns / NS_PER_S * self._drone.task.clock_speed * (self._drone.task.command == "adsc")
        info = {**info, "thinking_s": thinking_ns / NS_PER_S, "meanwhile_s": age_s}
        observation = self._extras.added(observation, age_s)
        self.thinking.observed()
        return observation, float(reward), terminated, truncated, info


def _drone(env: gymnasium.Env[Any, Any], options: LoopOptions) -> HasWallClock | None:
    """Return the environment that keeps its own clocks, if it is one. Raises UserError where these differ from ours."""
    inside = env.unwrapped
    if not isinstance(inside, HasWallClock):
        return None
    refuse_real_time_in(env)
    task, name = inside.task, type(inside).__name__
    if task.timing != "virtual":
        raise UserError(f"{name}: timing = {task.timing}: make it with timing='virtual' to fly it in real time")
    for key in ("command", "clock_speed"):
        if (there := getattr(task, key)) != (here := getattr(options, key)):
            raise UserError(f"{key}: {here!r} here, but {there!r} in {name}; give both the same")
    for key in ("meanwhile", "default_action", "chunk", "overlap", "period_s"):
        if (value := getattr(options, key)) is not None and value != getattr(LoopOptions, key):
            why = f"{name}'s own task says how long a step is, and it holds its position meanwhile"
            raise UserError(f"{key}: leave it out: {why}")
    return inside
