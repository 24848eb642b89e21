"""States that can be saved: flat mappings from dotted names to numbers, texts and NumPy arrays.

They survive `np.savez` and, with units.plain, JSON; what reads them takes an array, a list or a NumPy scalar alike.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeAlias

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

SavedValue: TypeAlias = Any  # a number, a text or an array, or what NumPy and JSON read one back as
State = dict[str, SavedValue]
SavedState = Mapping[str, SavedValue]
PHYSICS = int(mujoco.mjtState.mjSTATE_INTEGRATION)


def prefixed(name: str, state: SavedState) -> State:
    """The state of a part, as the whole keeps it."""
    return {f"{name}.{key}": value for key, value in state.items()}


def without_prefix(name: str, state: SavedState) -> State:
    """The inverse of `prefixed`, out of the state of the whole."""
    prefix = f"{name}."
    return {key[len(prefix) :]: value for key, value in state.items() if key.startswith(prefix)}


def of_record(record: NDArray[np.void]) -> State:
    """The fields of one structured record (1,)."""
    return {name: record[name][0].copy() for name in record.dtype.names or ()}


def into_record(record: NDArray[np.void], state: SavedState) -> None:
    """Set the fields of one structured record (1,), in place; what an older state lacks stays as it is."""
    for name in record.dtype.names or ():
        if name in state:
            record[name][0] = state[name]


def optional(number: int | None) -> NDArray[np.int64]:
    """A number that may be missing, as an array of one or none."""
    return np.array([] if number is None else [number], np.int64)


def number_or_none(array: ArrayLike) -> int | None:
    """The inverse of `optional`; a bare number is itself."""
    found = np.ravel(array)
    return int(found[0]) if len(found) else None


def of_physics(model: mujoco.MjModel, data: mujoco.MjData) -> NDArray[np.float64]:
    """MuJoCo's state for its integrator."""
    values = np.empty(mujoco.mj_stateSize(model, PHYSICS))
    mujoco.mj_getState(model, data, values, PHYSICS)
    return values


def into_physics(model: mujoco.MjModel, data: mujoco.MjData, values: ArrayLike) -> None:
    """The inverse of `of_physics`, with the places of all bodies."""
    mujoco.mj_setState(model, data, np.asarray(values, float), PHYSICS)
    mujoco.mj_kinematics(model, data)
