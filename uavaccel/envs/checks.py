"""Checks of what callers of an environment, or of a batch, pass: keywords, actions, reset options and seeds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TypeVar

import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode

from uavaccel.config import validate
from uavaccel.envs.task import Task
from uavaccel.envs.values import Action, Actions
from uavaccel.errors import UserError

TaskT = TypeVar("TaskT", bound=Task)
RENDER_MODES = ["rgb_array"]
ROUNDING = 1e-6  # by which an action may exceed its bounds


class UnexpectedKeyword(UserError, TypeError):
    """An unknown keyword; it is also a TypeError, which Gymnasium's callers expect."""


def make_task(task_class: type[TaskT], keys: Mapping[str, object], name: str) -> TaskT:
    """Make a task of these keys. Raises UserError, beginning with `name`, for keys or values that do not fit."""
    try:
        return validate(task_class, keys, name)
    except UserError as error:
        unknown = [key for key in keys if key not in task_class.model_fields]
        if unknown:
            raise UnexpectedKeyword(f"{error} (got an unexpected keyword argument {unknown[0]!r})") from error
        raise


def check_render_mode(render_mode: object) -> str | None:
    """Return a render mode, or None. Raises UserError for any other."""
    if render_mode is None or render_mode in RENDER_MODES:
        return None if render_mode is None else str(render_mode)
    raise UserError(f"render_mode = {render_mode!r} is unknown; there are None, {', '.join(RENDER_MODES)}")


def within(space: spaces.Space[Action], action: Action) -> Action:
    """Return the action in the space's type, clipped to its bounds. Raises UserError if it is not in the space."""
    if isinstance(space, spaces.Box):
        given = np.asarray(action)
        if given.shape == space.shape and np.issubdtype(given.dtype, np.number):
            clipped = np.clip(given, space.low, space.high).astype(space.dtype)
            if (abs(clipped - given) <= ROUNDING).all():  # not so for NaN
                return clipped
    elif space.contains(action):
        return action
    raise UserError(f"action {action!r} is not in the action space: {space}")


def actions_of(space: spaces.Space[Action], actions: Actions, count: int) -> list[Action]:
    """Return an action for each of `count` environments, as `within` does. Raises UserError for another number."""
    try:
        given = np.asarray(actions)
    except ValueError:  # rows of different lengths
        given = np.empty(0)
    if given.shape != (shape := (count, *(space.shape or ()))):
        raise UserError(f"actions: must be of shape {shape}, an action for each environment, not {given.shape}")
    return [within(space, action) for action in given]


def whole_number(name: str, value: object, most: int) -> int:
    """Return a count. Raises UserError, naming it, unless it is a whole number from 1 to `most`."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or not 1 <= value <= most:
        raise UserError(f"{name} = {value!r}: must be a whole number, at least 1 and at most {most}")
    return int(value)


def autoreset_of(mode: AutoresetMode | str) -> AutoresetMode:
    """Return the mode of that name. Raises UserError for an unknown one."""
    try:
        return AutoresetMode(mode)
    except ValueError:
        known = ", ".join(each.value for each in AutoresetMode)
        raise UserError(f"autoreset_mode = {mode!r} is unknown; there are {known}") from None


def known_options(options: Mapping[str, object] | None, known: Sequence[str]) -> Mapping[str, object]:
    """Return the options of a reset. Raises UserError for no mapping, and for one that is not among the `known`."""
    if options is None:
        return {}
    if not isinstance(options, Mapping):
        raise UserError(f"reset: options = {options!r}: must be a mapping, of {', '.join(known) or 'no keys'}")
    unknown = [str(key) for key in options if key not in known]
    if unknown:
        raise UserError(f"reset: unknown option {unknown[0]!r}; known: {', '.join(known) or 'none'}")
    return options


def seed_of(seed: object) -> int | None:
    """Return a seed, or None without one. Raises UserError unless it is a whole number, at least 0."""
    if seed is None:
        return None
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise UserError(f"reset: seed = {seed!r}: must be a whole number, at least 0")
    return int(seed)


def seeds_of(seed: int | Sequence[int | None] | None, count: int) -> list[int | None]:
    """Return a seed for each environment: counted up from one seed, or the given ones. Raises UserError."""
    if isinstance(seed, str) or not isinstance(seed, Sequence | np.ndarray):
        first = seed_of(seed)
        return [None if first is None else first + index for index in range(count)]
    if len(seed) != count:
        raise UserError(f"reset: seed: {len(seed)} seeds for {count} environments")
    return [seed_of(each) for each in seed]
