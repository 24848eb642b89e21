"""Values that tasks, sensors and environments exchange: their types, and what is done with arrays and tensors alike."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from gymnasium.vector import VectorEnv
from numpy.typing import NDArray

from uavaccel.kinematics import Kinematics, Vector

Number: TypeAlias = Any
"""A number of one game, or those of n games: a NumPy array or PyTorch tensor (n,)."""

Course = Mapping[str, Number]
"""A task's variables of a game: numbers, and lists and mappings of numbers."""

Action: TypeAlias = Any
"""An element of the action space: an int, or an array."""

Frame = NDArray[np.integer | np.floating]
"""A frame, which a sensor makes of a sample, or an observation, several frames on axis 0: uint8 or float32."""

Observation: TypeAlias = Any
"""A Frame, or a mapping of frames by name; of many environments, an array (n, ...) or a mapping of these."""

Info = dict[str, Any]
"""The info dictionary of Gymnasium's `reset` and `step`."""

Actions = Sequence[Action] | NDArray[np.generic]
"""Actions of many environments."""

Outcomes = NDArray[np.float64 | np.bool_]
"""Rewards, terminations or truncations of many environments."""

Batch = VectorEnv[Observation, Actions, Outcomes]
"""Many environments of one task."""

Steps = tuple[Observation, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], list[Info]]
"""Observations, rewards, terminations, truncations and infos of many environments."""

State = dict[str, Any]
"""What a saved game is restored from: texts, numbers and arrays by name, for np.savez."""

SavedState = Mapping[str, Any]
"""A `State` as it was, or as np.load returns it."""

Answer: TypeAlias = Any
"""Result of a method of an environment, or value of its attribute."""

