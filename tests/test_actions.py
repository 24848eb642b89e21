"""Actions below velocities: attitudes, body rates, motors; what they ask of the drone, and what comes of it."""

from __future__ import annotations

from dataclasses import astuple
from typing import Any

import gymnasium
import numpy as np
import pytest
from numpy.typing import NDArray

import uavaccel.envs  # noqa: F401 - registers
from uavaccel.envs.actions import HOVER_THROTTLE
from uavaccel.envs.hover import HoverTask
from uavaccel.kinematics import AttitudeGoal, BodyRatesGoal, MotorsGoal

KINDS = ("attitude", "rates", "motors")


def states_of(actions: list[Any], name: str = "Hover", **keys: Any) -> NDArray[np.float64]:
    """Position, velocity and body rate (commands, 9) after each command of 0.02 s, NED and FRD."""
    env: Any = gymnasium.make(f"uavaccel/{name}-v0", t_move_s=0.02, t_sample_s=0.02, **keys)
    env.reset(seed=0)
    states = []
    for action in actions:
        env.step(np.asarray(action, np.float32))
        state = env.unwrapped._now.state
        states.append([*state.position_m, *state.linear_velocity_m_s, *state.angular_velocity_rad_s])
    env.close()
    return np.array(states)


def test_shares_become_goals() -> None:
    shares = [0.5, -1.0, 0.25, 0.0]
    attitude = HoverTask(action="attitude", tilt_deg=20.0, rate_deg_s=90.0).goal(shares)
    assert isinstance(attitude, AttitudeGoal)
    assert np.degrees(astuple(attitude)[:3]) == pytest.approx([10, -20, 22.5])
    assert attitude.throttle == HOVER_THROTTLE
    rates = HoverTask(action="rates", rate_deg_s=90.0).goal([0.5, -1.0, 0.25, 1.0])
    assert isinstance(rates, BodyRatesGoal)
    assert np.degrees(astuple(rates)[:3]) == pytest.approx([45, -90, 22.5])
    assert rates.throttle == 1.0
    motors = HoverTask(action="motors").goal([-1.0, 0.0, 1.0, -0.5])
    assert motors == MotorsGoal(0.0, HOVER_THROTTLE, 1.0, HOVER_THROTTLE / 2)


@pytest.mark.parametrize("kind", KINDS)
def test_zero_hovers(kind: str) -> None:
    states = states_of([np.zeros(4)] * 100, action=kind)
    np.testing.assert_allclose(states[:, :3], [[0.0, 0.0, -10.0]] * 100, atol=0.05)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("timing", ["virtual", "lockstep"])
def test_tcsc_flies_them_the_same_at_any_clock_speed(kind: str, timing: str) -> None:
    actions = np.random.default_rng(1).uniform(-0.2, 0.2, (20, 4))
    flights = [
        states_of(list(actions), "Gates", action=kind, timing=timing, clock_speed=speed) for speed in (1.0, 50.0)
    ]
    np.testing.assert_array_equal(flights[0], flights[1])
    adsc = states_of(list(actions), "Gates", action=kind, timing="virtual", command="adsc", clock_speed=50.0)
    assert np.abs(adsc - flights[0]).max() > 0.01
