"""A stand-in for OpenAI's gym 0.21, of AirSim's time, on Gymnasium: for scripts where no gym is installed.

Environments keep the old interface: `reset()` returns an observation, `step()` four values. Present libraries, such as
stable-baselines3, see Gymnasium's interface: an environment from `make` decides by its caller, the script or a library.
"""

from __future__ import annotations

import functools
import importlib
import sys
from collections.abc import Callable, Mapping, Sequence
from types import ModuleType
from typing import Any, TypeAlias

import gymnasium
from gymnasium import error, logger, spaces
from gymnasium.utils import seeding

from uavaccel.fly.modules import named_module, of_a_script

Action: TypeAlias = Any
"""An action as the script's environment expects it."""

OldStep = tuple[object, float, bool, Mapping[str, object]]
"""Observation, reward, done and info."""


class Env:
    """gym.Env, from which a script's own environments derive."""

    metadata: Mapping[str, Sequence[str]] = {"render.modes": []}
    reward_range = (-float("inf"), float("inf"))
    spec: object = None
    action_space: spaces.Space[object]
    observation_space: spaces.Space[object]

    def step(self, action: Action) -> OldStep:
        raise NotImplementedError

    def reset(self) -> object:
        raise NotImplementedError

    def render(self, mode: str = "human", **options: object) -> object:
        raise NotImplementedError

    def close(self) -> None:
        pass

    def seed(self, seed: int | None = None) -> object:
        return [seed]

    @property
    def unwrapped(self) -> Env:
        return self

    def __enter__(self) -> Env:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()


class _Around:
    """What holds an environment, and has whatever that has."""

    action_space: Any
    observation_space: Any
    metadata: Any

    def __init__(self, env: Any) -> None:
        self.env: Any = env.env if isinstance(env, Adapted) else env
        self.action_space, self.observation_space = self.env.action_space, self.env.observation_space
        self.metadata = self.env.metadata

    def render(self, *mode: str, **options: object) -> Any:
        return self.env.render(*mode, **options)

    def close(self) -> None:
        self.env.close()

    def seed(self, seed: int | None = None) -> object:
        return self.env.seed(seed)

    def __getattr__(self, name: str) -> Any:
        if name == "env":
            raise AttributeError(name)
        return getattr(self.env, name)


class Adapted(_Around, gymnasium.Env[object, object]):
    """An old environment with Gymnasium's interface for libraries, and the old one for the script's own files."""

    def __init__(self, env: Env) -> None:
        super().__init__(env)
        self.metadata = {**env.metadata, "render_modes": [*env.metadata.get("render.modes", ())]}

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        if of_a_script(sys._getframe(1).f_globals):
            return self.env.reset()
        if seed is not None and hasattr(self.env, "seed"):
            self.env.seed(seed)
        return self.env.reset(), {}

    def step(self, action: Action) -> Any:
        observation, reward, done, info = self.env.step(action)
        if of_a_script(sys._getframe(1).f_globals):
            return observation, reward, done, info
        truncated = bool(info.get("TimeLimit.truncated", False))
        return observation, float(reward), bool(done) and not truncated, truncated, dict(info)


class Wrapper(_Around, Env):
    """gym.Wrapper, in the old interface."""

    def step(self, action: Action) -> OldStep:
        step: Callable[[Action], OldStep] = self.env.step
        return step(action)

    def reset(self, **options: object) -> object:
        return self.env.reset(**options)

    @property
    def unwrapped(self) -> Env:
        inner: Env = self.env.unwrapped
        return inner


class ObservationWrapper(Wrapper):
    def observation(self, observation: object) -> object:
        raise NotImplementedError

    def reset(self, **options: object) -> object:
        return self.observation(super().reset(**options))

    def step(self, action: Action) -> OldStep:
        observation, reward, done, info = self.env.step(action)
        return self.observation(observation), reward, done, info


class ActionWrapper(Wrapper):
    def action(self, action: Action) -> object:
        raise NotImplementedError

    def step(self, action: Action) -> OldStep:
        return super().step(self.action(action))


class RewardWrapper(Wrapper):
    def reward(self, reward: float) -> float:
        raise NotImplementedError

    def step(self, action: Action) -> OldStep:
        observation, reward, done, info = self.env.step(action)
        return observation, self.reward(reward), done, info


_registered: dict[str, tuple[str | Callable[..., Env], Mapping[str, object]]] = {}


def register(
    id: str, entry_point: str | Callable[..., Env] = "", kwargs: Mapping[str, object] | None = None, **options: object
) -> None:
    """Register how an environment is made; `kwargs` are its arguments."""
    _registered[id] = entry_point, kwargs or {}


def make(id: str, **arguments: object) -> Adapted:
    """Make a registered environment; for "module:id" the module, which registers it, is imported first.

    Raises ValueError for an unknown id.
    """
    module, _, name = id.rpartition(":")
    if module:
        importlib.import_module(module)
    if name not in _registered:
        raise ValueError(f"no environment {id!r} is registered; there are {', '.join(_registered) or 'none'}")
    entry_point, defaults = _registered[name]
    if isinstance(entry_point, str):
        home, _, attribute = entry_point.partition(":")
        entry_point = getattr(importlib.import_module(home), attribute)
    return Adapted(entry_point(**{**defaults, **arguments}))


@functools.cache
def modules() -> dict[str, ModuleType]:
    """Return the modules of gym, and shimmy, through which stable-baselines3 accepts old environments."""
    wrappers = {kind.__name__: kind for kind in (Wrapper, ObservationWrapper, ActionWrapper, RewardWrapper)}
    registration = named_module("gym.envs.registration", register=register, make=make)
    envs = named_module("gym.envs", registration=registration)
    core = named_module("gym.core", Env=Env, **wrappers)
    utils = named_module("gym.utils", seeding=seeding)
    parts = {"spaces": spaces, "envs": envs, "core": core, "utils": utils, "error": error, "logger": logger}
    gym = named_module("gym", Env=Env, make=make, register=register, __version__="0.21.0", **wrappers, **parts)
    shimmy = named_module("shimmy", GymV21CompatibilityV0=lambda env: Adapted(env))
    found = {f"gym.{name}": module for name, module in parts.items()}
    found |= {"gym": gym, "gym.envs.registration": registration, "gym.utils.seeding": seeding}
    return found | {"shimmy": shimmy}