AT_REST = Kinematics(0, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


class Moment(NamedTuple):
    """A game's state at its start or at the end of a command.

    The functions of a task take the `Moment` of one game or the `Moments` of many: they compute with plain arithmetic,
    which is the same for a float and for an array.
    """

    state: Kinematics
    """State of the last sample, of those before a collision."""
    position_m: Vector
    """Position of the vehicle or, after a collision, of its first contact: NED."""
    collision: str | None
    """Name of the object it hit; None without a collision."""
    commands: int
    """Commands flown so far."""
    course: Course
    """The task's own variables, sampled at reset and updated by `advance`: plain numbers, lists and mappings."""

    @property
    def touched(self) -> bool:
        return self.collision is not None

    @property
    def free(self) -> bool:
        return self.collision is None


class Collisions:
    """What the vehicles of n games hit: `== "ground"` is an array (n,), as it is a bool for the name of one game's.

    `index` (n,) is that of the name in `objects`, -1 without a collision, for which `touched` and `free` ask.
    """

    __hash__ = None  # type: ignore[assignment]

    def __init__(self, index: Number, objects: tuple[str, ...]) -> None:
        self.index, self.objects = index, objects

    def __eq__(self, name: object) -> Number:
        if not isinstance(name, str):
            raise TypeError("a collision is compared with the name of an object; touched and free say if there is any")
        return self.index == (self.objects.index(name) if name in self.objects else len(self.objects))

    def __ne__(self, name: object) -> Number:
        return ~(self == name)


class Moments(NamedTuple):
    """The state of n games: where `Moment` has a number, a NumPy array or a PyTorch tensor (n,)."""

    state: Kinematics
    position_m: Sequence[Number]
    """Three arrays: north, east, down."""
    collision: Collisions
    commands: Number
    course: Course
    """A list of numbers in a game's course is a list of arrays here."""

    @property
    def touched(self) -> Number:
        return self.collision.index >= 0

    @property
    def free(self) -> Number:
        return self.collision.index < 0


AnyMoment: TypeAlias = Any
"""A Moment or Moments; a user's task may handle only one of them."""

# --- arrays -----------------------------------------------------------------------------------------

Tree: TypeAlias = Any
"""An array, or arrays in nested mappings, lists and tuples."""


def namespace_of(array: Number) -> Any:
    """Return the module that computes with an array: numpy or torch."""
    if isinstance(array, np.ndarray):
        return np
    import torch  # loaded where there are tensors

    return torch


def cast(array: Number, kind: str) -> Number:
    """Return an array with elements of a kind, such as "float64"."""
    xp = namespace_of(array)
    return array.astype(kind) if xp is np else array.to(getattr(xp, kind))


def full(value: Number, like: Number) -> Number:
    """Return a number, or an array (n,), as an array (n,) where `like` (n,) is."""
    if getattr(value, "ndim", 0):
        return value
    xp = namespace_of(like)
    return xp.full(like.shape, value, dtype=xp.float64 if isinstance(value, float) else None, device=like.device)


def joined(values: Any, like: Number) -> Number:
    """Return nested lists of numbers, or of arrays (n,) such as `like`, as one array (n, ...)."""
    if isinstance(values, list | tuple):
        return namespace_of(like).stack([joined(value, like) for value in values], 1)
    return full(values, like)


def constant(array: NDArray[Any], like: Number) -> Number:
    """Return an array that never changes, as a tensor on the device of `like` if that is one."""
    if isinstance(like, np.ndarray | np.generic | int):
        return array
    return _on_device(array.tobytes(), array.shape, array.dtype.str, like.device)


@lru_cache(maxsize=64)  # a tensor cannot be made while a CUDA graph is recorded
def _on_device(data: bytes, shape: tuple[int, ...], kind: str, device: Any) -> Any:
    import torch as th

    return th.from_numpy(np.frombuffer(data, kind).reshape(shape).copy()).to(device)


# --- nested -----------------------------------------------------------------------------------------


def mapped(function: Callable[..., Any], tree: Tree, *others: Tree) -> Tree:
    """Return what a function makes of each array, and of those in its place in `others`."""
    if isinstance(tree, Mapping):
        return {name: mapped(function, part, *(other[name] for other in others)) for name, part in tree.items()}
    if not isinstance(tree, list | tuple):
        return function(tree, *others)
    parts = [mapped(function, *each) for each in zip(tree, *others, strict=True)]
    return type(tree)(*parts) if hasattr(tree, "_fields") else parts


def named_leaves(tree: Tree, name: str) -> dict[str, Any]:
    """Return all arrays by the names and numbers on the way to them, after `name`, joined by dots."""
    inside: Any = tree.items() if isinstance(tree, Mapping) else None
    if isinstance(tree, list | tuple):
        inside = zip(getattr(tree, "_fields", range(len(tree))), tree, strict=True)
    if inside is None:
        return {name: tree}
    return {key: leaf for part, each in inside for key, leaf in named_leaves(each, f"{name}.{part}").items()}


def select(tree: Tree, games: Any) -> Tree:
    """Return the elements `games` (m,) of all arrays; views of one game's, with None one game as a batch."""
    return mapped(lambda array: array[games], tree)


def one_of(tree: Tree, game: int) -> Tree:
    """Return a game's part of all arrays, as plain numbers and lists."""
    return mapped(lambda array: array[game].tolist() if getattr(array, "ndim", 0) else array, tree)


def assign(tree: Tree, games: Any, values: Tree) -> None:
    """Write values, of one game or of several, to the elements `games` of all arrays."""
    mapped(lambda array, value: array.__setitem__(games, value), tree, values)


def assign_where(tree: Tree, where: Any, values: Tree) -> None:
    """Write values (n, ...) in place to the elements of all tensors whose flag in `where` (n,) is set."""

    def write(tensor: Any, value: Any) -> None:
        flags = where.reshape(-1, *(1,) * (tensor.ndim - 1))
        tensor.copy_(namespace_of(tensor).where(flags, value, tensor))

    mapped(write, tree, values)


def stacked(courses: Sequence[Mapping[str, Any]]) -> dict[str, Tree]:
    """Stack the courses of n games: each number becomes an array (n,), each list of numbers a list of arrays."""
    return {name: _columns(np.array([course[name] for course in courses])) for name in courses[0]}


def _columns(values: Number) -> Tree:
    """Turn an array (n, a, b) into a list of a lists of b arrays (n,)."""
    return values if values.ndim == 1 else [_columns(values[:, each]) for each in range(values.shape[1])]


def stacked_observations(observations: Sequence[Observation]) -> Observation:
    """Return several observations as a batch."""
    return mapped(lambda *parts: np.stack(parts), *observations)


def picture_of(observations: Observation) -> Observation:
    """Return the pictures of observations that have the state beside them; others as they are."""
    return observations["image"] if isinstance(observations, Mapping) else observations
