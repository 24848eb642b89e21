"""Checks of what callers of an environment pass: keywords of its task, actions, reset options and seeds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TypeVar

import numpy as np
from gymnasium import spaces

from uavaccel.config import validate
from uavaccel.envs.task import Task
from uavaccel.envs.values import Action
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


def known_options(options: Mapping[str, object], known: Sequence[str]) -> Mapping[str, object]:
    """Return the options of a reset. Raises UserError for one that is not among the `known`."""
    unknown = [str(key) for key in options if key not in known]
    if unknown:
        raise UserError(f"reset: unknown option {unknown[0]!r}; known: {', '.join(known) or 'none'}")
    return options


def seeds_of(seed: int | Sequence[int | None] | None, count: int) -> list[int | None]:
    """Return a seed for each environment: counted up from one seed, or the given ones."""
    if seed is None:
        return [None] * count
    if isinstance(seed, (int, np.integer)):
        return [int(seed) + index for index in range(count)]
    if len(seed) != count:
        raise UserError(f"seed: {len(seed)} seeds for {count} environments")
    return [None if each is None else int(each) for each in seed]
