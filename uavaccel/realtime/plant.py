"""Environments whose simulated time passes in ticks: physics steps in MuJoCo's environments, else control periods."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol, SupportsFloat

import gymnasium
from gymnasium.wrappers import TimeLimit

from uavaccel.errors import UserError
from uavaccel.units import NS_PER_S, exact

Observation = Any
Action = Any
Period = tuple[Observation, SupportsFloat, bool, bool, dict[str, Any]]
"""The result of a control period, as Gymnasium's `step` returns it."""


class Passed(NamedTuple):
    """The result of some ticks: Gymnasium's five values, with the sum of the rewards, and how many ticks passed."""

    observation: Observation
    reward: float
    terminated: bool
    truncated: bool
    info: dict[str, Any]
    ticks: int


class Plant(Protocol):
    """An environment that can be advanced by any number of ticks."""

    tick_ns: int
    """Simulated time of one tick."""
    period_ticks: int
    """Ticks of a control period, for which an action is meant."""

    def reset(self) -> None:
        """Begin an episode; called after the environment's own reset."""
        ...

    def step(self, action: Action) -> Period:
        """Apply an action for a control period."""
        ...

    def advance(self, action: Action, ticks: int) -> Passed:
        """Apply an action for at least one tick, and stop where the episode ends."""
        ...


class PeriodicPlant:
    """An environment of any kind: a tick is a control period, one call of `step`."""

    def __init__(self, env: gymnasium.Env[Any, Any], period_s: float) -> None:
        self._env, self.tick_ns, self.period_ticks = env, _period_ns(period_s), 1

    def reset(self) -> None:
        pass

    def step(self, action: Action) -> Period:
        return self._env.step(action)

    def advance(self, action: Action, ticks: int) -> Passed:
        total, passed = 0.0, 0
        while True:
            count = min(ticks - passed, self.period_ticks)
            observation, reward, terminated, truncated, info = self._part(action, count)
            total, passed = total + float(reward) * count / self.period_ticks, passed + count
            if passed == ticks or terminated or truncated:
                return Passed(observation, total, terminated, truncated, info, passed)

    def _part(self, action: Action, ticks: int) -> Period:
        """Apply an action for a part of a control period, or a whole one."""
        return self.step(action)


class MujocoPlant(PeriodicPlant):
    """One of Gymnasium's MuJoCo environments: a tick is one physics step, of which `frame_skip` are a control period.

    Part of a period is one `step` with a smaller `frame_skip`, so that velocities, and what they earn, are those over
    the time that passed; its reward counts for the share of a period that it is. A time limit counts whole periods of
    simulated time.
    """

    def __init__(self, env: gymnasium.Env[Any, Any]) -> None:
        self._env, self._inside = env, env.unwrapped
        self.period_ticks = int(self._inside.frame_skip)  # type: ignore[attr-defined]
        timestep_s = float(self._inside.model.opt.timestep)  # type: ignore[attr-defined]
        self.tick_ns = _period_ns(timestep_s)
        self._limit, self._ticks = _time_limit(env), 0

    def reset(self) -> None:
        self._ticks = 0

    def step(self, action: Action) -> Period:
        self._ticks += self.period_ticks
        return self._env.step(action)

    def _part(self, action: Action, ticks: int) -> Period:
        self._ticks += ticks
        if self._limit is not None:
            self._limit._elapsed_steps = self._ticks // self.period_ticks - 1  # its step adds one
        self._inside.frame_skip = ticks  # type: ignore[attr-defined]
        try:
            return self._env.step(action)
        finally:
            self._inside.frame_skip = self.period_ticks  # type: ignore[attr-defined]


def is_of_mujoco(env: gymnasium.Env[Any, Any]) -> bool:
    """Return whether it is one of Gymnasium's MuJoCo environments, or is built as they are."""
    return all(hasattr(env.unwrapped, name) for name in ("frame_skip", "model", "do_simulation"))


def plant_of(env: gymnasium.Env[Any, Any], period_s: float | None) -> Plant:
    """Return the plant of an environment: by physics steps or, with `period_s` or without MuJoCo, by control periods.

    Raises UserError where the duration of a step is not known.
    """
    inside: Any = env.unwrapped
    if period_s is not None:
        return PeriodicPlant(env, period_s)
    if is_of_mujoco(env):
        return MujocoPlant(env)
    of_dm_control = getattr(getattr(inside, "_env", None), "control_timestep", None)  # inside shimmy's
    if callable(of_dm_control):
        return PeriodicPlant(env, float(of_dm_control()))
    for name in ("dt", "tau"):
        value = getattr(inside, name, None)
        if isinstance(value, int | float) and value > 0:
            return PeriodicPlant(env, float(value))
    raise UserError(
        f"period_s: {type(inside).__name__} does not say how long a step is; "
        "give the simulated seconds of one, as in period_s=0.02"
    )


def _time_limit(env: gymnasium.Env[Any, Any]) -> Any:
    while isinstance(env, gymnasium.Wrapper):
        if isinstance(env, TimeLimit):
            return env
        env = env.env
    return None


def _period_ns(period_s: float) -> int:
    """Return a period in nanoseconds. Raises UserError for anything else than 1 ns to 1e6 s."""
    if not isinstance(period_s, int | float) or not 1e-9 <= period_s <= 1e6:
        raise UserError(f"period_s: must be a number of seconds above 0, not {period_s!r}")
    return max(round(exact(period_s) * NS_PER_S), 1)
