"""Real time on a simulated wall clock, for any Gymnasium environment: the same episode to the byte, every time."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from functools import partial
from inspect import signature
from typing import Any, cast

import gymnasium
import numpy as np
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv, VectorEnv, VectorWrapper
from numpy.typing import NDArray

from uavaccel.errors import UserError
from uavaccel.realtime.control_loop import Command, ControlLoop, Extras, LoopOptions
from uavaccel.realtime.plant import HasWallClock, HasWallClocks, plant_of, refuse_real_time_in, reward_of
from uavaccel.realtime.thinking import (
    LATENCY_S,
    Drawn,
    Measured,
    ThinkingTime,
    periods,
    sampled_ns,
    thinking_generator,
    thinking_time,
)
from uavaccel.units import NS_PER_S

ITS_TASKS = "meanwhile", "default_action", "chunk", "overlap", "head_start", "period_s", "observe_planned"
"""Options that an environment with clocks of its own decides itself, with those that need a chunk."""


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
        return observation, reward_of(self.env, reward), terminated, truncated, info

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
        return observation, reward_of(self.env, reward), terminated, truncated, info


def check_clocks(inside: Any, options: LoopOptions) -> None:
    """Raise UserError where an environment with clocks of its own, or a batch of them, differs from the options."""
    task, name = inside.task, type(inside).__name__
    if task.timing != "virtual":
        raise UserError(f"{name}: timing = {task.timing}: make it with timing='virtual' for real time")
    for key in ("command", "clock_speed"):
        if (there := getattr(task, key)) != (here := getattr(options, key)):
            raise UserError(f"{key}: {here!r} here, but {there!r} in {name}; give both the same")
    for key in ITS_TASKS:
        if not np.array_equal(getattr(options, key), getattr(LoopOptions, key)):
            raise UserError(
                f"{key}: leave it out: {name}'s own task says how long a step is, and what it does meanwhile"
            )


def passing(inside: Any) -> float:
    """Return the simulated seconds that pass in a second of wall time while the agent of such an environment thinks."""
    return float(inside.task.clock_speed) if inside.task.command == "adsc" else 0.0


Vector = VectorEnv[Any, Any, Any]
AHEAD = 256  # thinking times of an environment that are drawn at once


class RealTimeVector(VectorWrapper[Any, Any, Any, Any]):
    """Let each environment of a vector go on while its agent thinks, with `RealTime`'s arguments.

    Environment i of a vector that is reset with a seed has the thinking times, and does what, a single `RealTime` does
    with seed + i. It takes over Gymnasium's `SyncVectorEnv`s and `AsyncVectorEnv`s, whose processes it starts anew, in
    any autoreset mode, and this package's own batches in the exact simulator or over arrays, whose observations stay
    on their device. `gymnasium.make_vec(ID, 8, wrappers=[partial(RealTime, latency_s=0.05)])` makes the same.

    In a step each environment takes its own simulated time. Raises UserError for arguments that do not fit, and for a
    vector whose environments it cannot reach, or that is in real time already.
    """

    keeps_real_time = True

    def __init__(
        self,
        envs: Vector,
        latency_s: object = None,
        command: Command = "adsc",
        clock_speed: float = 1.0,
        delay_steps: object = None,
        **keys: Any,
    ) -> None:
        source = thinking_time(LATENCY_S if latency_s is None else latency_s) if delay_steps is None else None
        if isinstance(source, Measured):
            raise UserError(
                "latency_s: a batch's agent thinks about all environments at once; "
                "measure one with RealTime, and give the file that its thinking.save() writes"
            )
        given: dict[str, Any] = {"latency_s": latency_s, "command": command, "clock_speed": clock_speed}
        given |= {"delay_steps": delay_steps, **keys}
        refuse_real_time_in(envs)
        inside, kinds = envs.unwrapped, (SyncVectorEnv, AsyncVectorEnv)
        kind = next((kind for kind in kinds if isinstance(inside, kind)), None)
        if isinstance(inside, HasWallClocks):
            super().__init__(_OwnClocks(envs, inside, source, command, clock_speed, **keys))
        elif kind is None or envs is not inside:
            known = "a SyncVectorEnv, an AsyncVectorEnv or a batch of uavaccel's; other wrappers go outside"
            raise UserError(f"RealTimeVector: needs {known}, not {type(envs).__name__}")
        else:
            super().__init__(_timed_again(cast(Any, inside), kind, given))


def _timed_again(inside: Any, kind: type[Any], given: Mapping[str, Any]) -> Vector:
    """Return another vector of a kind, of what makes the environments of this one, each in real time."""
    how = {name: getattr(inside, name) for name in signature(kind).parameters if name != "env_fns"}
    if kind is SyncVectorEnv:
        makers: list[Callable[[], gymnasium.Env[Any, Any]]] = [partial(_same, env) for env in inside.envs]
    else:
        makers = list(inside.env_fns)
        inside.close()
    vector: Vector = kind([partial(_timed, make, given) for make in makers], **how)
    return vector


def _same(env: gymnasium.Env[Any, Any]) -> gymnasium.Env[Any, Any]:
    return env


def _timed(make: Callable[[], gymnasium.Env[Any, Any]], given: Mapping[str, Any]) -> RealTime:
    return RealTime(make(), **deepcopy(dict(given)))  # a source of thinking times may have a state


class _OwnClocks(VectorWrapper[Any, Any, Any, Any]):
    """A batch of environments that keep clocks of their own, which are charged with thinking times."""

    def __init__(
        self,
        envs: Vector,
        inside: HasWallClocks,
        source: ThinkingTime | None,
        command: Command,
        clock_speed: float,
        **keys: Any,
    ) -> None:
        """`source` is None where `delay_steps` are given, which such a batch refuses."""
        super().__init__(envs)
        options, name = LoopOptions(command, clock_speed, **keys), type(inside).__name__
        check_clocks(inside, options)
        for key in ("observe_age", "observe_actions"):
            if getattr(options, key):
                raise UserError(f"{key}: leave it out: observations of {name} stay as they are, on their device")
        if source is None:
            raise UserError(f"delay_steps: {name}'s own task says how long a step is; give latency_s")
        self._inside, self._passing = inside, passing(inside)
        self._sources = [deepcopy(source) for _ in range(self.num_envs)]
        self._same_step = self.metadata["autoreset_mode"] == AutoresetMode.SAME_STEP
        self._generators = [np.random.default_rng() for _ in range(self.num_envs)]
        self._ahead_ns = np.empty((self.num_envs, AHEAD), np.int64)
        self._taken = np.full(self.num_envs, AHEAD)  # of those drawn ahead
        self._going = np.ones(self.num_envs, bool)  # those that step next, and do not begin an episode

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin an episode in every environment; environment i gets `seed` + i, or the i-th of several seeds.

        With the option `reset_mask`, truth values (N,), in those alone.
        """
        begun = self.env.reset(seed=cast(Any, seed), options=options)
        seeds = range(seed, seed + self.num_envs) if isinstance(seed, int | np.integer) else seed
        which = (options or {}).get("reset_mask", np.ones(self.num_envs, bool))
        for place in np.flatnonzero(which).tolist():
            if seeds is not None and (own := seeds[place]) is not None:
                self._generators[place], self._taken[place] = thinking_generator(own), AHEAD
        self._going[which] = True
        return begun

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Charge the thinking times, then step; infos gain `thinking_s` and `meanwhile_s` (N,), on the host."""
        going = self._going.copy()
        thinking_ns = np.zeros(self.num_envs, np.int64)
        thinking_ns[going] = self._drawn_ns(np.flatnonzero(going))
        self._inside.charge_each(thinking_ns)
        observations, rewards, terminated, truncated, infos = self.env.step(actions)
        if not self._same_step:
            self._going = ~(np.asarray(terminated) | np.asarray(truncated))
        thinking_s = thinking_ns / NS_PER_S
        infos |= {"thinking_s": thinking_s, "_thinking_s": going}
        infos |= {"meanwhile_s": thinking_s * self._passing, "_meanwhile_s": going}
        return observations, rewards, terminated, truncated, infos

    def _drawn_ns(self, which: NDArray[np.int64]) -> Any:
        """Return the next thinking times of environments, each from its own generator."""
        source = self._sources[0]
        if not isinstance(source, Drawn):
            return [sampled_ns(self._sources[place], self._generators[place]) for place in which]
        for place in which[self._taken[which] == AHEAD]:
            self._ahead_ns[place], self._taken[place] = source.draw(self._generators[place], AHEAD), 0
        taken_ns = self._ahead_ns[which, self._taken[which]]
        self._taken[which] += 1
        return taken_ns
