"""Checks of what callers of an environment or a batch pass, and of the functions of a task of one's own."""

from __future__ import annotations

import json
import math
import re
import sys
from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import astuple, replace
from numbers import Integral, Real
from typing import Any, NoReturn, TypeVar, get_args

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from uavaccel.config import validate
from uavaccel.envs.arrays import full, mapped, rank
from uavaccel.envs.task import AnyLayout, Mirror, Task, as_frame, told_of
from uavaccel.envs.values import AT_REST, CONDITIONS, Action, Actions, Course, Moment, Number
from uavaccel.errors import UserError
from uavaccel.kinematics import FlightGoal, Kinematics
from uavaccel.own_code import errors_named, files_of

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


def refuse_copy(environment: object) -> NoReturn:
    """Refuse to be copied or pickled, as `__getstate__`."""
    then = "set_state(what get_state returns)" if hasattr(environment, "set_state") else "reset(seed=the same)"
    raise UserError(
        f"{type(environment).__name__}: what flies cannot be copied or pickled: make another of its keys and {then}"
    )


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
        return int(action) if isinstance(space, spaces.Discrete) else action  # whatever kind of whole number it is
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


def lanes_of(options: Mapping[str, object] | None, count: int) -> tuple[list[int], Mapping[str, object] | None]:
    """Return which environments a reset is of, by Gymnasium's option reset_mask, and the other options.

    Raises UserError for a mask that is no array of `count` truth values, of which one is true.
    """
    if not isinstance(options, Mapping) or "reset_mask" not in options:
        return list(range(count)), options
    mask = np.asarray(options["reset_mask"])
    if mask.dtype != bool or mask.shape != (count,) or not mask.any():
        raise UserError(f"reset: option reset_mask: must be {count} truth values, not all of them False")
    return mask.nonzero()[0].tolist(), {key: value for key, value in options.items() if key != "reset_mask"}


class Functions:
    """The functions of a task; what goes wrong in one is a UserError that names file, class and function."""

    def __init__(self, task: Task) -> None:
        self._task, self._files = task, files_of(type(task))
        self._course: Course = {}
        self._text = "{}"

    def watch(self, course: Course) -> None:
        """Refuse calls that change a course. Raises TypeError or ValueError unless it is one of JSON's values."""
        self._course, self._text = course, json.dumps(course)

    def __call__(self, name: str, *arguments: object) -> Any:
        same = deepcopy(arguments)
        returned = self._returned(name, arguments)
        if json.dumps(self._course, default=str) != self._text:
            raise self.wrong(name, "changes the course that it is given; only advance does, by returning another")
        if name != "info" and _text(self._returned(name, same)) != _text(returned):  # in which nothing is flown by
            what = "called again with the same, returns something else; draw numbers from the generator of sample alone"
            raise self.wrong(name, what)
        return returned

    def _returned(self, name: str, arguments: tuple[object, ...]) -> Any:
        try:
            with errors_named(self._files):
                return getattr(self._task, name)(*arguments)
        except UserError as error:
            raise self.named(name, error) from error
        except Exception as error:  # of the call itself, as for a wrong number of arguments
            raise self.wrong(name, f"{type(error).__name__}: {error}") from error

    def mapping(self, name: str, *arguments: object) -> Mapping[str, Any]:
        if not isinstance(returned := self(name, *arguments), Mapping):
            raise self.wrong(name, f"returned {returned!r}: must be a mapping")
        return returned

    def named(self, name: str, error: UserError) -> UserError:
        named = str(error).startswith(tuple(map(str, self._files)))
        return error if named else self.wrong(name, str(error))

    def wrong(self, name: str, what: str) -> UserError:
        place = f"{self._files[0]}: " if self._files else ""
        return UserError(f"{place}{type(self._task).__name__}.{name.removeprefix('lane_')}: {what}")


def _text(returned: object) -> str:
    """Return the whole text of an object, without the places in memory of those that have no text of their own."""
    with np.printoptions(threshold=sys.maxsize):
        return re.sub(r" at 0x\w+", "", repr(returned))


def layout_of(task: Task, course: Course) -> AnyLayout | None:
    """Return the layout of a game. Raises UserError for a wrong one, which names the task's file."""
    try:
        return task.lane_layout(course)
    except UserError as error:
        raise Functions(task).named("lane_layout", error) from error


def check_functions(task: Task) -> None:
    """Call each function of a task at the start of a game. Raises UserError for one that fails or returns nonsense."""
    call, kind = Functions(task), type(task)
    if kind.reward is Task.reward:
        raise call.wrong("reward", "is missing: def reward(self, before, now), which returns a command's reward")
    actions = call("action_space")
    numbered = isinstance(actions, spaces.Discrete) and actions.start == 0
    row = isinstance(actions, spaces.Box) and len(actions.shape) == 1 and actions.shape[0] > 0
    if not (numbered or (row and np.issubdtype(actions.dtype, np.floating))):
        what = "a Discrete that begins with 0, or a Box of floats, at least one, of shape (n,)"
        raise call.wrong("action_space", f"must return {what}, not {actions!r}")
    course = call.mapping("sample", np.random.default_rng(0), {})
    if CONDITIONS in course:
        raise call.wrong("sample", f"{CONDITIONS!r} are those of sample_conditions: name yours otherwise")
    try:
        call.watch(course)
    except (TypeError, ValueError) as error:
        raise call.wrong("sample", f"must return plain numbers, and lists and mappings of them: {error}") from error
    _check_conditions(kind, call)
    call("lane_layout", course)
    state = replace(AT_REST, position_m=(0.0, 0.0, -task.altitude_m))
    _check_mirror(call, actions, _check_features(task, call, state, course))
    actions.seed(0)
    action = actions.sample()
    goal = call("goal", action.astype(np.float64) if isinstance(actions, spaces.Box) else action)
    if not isinstance(goal, get_args(FlightGoal)):
        raise call.wrong("goal", f"must return a goal of uavaccel.kinematics, such as VelocityGoal, not {goal!r}")
    numbers = [number for number in astuple(goal) if number is not None]
    try:
        finite = bool(np.isfinite(np.hstack(numbers).astype(float)).all())
    except (TypeError, ValueError):  # which are no numbers
        finite = False
    if not finite:
        raise call.wrong("goal", f"must be of finite numbers, not {goal}")
    begun = Moment(state, state.position_m, None, 0, course)
    now = begun._replace(commands=1)
    now = now._replace(course=call.mapping("advance", begun, now))
    for name in ("success", "failure"):
        if not isinstance(ended := call(name, now), bool | np.bool_):
            raise call.wrong(name, f"returned {ended!r}: must be True or False")
    check_reward(task, call("reward", begun, now))
    _check_info(task, call, now)


