"""Courses of many games as tensors: each number of a course becomes a tensor (n,), in lists nested as before."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch as th
from numpy.typing import NDArray


def allocate(example: Any, count: int, device: th.device) -> Any:
    """Return zeros for `count` values of the types and nesting of one game's."""
    if isinstance(example, (list, tuple)):
        return [allocate(each, count, device) for each in example]
    kind = {bool: th.bool, int: th.int64}.get(type(example), th.float64)
    return th.zeros(count, dtype=kind, device=device)


def to_device(values: NDArray[Any], device: th.device) -> th.Tensor:
    """Copy a NumPy array to the device without waiting for the transfer."""
    tensor = th.from_numpy(np.ascontiguousarray(values))
    return tensor.pin_memory().to(device, non_blocking=True) if device.type == "cuda" else tensor


def write_rows(part: Any, rows: th.Tensor, values: Any) -> None:
    """Write a NumPy array (n, ...) to `rows` (n,)."""
    if isinstance(part, list):
        for number, each in enumerate(part):
            write_rows(each, rows, values[:, number])
    else:
        part[rows] = to_device(values, part.device).to(part.dtype)


def assign_where(part: Any, values: Any, where: th.Tensor) -> None:
    """Assign `values` (n,) in place where the flag `where` (n,) is set."""
    if isinstance(part, list):
        for each, value in zip(part, values, strict=True):
            assign_where(each, value, where)
    else:
        part.copy_(th.where(where, values, part))


def clone(course: Any) -> Any:
    """Return a deep copy."""
    if isinstance(course, dict):
        return {name: clone(each) for name, each in course.items()}
    return [clone(each) for each in course] if isinstance(course, list) else course.clone()


def tensors(course: Any) -> list[th.Tensor]:
    """Return all tensors of a course, in order."""
    if isinstance(course, dict):
        return [tensor for each in course.values() for tensor in tensors(each)]
    return [tensor for each in course for tensor in tensors(each)] if isinstance(course, list) else [course]
