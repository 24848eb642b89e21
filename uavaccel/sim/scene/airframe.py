"""What a quadrotor of MJCF must be for the flight to be MuJoCo's: one free body, with inertia about its own axes.

The hot loop flies it without MuJoCo where nothing can be touched; what that cannot fly exactly is refused here.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

GRAVITY_M_S2 = (0.0, 0.0, -9.80665)
ALIGNED = 1e-9  # of the largest inertia: a smaller product of inertia comes from rounding
SAME = 1e-9  # of an acceleration
RIGHT = 'needs <inertial pos="0 0 0" mass="..." diaginertia="..."/>'


def check_airframes(model: mujoco.MjModel, spec: mujoco.MjSpec, names: Sequence[str]) -> None:
    """Raise ValueError, which names body and attribute, for a quadrotor of `names` that cannot be flown exactly.

    `spec` is that of the first one's scene. A full inertia without products is written about the body's axes in the
    model, where MuJoCo has it about axes of its own order.
    """
    from_geoms = spec.compiler.inertiafromgeom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
    if from_geoms or not spec.body(names[0]).explicitinertial:
        raise ValueError(f'body "{names[0]}": inertial is missing, and its geoms make no drone: {RIGHT}')
    bodies = [int(model.body(name).id) for name in names]
    turned = [_align(model, body, name) for body, name in zip(bodies, names, strict=True)]
    if any(turned):
        mujoco.mj_setConst(model, mujoco.MjData(model))
    for body, name in zip(bodies, names, strict=True):
        if not _is_free(model, body):
            raise ValueError(
                f'body "{name}": joints, gravity, gravcomp, damping, a fluid or constraints act on it; it is '
                f'flown as one body with a freejoint, without these, under gravity="{_text(GRAVITY_M_S2)}"'
            )


def _align(model: mujoco.MjModel, body: int, name: str) -> bool:
    """Check one inertial; return whether its inertia had to be written about the body's axes."""
    for child in _children(model, body):
        if model.body_mass[child]:
            inner = model.body(child).name or "a child"
            raise ValueError(
                f'body "{name}": its child body "{inner}" has a mass of {model.body_mass[child]:.3g} kg: add '
                f'that to the inertial of "{name}", and give the child\'s geoms mass="0"'
            )
    if model.body_ipos[body].any():
        raise ValueError(
            f'body "{name}": inertial pos="{_text(model.body_ipos[body])}": the centre of mass must be the '
            'body\'s origin, pos="0 0 0", about which the rotors push; move the geoms instead'
        )
    inertia = _inertia(model, body)
    own = np.diagonal(inertia)
    if np.abs(inertia - np.diag(own)).max() > ALIGNED * own.max():
        raise ValueError(
            f'body "{name}": inertial quat or fullinertia: the principal axes must be the body\'s, without '
            f"products of inertia: {RIGHT}"
        )
    if np.array_equal(model.body_iquat[body], (1.0, 0.0, 0.0, 0.0)):
        return False
    model.body_inertia[body], model.body_iquat[body] = own, (1.0, 0.0, 0.0, 0.0)
    model.body_sameframe[body] = mujoco.mjtSameFrame.mjSAMEFRAME_BODY
    return True


def _children(model: mujoco.MjModel, body: int) -> Iterator[int]:
    return (child for child in range(body + 1, model.nbody) if model.body_rootid[child] == body)


def _inertia(model: mujoco.MjModel, body: int) -> NDArray[np.float64]:
    """Return the inertia (3, 3), kg m², about the body's axes."""
    flat = np.empty(9)
    mujoco.mju_quat2Mat(flat, model.body_iquat[body])
    turn = flat.reshape(3, 3)
    return np.asarray(turn @ np.diag(model.body_inertia[body]) @ turn.T)


def _is_free(model: mujoco.MjModel, body: int) -> bool:
    """Whether MuJoCo accelerates a body, away from all others, as one free body under gravity alone."""
    euler = model.opt.integrator == mujoco.mjtIntegrator.mjINT_EULER
    if model.body_dofnum[body] != 6 or model.body_jntnum[body] != 1 or not euler:
        return False
    data, flags = mujoco.MjData(model), model.opt.disableflags
    dofs = slice(int(model.body_dofadr[body]), int(model.body_dofadr[body]) + 6)
    speed, spin, push = np.array([3.0, -5.0, 7.0]), np.array([1.0, 2.0, -1.5]), np.array([0.3, 0.2, -0.1])
    data.qvel[dofs], data.qfrc_applied[dofs] = (*speed, *spin), (*push, *push)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    mujoco.mj_step(model, data)
    model.opt.disableflags = flags
    mass, inertia = model.body_mass[body], model.body_inertia[body]
    free = (*(push / mass + GRAVITY_M_S2), *((push - np.cross(spin, inertia * spin)) / inertia))
    return np.allclose(data.qacc[dofs], free, rtol=SAME, atol=SAME) and np.allclose(
        data.qvel[dofs], (*speed, *spin) + model.opt.timestep * np.array(free), rtol=SAME, atol=SAME
    )


def _text(numbers: Sequence[float] | NDArray[np.float64]) -> str:
    return " ".join(f"{number:g}" for number in numbers)
