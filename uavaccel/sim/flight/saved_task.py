"""A task in a saved game: its class's name and its fields."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import fields

import numpy as np

from uavaccel.sim.flight.manual import MoveByManual
from uavaccel.sim.flight.path import FollowPath
from uavaccel.sim.flight.task import Land, RotateToYaw, Task
from uavaccel.sim.saved import SavedState, SavedValue, State, prefixed, without_prefix

TASKS: dict[str, type[Task]] = {kind.__name__: kind for kind in (FollowPath, Land, MoveByManual, RotateToYaw)}


def _numbers(value: Iterable[float]) -> tuple[float, ...]:
    return tuple(float(number) for number in value)


_READ: dict[str, Callable[[SavedValue], object]] = {  # by the annotation of a task's field
    "float": float,
    "int": int,
    "bool": bool,
    "Vector": _numbers,
    "Quaternion": _numbers,
    "Array": np.array,
    "Sticks": np.array,
}


def state_of(task: Task | None) -> State:
    """Nothing for no task."""
    if task is None:
        return {}
    kept = {field.name: np.asarray(getattr(task, field.name)) for field in fields(task)}  # type: ignore[arg-type]
    return {"task": type(task).__name__} | prefixed("task", kept)


def task_of(state: SavedState) -> Task | None:
    """The inverse of `state_of`."""
    if "task" not in state:
        return None
    kind, kept = TASKS[str(state["task"])], without_prefix("task", state)
    return kind(**{field.name: _READ[str(field.type)](kept[field.name]) for field in fields(kind)})  # type: ignore[arg-type]
