"""Environments whose simulated time passes in ticks: physics steps in MuJoCo's environments, else control periods."""

from __future__ import annotations

from collections.abc import Iterator
from copy import deepcopy
from typing import Any, NamedTuple, Protocol, SupportsFloat, cast, runtime_checkable

import gymnasium
import numpy as np
from gymnasium.wrappers import TimeLimit
from numpy.typing import NDArray

from uavaccel.errors import UserError
from uavaccel.units import NS_PER_S, exact, real, whole

MOST_TICKS = 1_000_000_000  # of a control period
Observation = Any
Action = Any
Period = tuple[Observation, SupportsFloat, bool, bool, dict[str, Any]]
"""The result of a control period, as Gymnasium's `step` returns it."""


def counted(name: str, given: object, least: int, most: int, of: str = "") -> int:
    """Return a whole number. Raises UserError, which begins with `name`, for any other and for one out of range."""
    if (count := whole(given)) is None or not least <= count <= most:
        raise UserError(f"{name}: must be {least} to {most:,}{of}, not {given!r}")
    return count


def copied(action: Action) -> Action:
    """Return a copy of an action of any space."""
    return action.copy() if type(action) is np.ndarray else deepcopy(action)


def reward_of(env: gymnasium.Env[Any, Any], reward: Any) -> float:
    """Return a step's reward, which an array may hold. Raises UserError for what is no number."""
    try:
        return float(reward.item() if isinstance(reward, np.ndarray) else reward)
    except (TypeError, ValueError):
        raise UserError(f"{type(env.unwrapped).__name__}: its reward must be a number, not {reward!r}") from None


class Passed(NamedTuple):
    """The result of some ticks: Gymnasium's five values, with the sum of the rewards, and how many ticks passed."""

    observation: Observation
    reward: float
    terminated: bool
    truncated: bool
    info: dict[str, Any]
    ticks: int

    @property
    def over(self) -> bool:
        """Whether the episode has ended."""
        return self.terminated or self.truncated


@runtime_checkable
class HasWallClock(Protocol):
    """An environment that models the wall clock itself, as uavaccel's own do."""

    task: Any

    def charge(self, duration_s: float, phase: str = ...) -> None: ...


@runtime_checkable
class HasWallClocks(Protocol):
    """A batch of such environments."""

    task: Any

    def charge_each(self, durations_ns: NDArray[np.int64]) -> None:
        """Charge each environment for its agent's work since the last step."""
        ...


class Plant:
    """An environment that can be advanced by any number of ticks: here of any kind, a tick is one call of `step`.

    The period is `period_s`, the user's, or what the environment inside says of its own steps: then a wrapper that
    makes several steps of one is refused, in the first step, with a UserError.
    """

    tick_ns: int
    """Simulated time of one tick."""
    period_ticks = 1
    """Ticks of a control period, for which an action is meant."""

    def __init__(self, env: gymnasium.Env[Any, Any], period_s: object, of: str = "") -> None:
        """`of` is the attribute of the environment inside that `period_s` is from, if any."""
        self._env, self._inside = env, cast(Any, env.unwrapped)
        name, seconds = f"{type(self._inside).__name__}.{of}" if of else "period_s", real(period_s)
        if seconds is None or not 1e-9 <= seconds <= 1e6:
            raise UserError(f"{name}: must be a number of seconds, 1e-9 to 1e6, not {period_s!r}")
        self.tick_ns = max(round(exact(seconds) * NS_PER_S), 1)
        self._counts = bool(of) and env is not self._inside

    def reset(self) -> None:
        """Begin an episode; called after the environment's own reset."""

    def step(self, action: Action) -> Period:
        """Apply an action for a control period."""
        if not self._counts:
            return self._env.step(action)
        inside, calls = self._inside, 0
        own, step = vars(inside).get("step"), inside.step

        def counted(action: Action) -> Any:
            nonlocal calls
            calls += 1
            return step(action)

        inside.step = counted
        try:
            result: Period = self._env.step(action)
        finally:
            del inside.step
            if own is not None:
                inside.step = own
        if calls > 1:
            raise _of_another_length(self._env, f"{calls} steps of {type(inside).__name__}", "1")
        return result

    def advance(self, action: Action, ticks: int) -> Passed:
        """Apply an action, which stays as it is, for at least one tick, and stop where the episode ends."""
        total, passed = 0.0, 0
        while True:
            count = min(ticks - passed, self.period_ticks)
            observation, reward, terminated, truncated, info = self._part(copied(action), count)
            total, passed = total + reward_of(self._env, reward) * count / self.period_ticks, passed + count
            if passed == ticks or terminated or truncated:
                return Passed(observation, total, terminated, truncated, info, passed)

    def _part(self, action: Action, ticks: int) -> Period:
        """Apply an action for a part of a control period, or a whole one."""
        return self.step(action)


