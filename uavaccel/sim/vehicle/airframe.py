"""A vehicle heavier or lighter than AirSim's, or with other motors: what domain randomisation changes of it."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray


def set_airframe(
    model: mujoco.MjModel,
    parameters: NDArray[np.void],
    own: NDArray[np.void],
    mass_ratio: float,
    thrust_ratio: float,
) -> None:
    """Set, in place, mass and inertia to `mass_ratio` times those of `own`, thrust and torque to `thrust_ratio` times.

    Both records (1,) are of quadrotor.PARAMETERS_DTYPE. The gains of the autopilot stay: it does not know. What MuJoCo
    derives from the mass for contacts stays too, since in the lane the first touch ends a game.
    """
    for name in ("mass_kg", "inertia_kg_m2"):
        parameters[name] = mass_ratio * own[name]
    for name in ("max_thrust_n", "max_torque_n_m"):
        parameters[name] = thrust_ratio * own[name]
    body = model.body("quadrotor").id
    mass_kg, inertia = parameters["mass_kg"][0], parameters["inertia_kg_m2"][0]
    if model.body_mass[body] == mass_kg:
        return
    model.body_subtreemass[[0, body]] += mass_kg - model.body_mass[body]
    model.body_mass[body], model.body_inertia[body] = mass_kg, inertia
    model.dof_M0[:3], model.dof_M0[3:6] = mass_kg, inertia  # MuJoCo takes a free body's mass matrix from here
