"""Whether a task's functions say of many games at once what they say of each: mistakes that no error tells of.

For example, `now.collision is None` is never true of arrays, and two truth values add up to 1 there, not to 2.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import astuple
from numbers import Real
from typing import Any, get_args

import numpy as np
from gymnasium import spaces

from uavaccel.envs.arrays import each_of, stacked
from uavaccel.envs.checks import Functions
from uavaccel.envs.task import Task
from uavaccel.envs.values import Collisions, Course, Moment, Moments
from uavaccel.kinematics import FlightGoal, Kinematics

GAMES = 16
OBJECTS = ("obstacle_00", "ground")
SIZES = (3, 4, 3, 3, 3, 3)  # of a state's parts after its time


def check_agreement(task: Task) -> None:
    """Raise UserError for a function that says something else of games made up at random once they are in arrays.

    What fails in either way is not compared: its error is told where it flies.
    """
    random = np.random.default_rng(0)
    try:
        courses = [task.sample(random, {}) for _ in range(GAMES)]
        in_arrays: Course = stacked(courses)
    except Exception:
        return
    (before, all_before), (now, all_now) = (_moments(random, courses, in_arrays) for _ in range(2))
    space = task.action_space()
    if isinstance(space, spaces.Discrete):
        actions = space.start + np.arange(GAMES) % space.n
        _compare(task, "goal", [(int(action),) for action in actions], (actions,))
    seen = [(each.state, each.course) for each in now]
    _compare(task, "fields", seen, (all_now.state, all_now.course))
    if (later := _compare(task, "advance", list(zip(before, now, strict=True)), (all_before, all_now))) is None:
        return
    now = [each._replace(course=course) for each, course in zip(now, later, strict=True)]
    all_now = all_now._replace(course=stacked(later))
    for name in ("success", "failure", "info"):
        _compare(task, name, [(each,) for each in now], (all_now,))
    _compare(task, "reward", list(zip(before, now, strict=True)), (all_before, all_now))


def _moments(random: np.random.Generator, courses: Sequence[Course], course: Course) -> tuple[list[Moment], Moments]:
    """Return random moments of games, one by one and in arrays."""
    parts = [random.normal(0.0, 2.0, (size, GAMES)) for size in SIZES]
    parts[1] /= np.sqrt((parts[1] * parts[1]).sum(0))
    time_ns = random.integers(1, 2000, GAMES) * 2_000_000
    hit, commands = random.integers(-1, len(OBJECTS), GAMES), random.integers(1, 20, GAMES)
    state = Kinematics(time_ns, *(list(part) for part in parts))  # type: ignore[arg-type]
    single = [
        Kinematics(int(time_ns[game]), *(tuple(part[:, game].tolist()) for part in parts)) for game in range(GAMES)
    ]
    names = [None if index < 0 else OBJECTS[index] for index in hit]
    each = zip(single, names, commands.tolist(), courses, strict=True)
    alone = [Moment(of, of.position_m, name, count, course) for of, name, count, course in each]
    return alone, Moments(state, list(parts[0]), Collisions(hit, OBJECTS), commands, course)


def _compare(task: Task, name: str, alone: Sequence[tuple[Any, ...]], together: Any) -> list[Any] | None:
    """Return what a function says of each game; None where it fails. Raises UserError where arrays say otherwise."""
    function = getattr(task, name)
    try:
        with np.errstate(all="ignore"):
            said, all_said = [_listed(function(*each)) for each in alone], _listed(function(*together))
            of_all = _each_of(list(all_said) if name == "fields" else all_said, len(alone))
            differing = [pair for pair in zip(said, of_all, strict=True) if not _same(*pair)]
    except Exception:
        return None
    if differing:
        one, other = differing[0]
        what = " ".join(f"says {one!r} of a game, and {other!r} of the same in arrays".split())
        hint = "write now.free for `is None`, and 1 * a + b for the sum of two truth values"
        raise Functions(task).wrong(name, f"{what}: {hint}; or use simulator = mujoco")
    return said


def _listed(said: Any) -> Any:
    return list(astuple(said)) if isinstance(said, get_args(FlightGoal)) else said


def _each_of(said: Any, count: int) -> list[Any]:
    try:
        return each_of(said, count)
    except IndexError:  # of arrays (k, n), where lists of k arrays (n,) are meant
        return [said] * count


def _same(one: Any, other: Any) -> bool:
    """Return whether one says the same as another, but for rounding, and numbers that are none."""
    one = one.tolist() if isinstance(one, np.ndarray) else one
    if isinstance(one, Mapping):
        return one.keys() == other.keys() and all(_same(one[name], other[name]) for name in one)
    if isinstance(one, list | tuple):
        return len(one) == len(other) and all(map(_same, one, other))
    if isinstance(one, Real) and isinstance(other, Real):
        return not (math.isfinite(one) and math.isfinite(other)) or math.isclose(one, other, rel_tol=1e-6, abs_tol=1e-9)
    # complex numbers are a mistake of another kind
    return isinstance(one, complex) or (type(one) is type(other) and bool(one == other))
