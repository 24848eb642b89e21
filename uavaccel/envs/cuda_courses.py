"""Courses of many games as tensors: where a game's course has a number, a tensor (n,), in lists of the same shape."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch as th
from numpy.typing import NDArray


def room(example: Any, count: int, device: th.device) -> Any:
    """Zeros for so many values like one game's."""
    if isinstance(example, (list, tuple)):
        return [room(each, count, device) for each in example]
    kind = {bool: th.bool, int: th.int64}.get(type(example), th.float64)
    return th.zeros(count, dtype=kind, device=device)


def sent(values: NDArray[Any], device: th.device) -> th.Tensor:
    """Values of NumPy on the device, on their way there while the host goes on."""
    here = th.from_numpy(np.ascontiguousarray(values))
    return here.pin_memory().to(device, non_blocking=True) if device.type == "cuda" else here


def fill(part: Any, rows: th.Tensor, values: Any) -> None:
    """Write values (n, ...) of NumPy to some rows (n,)."""
    if isinstance(part, list):
        for number, each in enumerate(part):
            fill(each, rows, values[:, number])
    else:
        part[rows] = sent(values, part.device).to(part.dtype)


def taken(part: Any, rows: th.Tensor) -> Any:
    """The values of some rows."""
    return [taken(each, rows) for each in part] if isinstance(part, list) else part[rows]


def put(part: Any, values: Any, where: th.Tensor) -> None:
    """Take other values where a flag (n,) is set."""
    if isinstance(part, list):
        for each, value in zip(part, values, strict=True):
            put(each, value, where)
    else:
        part.copy_(th.where(where, values, part))


def copied(course: Any) -> Any:
    """The same values in memory of its own."""
    if isinstance(course, dict):
        return {name: copied(each) for name, each in course.items()}
    return [copied(each) for each in course] if isinstance(course, list) else course.clone()


def tensors(course: Any) -> list[th.Tensor]:
    """All of them, in order."""
    if isinstance(course, dict):
        return [tensor for each in course.values() for tensor in tensors(each)]
    return [tensor for each in course for tensor in tensors(each)] if isinstance(course, list) else [course]
