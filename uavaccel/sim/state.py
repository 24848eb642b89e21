"""Saved states: flat mappings from dotted names to numbers, texts and NumPy arrays.

A component's `get_state` returns one, and its `set_state` restores it. They can be stored by `np.savez` and, with
units.plain, as JSON; readers accept arrays, lists and NumPy scalars.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeAlias

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

SavedValue: TypeAlias = Any  # a number, a text or an array, or what NumPy or JSON returns for one
State = dict[str, SavedValue]
SavedState = Mapping[str, SavedValue]
PHYSICS = int(mujoco.mjtState.mjSTATE_INTEGRATION)


def prefixed(name: str, state: SavedState) -> State:
    """Prefix the names in a component's state, for the state of the whole."""
    return {f"{name}.{key}": value for key, value in state.items()}


def without_prefix(name: str, state: SavedState) -> State:
    """Extract a component's state from that of the whole: the inverse of `prefixed`."""
    prefix = f"{name}."
    return {key[len(prefix) :]: value for key, value in state.items() if key.startswith(prefix)}


def record_fields(record: NDArray[np.void]) -> State:
    """Return the fields of a structured record (1,)."""
    return {name: record[name][0].copy() for name in record.dtype.names or ()}


def set_record_fields(record: NDArray[np.void], state: SavedState) -> None:
    """Set the fields of a structured record (1,) in place; fields that an older state lacks stay as they are."""
    for name in record.dtype.names or ():
        if name in state:
            record[name][0] = state[name]


def store_optional(number: int | None) -> NDArray[np.int64]:
    """Store a number that may be None, as an array of one element or none."""
    return np.array([] if number is None else [number], np.int64)


def load_optional(array: ArrayLike) -> int | None:
    """Read what `store_optional` stored, or a plain number."""
    found = np.ravel(array)
    return int(found[0]) if len(found) else None


def physics_state(model: mujoco.MjModel, data: mujoco.MjData) -> NDArray[np.float64]:
    """Return MuJoCo's integration state."""
    values = np.empty(mujoco.mj_stateSize(model, PHYSICS))
    mujoco.mj_getState(model, data, values, PHYSICS)
    return values


def restore_physics(model: mujoco.MjModel, data: mujoco.MjData, values: ArrayLike) -> None:
    """Restore what `physics_state` returned, and update the positions of all bodies."""
    mujoco.mj_setState(model, data, np.asarray(values, float), PHYSICS)
    mujoco.mj_kinematics(model, data)
