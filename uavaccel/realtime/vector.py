"""Real time for batches: each environment on a simulated wall clock of its own, as it would be alone with its seed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from functools import partial
from inspect import signature
from typing import Any, cast

import gymnasium
import numpy as np
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv, VectorEnv, VectorWrapper
from numpy.typing import NDArray

from uavaccel.errors import UserError
from uavaccel.realtime.control_loop import Command, LoopOptions
from uavaccel.realtime.plant import HasWallClocks
from uavaccel.realtime.thinking import (
    LATENCY_S,
    Drawn,
    Measured,
    ThinkingTime,
    sampled_ns,
    thinking_generator,
    thinking_time,
)
from uavaccel.realtime.wrapper import RealTime, check_clocks, passing
from uavaccel.units import NS_PER_S

Vector = VectorEnv[Any, Any, Any]
AHEAD = 256  # thinking times of an environment that are drawn at once


class RealTimeVector(VectorWrapper[Any, Any, Any, Any]):
    """Let each environment of a vector go on while its agent thinks, with `RealTime`'s arguments.

    Environment i of a vector that is reset with a seed has the thinking times, and does what, a single `RealTime` does
    with seed + i. It takes over Gymnasium's `SyncVectorEnv`s and `AsyncVectorEnv`s, whose processes it starts anew, in
    any autoreset mode, and this package's own batches in the exact simulator or over arrays, whose observations stay
    on their device. `gymnasium.make_vec(ID, 8, wrappers=[partial(RealTime, latency_s=0.05)])` makes the same.

    In a step each environment takes its own simulated time. Raises UserError for arguments that do not fit, and for a
    vector whose environments it cannot reach.
    """

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
        """Begin an episode in every environment; environment i gets `seed` + i, or the i-th of several seeds."""
        seeds = range(seed, seed + self.num_envs) if isinstance(seed, int) else seed
        for place, own in enumerate(seeds or ()):
            if own is not None:
                self._generators[place], self._taken[place] = thinking_generator(own), AHEAD
        self._going[:] = True
        return self.env.reset(seed=cast(Any, seed), options=options)

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