def _check_conditions(kind: type[Task], call: Functions) -> None:
    conditions = call.mapping("sample_conditions", np.random.default_rng(0), 0)
    for name, value in conditions.items():  # columns of a run's rows
        if isinstance(value, bool) or not isinstance(value, Real) or not math.isfinite(value):
            raise call.wrong("sample_conditions", f"{name!r} is {value!r}: must be a finite number")
    if kind.with_conditions is Task.with_conditions and kind.sample_conditions is not Task.sample_conditions:
        what = "is missing: def with_conditions(self, conditions), which returns the task under them"
        raise call.wrong("with_conditions", what)
    if conditions and not isinstance(under := call("with_conditions", conditions), Task):
        raise call.wrong("with_conditions", f"returned {under!r}: must be a task, as self.model_copy(update=...) is")


def _check_info(task: Task, call: Functions, now: Moment) -> None:
    info = call.mapping("info", now)
    if taken := {*told_of(task, now), CONDITIONS, "wall_s", "phase_s", "host_phase_s"} & {*info}:
        raise call.wrong("info", f"{min(taken)!r} is an item of all tasks: name yours otherwise")
    for name, kind in (("lane", Integral), ("distance_m", Real)):  # which are columns of a run's rows
        if name in info and not (isinstance(info[name], kind) and math.isfinite(info[name])):
            what = "a whole" if kind is Integral else "a finite"
            raise call.wrong("info", f"{name!r} is {info[name]!r}: must be {what} number, or name yours otherwise")


def _check_features(task: Task, call: Functions, state: Kinematics, course: Mapping[str, Any]) -> int | None:
    """Return how many fields a frame has in a row; None if they are not observed."""
    if task.observation != "state" and not task.also_state:
        return None
    name = features_name(task)
    with np.errstate(over="ignore"):
        numbers = as_frame(task, call(name, state, course), name)
    if not (numbers.ndim and numbers.size):
        raise call.wrong(name, "returned no numbers" if numbers.ndim else "returned no list, but one number")
    check_features(task, numbers, numbers.shape)
    space = call("observation_space")
    seen = np.concatenate([task.features(state, course)] * task.frames_per_command * task.history).shape
    if task.observation == "state" and space.shape != seen:
        raise call.wrong(name, f"observations are of shape {seen}, in observation_space of {space.shape}")
    return int(numbers.shape[-1])


def _check_mirror(call: Functions, actions: spaces.Space[Any], fields: int | None) -> None:
    if (mirror := call("mirrored")) is None or not isinstance(actions, spaces.Box):
        return
    try:
        mirror = Mirror(*mirror)
        mirror.check(call("observation_space"), actions.shape[0])
        if fields is not None and len(mirror.fields) != fields:
            raise ValueError(f"fields = {list(mirror.fields)}: must be all {fields} places")
    except (TypeError, ValueError) as error:
        raise call.wrong("mirrored", f"must return a Mirror of envs.task or None: {error}") from error


def as_sampled(task: Task, course: Mapping[str, Any], before: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return a course as arrays. Raises UserError unless it has the numbers that were sampled, and their kinds."""
    items = f"its course must have the items that sample gives it: {', '.join(map(str, before))}"
    if set(course) != set(before):
        raise Functions(task).wrong("advance", items)

    def kept(old: Number, new: Number) -> Number:
        if rank(new := full(new, old)) > rank(old):
            what = f"a number of its course is {new.dtype}, and was sampled as {old.dtype}"
            raise Functions(task).wrong("advance", what)
        return new

    try:
        return dict(mapped(kept, dict(before), course))
    except (IndexError, KeyError, TypeError, ValueError) as error:  # of items that are nested otherwise
        raise Functions(task).wrong("advance", items) from error


def features_name(task: Task) -> str:
    """Return the name of the function that says what is observed of the state."""
    return "fields" if type(task).features is Task.features else "features"


def check_features(task: Task, numbers: NDArray[Any], shape: tuple[int, ...]) -> None:
    """Raise UserError for a frame of the state that is of another shape, or has numbers that are not finite."""
    if numbers.shape != shape:
        raise Functions(task).wrong(features_name(task), f"returned the shape {numbers.shape}, and {shape} before")
    if not np.isfinite(numbers).all():
        what = f"returned a number that is not finite: {numbers.tolist()}"
        raise Functions(task).wrong(features_name(task), what)


def check_reward(task: Task, reward: object) -> None:
    """Raise UserError for a reward that is no finite number."""
    if not (isinstance(reward, Real) and math.isfinite(reward)):
        raise Functions(task).wrong("reward", f"returned {reward!r}: must be a finite number")