class MujocoPlant(Plant):
    """One of Gymnasium's MuJoCo environments: a tick is one physics step, of which `frame_skip` are a control period.

    Part of a period is one `step` with a smaller `frame_skip`, so that velocities, and what they earn, are those over
    the time that passed; its reward counts for the share of a period that it is. Time limits count whole periods of
    simulated time. Where MuJoCo's own clock says that not as many physics steps were made as `frame_skip` says, in an
    episode's first step or a part of a period, a UserError is raised.
    """

    def __init__(self, env: gymnasium.Env[Any, Any]) -> None:
        inside: Any = env.unwrapped
        self._timestep_s = inside.model.opt.timestep
        super().__init__(env, self._timestep_s, "model.opt.timestep")
        name = f"{type(inside).__name__}.frame_skip"
        self.period_ticks, self._ticks = counted(name, inside.frame_skip, 1, MOST_TICKS, " physics steps"), 0
        self._has_clock = hasattr(getattr(inside, "data", None), "time")
        self._limits: list[Any] = [layer for layer in layers(env) if isinstance(layer, TimeLimit)]

    def reset(self) -> None:
        self._ticks = 0

    def step(self, action: Action) -> Period:
        first, self._ticks = self._ticks == 0, self._ticks + self.period_ticks
        return self._stepped(action, self.period_ticks) if first else self._env.step(action)

    def _part(self, action: Action, ticks: int) -> Period:
        self._ticks += ticks
        for limit in self._limits:
            limit._elapsed_steps = self._ticks // self.period_ticks - 1  # its step adds one
        self._inside.frame_skip = ticks
        try:
            return self._stepped(action, ticks)
        finally:
            self._inside.frame_skip = self.period_ticks

    def _stepped(self, action: Action, ticks: int) -> Period:
        if not self._has_clock:
            return self._env.step(action)
        before_s = self._inside.data.time
        result = self._env.step(action)
        made = (self._inside.data.time - before_s) / self._timestep_s
        if abs(made - ticks) > 0.5 and made > -0.5:  # MuJoCo sets it back where a simulation becomes unstable
            raise _of_another_length(self._env, f"{made:.0f} physics steps", str(ticks))
        return result


def is_of_mujoco(env: gymnasium.Env[Any, Any]) -> bool:
    """Return whether it is one of Gymnasium's MuJoCo environments, or is built as they are."""
    return all(hasattr(env.unwrapped, name) for name in ("frame_skip", "model", "do_simulation"))


def plant_of(env: gymnasium.Env[Any, Any], period_s: float | None) -> Plant:
    """Return the plant of an environment: by physics steps or, with `period_s` or without MuJoCo, by control periods.

    Raises UserError where the duration of a step is not known, or where the environment keeps real time itself.
    """
    refuse_real_time_in(env)
    inside: Any = env.unwrapped
    if isinstance(inside, HasWallClock):
        raise UserError(f"{type(inside).__name__} keeps its own wall clock: use it as it is, made with timing='wall'")
    if period_s is not None:
        return Plant(env, period_s)
    if is_of_mujoco(env):
        return MujocoPlant(env)
    of_dm_control = getattr(getattr(inside, "_env", None), "control_timestep", None)  # inside shimmy's
    if callable(of_dm_control):
        return Plant(env, of_dm_control(), "control_timestep")
    for name in ("dt", "tau"):
        if (seconds := real(getattr(inside, name, None))) is not None and seconds > 0:
            return Plant(env, seconds, name)
    raise UserError(
        f"period_s: {type(inside).__name__} does not say how long a step is; "
        "give the simulated seconds of one, as in period_s=0.02"
    )


def refuse_real_time_in(env: Any) -> None:
    """Raise UserError for an environment that is in real time already: a second thinking time would hide the first."""
    for name in (type(layer).__name__ for layer in layers(env) if getattr(layer, "keeps_real_time", False)):
        raise UserError(f"{name} is in real time already; give one wrapper the whole latency_s")


def layers(env: Any) -> Iterator[Any]:
    """Yield an environment's wrappers, the outer one first, and what they wrap."""
    yield env
    while isinstance(env, gymnasium.Wrapper | gymnasium.vector.VectorWrapper):
        env = env.env
        yield env


def _of_another_length(env: gymnasium.Env[Any, Any], made: str, asked: str) -> UserError:
    return UserError(
        f"period_s: a step of {env} has made {made} where {asked} had been asked for; "
        "give the simulated seconds of one, as in period_s=0.02"
    )
