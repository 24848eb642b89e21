"""Arrays of NumPy and tensors of PyTorch, on any device, under one roof; also in nested mappings, lists and tuples."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import lru_cache
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from uavaccel.envs.values import Number, Observation

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


def rank(array: Number) -> int:
    """Return 0 for flags, 1 for whole numbers, 2 for fractions, and 3 for anything else."""
    kinds = "bool", "int", "float"
    return next((place for place, kind in enumerate(kinds) if kind in str(array.dtype)), len(kinds))


# --- nested -----------------------------------------------------------------------------------------


def mapped(function: Callable[..., Any], tree: Tree, *others: Tree) -> Tree:
    """Return what a function makes of each array, and of those in its place in `others`."""
    if isinstance(tree, Mapping):
        return {name: mapped(function, part, *(other[name] for other in others)) for name, part in tree.items()}
    if not isinstance(tree, list | tuple):
        return function(tree, *others)
    parts = [mapped(function, *each) for each in zip(tree, *others, strict=True)]
    return type(tree)(*parts) if hasattr(tree, "_fields") else parts


def copied(tree: Tree) -> Tree:
    """Return mappings and lists of one's own, of the same arrays."""
    return mapped(lambda array: array, tree)


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


def each_of(tree: Tree, count: int) -> list[Tree]:
    """Return the part of each of `count` games of all arrays, as plain numbers and lists; the rest is everyone's."""
    if isinstance(tree, Mapping):
        parts = {name: each_of(part, count) for name, part in tree.items()}
        return [{name: part[game] for name, part in parts.items()} for game in range(count)]
    if isinstance(tree, list | tuple):
        make: Callable[[Any], Tree] = getattr(tree, "_make", list)
        inside = [each_of(part, count) for part in tree]
        return [make(part[game] for part in inside) for game in range(count)]
    return tree.tolist() if getattr(tree, "ndim", 0) else [tree] * count


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
    """Stack the courses of n games: each number becomes an array (n,) in its place.

    Raises TypeError or ValueError unless they are of numbers and nested alike.
    """
    if any(course.keys() != courses[0].keys() for course in courses):
        raise TypeError
    return {name: _stacked([course[name] for course in courses]) for name in courses[0]}


def _stacked(values: Sequence[Any]) -> Tree:
    if isinstance(values[0], Mapping):
        return stacked(values)
    with suppress(ValueError):  # of lists of different lengths
        if (stack := np.array(values)).dtype.kind in "biuf":
            return _columns(stack)
    if not isinstance(values[0], list | tuple):
        raise TypeError
    return [_stacked(each) for each in zip(*values, strict=True)]


def _columns(values: Number) -> Tree:
    """Turn an array (n, a, b) into a list of a lists of b arrays (n,)."""
    return values if values.ndim == 1 else [_columns(values[:, each]) for each in range(values.shape[1])]


def stacked_observations(observations: Sequence[Observation]) -> Observation:
    """Return several observations as a batch."""
    return mapped(lambda *parts: np.stack(parts), *observations)


def picture_of(observations: Observation) -> Observation:
    """Return the pictures of observations that have the state beside them; others as they are."""
    return observations["image"] if isinstance(observations, Mapping) else observations
