"""Whether a task of one's own can be flown: each of its functions is called once, before anything flies."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import replace
from numbers import Real
from typing import Any, get_args

import numpy as np
from gymnasium import spaces

from uavaccel.envs.arrays import cast, full, joined, stacked
from uavaccel.envs.flyable import CPU, check_flyable
from uavaccel.envs.task import AT_REST, Collisions, Moment, Moments, Task
from uavaccel.errors import UserError
from uavaccel.kinematics import FlightGoal, Kinematics
from uavaccel.own_code import errors_named, file_of


class Functions:
    """The functions of a task; what goes wrong in one is a UserError that names file, class and function."""

    def __init__(self, task: Task) -> None:
        self._task, self._file = task, file_of(type(task))

    def __call__(self, name: str, *arguments: object) -> Any:
        try:
            with errors_named(self._file):
                return getattr(self._task, name)(*arguments)
        except UserError as error:
            raise error if str(error).startswith(str(self._file)) else self.wrong(name, str(error)) from error
        except Exception as error:  # of the call itself, as for a wrong number of arguments
            raise self.wrong(name, f"{type(error).__name__}: {error}") from error

    def wrong(self, name: str, what: str) -> UserError:
        return UserError(f"{self._file}: {type(self._task).__name__}.{name.removeprefix('lane_')}: {what}")


def check_functions(task: Task) -> None:
    """Call each function of a task at the start of a game. Raises UserError for one that fails or returns nonsense."""
    call, kind = Functions(task), type(task)
    if kind.reward is Task.reward:
        raise call.wrong("reward", "is missing: def reward(self, before, now), which returns a command's reward")
    actions = call("action_space")
    if not (isinstance(actions, spaces.Discrete) or (isinstance(actions, spaces.Box) and len(actions.shape) == 1)):
        raise call.wrong("action_space", f"must return a Discrete, or a Box of shape (n,), not {actions!r}")
    course = call("sample", np.random.default_rng(0), {})
    try:
        json.dumps(course)
    except (TypeError, ValueError) as error:
        raise call.wrong("sample", f"must return plain numbers, and lists and mappings of them: {error}") from error
    _mapping(call, "sample", course)
    call("lane_layout", course)
    state = replace(AT_REST, position_m=(0.0, 0.0, -task.altitude_m))
    _check_features(task, call, state, course)
    actions.seed(0)
    action = actions.sample()
    goal = call("goal", action.astype(np.float64) if isinstance(actions, spaces.Box) else action)
    if not isinstance(goal, get_args(FlightGoal)):
        raise call.wrong("goal", f"must return a goal of uavaccel.kinematics, such as VelocityGoal, not {goal!r}")
    begun = Moment(state, state.position_m, None, 0, course)
    now = begun._replace(commands=1)
    now = now._replace(course=_mapping(call, "advance", call("advance", begun, now)))
    for name in ("success", "failure"):
        if not isinstance(ended := call(name, now), bool | np.bool_):
            raise call.wrong(name, f"returned {ended!r}: must be True or False")
    check_reward(task, call("reward", begun, now))
    _mapping(call, "info", call("info", now))


def _mapping(call: Functions, name: str, returned: object) -> Mapping[str, Any]:
    if not isinstance(returned, Mapping):
        raise call.wrong(name, f"returned {returned!r}: must be a mapping")
    return returned


def _check_features(task: Task, call: Functions, state: Kinematics, course: Mapping[str, Any]) -> None:
    if task.observation != "state" and not task.also_state:
        return
    name = "fields" if type(task).features is Task.features else "features"
    try:
        numbers = np.asarray(call(name, state, course), np.float32)
    except (TypeError, ValueError) as error:
        raise call.wrong(
            name, f"must return numbers, in lists of equal length: {str(error).partition('. ')[0]}"
        ) from error
    if not np.isfinite(numbers).all():
        raise call.wrong(name, f"returned a number that is not finite: {numbers.tolist()}")
    space = call("observation_space")
    seen = np.concatenate([task.features(state, course)] * task.frames_per_command * task.history).shape
    if task.observation == "state" and space.shape != seen:
        raise call.wrong(name, f"observations are of shape {seen}, in observation_space of {space.shape}")


def check_reward(task: Task, reward: object) -> None:
    """Raise UserError for a reward, or an array of rewards, that is no finite number."""
    array = isinstance(reward, np.ndarray)
    if np.isfinite(reward).all() if array else isinstance(reward, Real) and math.isfinite(reward):
        return
    shown = reward[~np.isfinite(reward)][0] if isinstance(reward, np.ndarray) else reward
    raise Functions(task).wrong("reward", f"returned {shown!r}: must be a finite number")


def flies_over_arrays(task: Task) -> bool:
    """Return whether the kernels can fly a task: its functions, too, compute with arrays as with numbers."""
    course, like = stacked([task.sample(np.random.default_rng(game), {}) for game in range(2)]), np.zeros(2)
    state = Kinematics(like.astype(np.int64), *([like] * size for size in (3, 4, 3, 3, 3, 3)))  # type: ignore[arg-type]
    none = Collisions(like.astype(np.int64) - 1, ())
    begun = Moments(state, list(state.position_m), none, like.astype(np.int64), course)
    space = task.action_space()
    actions = np.zeros((2, *(space.shape or ())), space.dtype)
    try:
        check_flyable(task, 1, CPU)
        goal = task.goal(cast(actions, "float64").T if isinstance(space, spaces.Box) else actions)
        now = begun._replace(course=task.advance(begun, begun))
        seen = task.fields(state, course) if type(task).features is Task.features else ()
        numbers = [task.reward(begun, now), task.success(now), task.failure(now), *seen]
        flat = joined([full(number, like) for number in numbers], like)
        return isinstance(goal, get_args(FlightGoal)) and flat.shape[0] == 2 and set(now.course) == set(course)
    except Exception:  # whatever own code does with an array that it did not expect
        return False
