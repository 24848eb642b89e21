"""The free body's step is MuJoCo's: the same bits, and what MuJoCo warns of is left to it."""

from __future__ import annotations

import platform

import mujoco
import numpy as np
import pytest
from numba import njit
from numpy.typing import NDArray

from uavaccel.sim.profile import NATIVE
from uavaccel.sim.vehicle.free_body import HUGE, free_step
from uavaccel.sim.vehicle.quadrotor import parameters
from uavaccel.sim.vehicle.vehicle import set_airframe
from uavaccel.sim.world import FlightError, World

STEPS = 10
SPEEDS = (0.0, 1e-3, 1.0, 5.0)


@njit
def step(parameters_of: NDArray[np.void], *arrays: NDArray[np.float64]) -> bool:
    return free_step(parameters_of[0], *arrays)


@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="MuJoCo adds up in another order there")
def test_a_step_has_the_bits_of_mujocos() -> None:
    """Any attitude, speed, spin, place and mass, zeros among them, ten steps on end."""
    world = World("lane", NATIVE)
    model, data = world.model, world.data
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    own = parameters(NATIVE.tick_s, 1, 1.0, model.body("quadrotor").inertia)
    rng = np.random.default_rng(5)
    for ratio in (1.0, *rng.uniform(0.5, 1.5, 400)):
        changed, acceleration = own.copy(), np.zeros(6)
        set_airframe(model, changed, own, ratio, 1.0)
        data.qpos[:3] = rng.uniform(-100, 100, 3)
        data.qpos[3:] = np.append(rng.normal(), rng.normal(size=3) * rng.integers(0, 2, 3))
        data.qpos[3:] *= rng.choice([1.0, 1.0, 1.001]) / np.linalg.norm(data.qpos[3:])
        data.qvel[:] = rng.normal(size=6) * rng.choice(SPEEDS, 6)
        qpos, qvel = data.qpos.copy(), data.qvel.copy()
        for _ in range(STEPS):
            data.qfrc_applied[:] = rng.normal(size=6) * rng.choice([0.0, 0.1, 10.0], 6)
            mujoco.mj_step(model, data)
            assert step(changed, qpos, qvel, data.qfrc_applied.copy(), acceleration)
            for mine, theirs in ((qpos, data.qpos), (qvel, data.qvel), (acceleration, data.qacc)):
                assert mine.tobytes() == theirs.tobytes()


@pytest.mark.parametrize("number", [np.nan, np.inf, -2 * HUGE])
@pytest.mark.parametrize("array", range(3))
def test_what_mujoco_warns_of_is_not_stepped(number: float, array: int) -> None:
    of = parameters(NATIVE.tick_s, 1, 1.0, np.full(3, 0.01))
    arrays = [np.array([0.0, 0.0, 5.0, 1.0, 0.0, 0.0, 0.0]), np.zeros(6), np.zeros(6)]
    arrays[array][2] = number
    before = [each.copy() for each in arrays]
    assert not step(of, *arrays, np.zeros(6))
    np.testing.assert_array_equal(arrays[0], before[0])
    np.testing.assert_array_equal(arrays[1], before[1])


def test_a_flight_that_breaks_down_in_open_air_is_mujocos_to_report() -> None:
    """A gale that only a wrong number can be: the flight says so, as with MuJoCo's own step."""
    world = World("lane", NATIVE)
    world.advance(100)
    assert world.clearance.left_out
    world.lead.state["wind"] = (1e9, 0.0, 0.0)
    with pytest.raises(FlightError, match="mjWARN_BAD"):
        world.advance(50)
