"""MuJoCo's state, saved and restored."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

PHYSICS = int(mujoco.mjtState.mjSTATE_INTEGRATION)


def physics_state(model: mujoco.MjModel, data: mujoco.MjData) -> NDArray[np.float64]:
    """Return MuJoCo's integration state."""
    values = np.empty(mujoco.mj_stateSize(model, PHYSICS))
    mujoco.mj_getState(model, data, values, PHYSICS)
    return values


def restore_physics(model: mujoco.MjModel, data: mujoco.MjData, values: ArrayLike) -> None:
    """Restore what `physics_state` returned, and update the positions of all bodies."""
    mujoco.mj_setState(model, data, np.asarray(values, float), PHYSICS)
    mujoco.mj_kinematics(model, data)
