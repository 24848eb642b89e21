"""Lanes over arrays fly as the exact simulator does: the same games, to the last bit on the CPU."""

from __future__ import annotations

from contextlib import closing
from typing import Any

import numpy as np
import pytest

from uavaccel.envs.flight_env import FlightEnv
from uavaccel.envs.gates import Gates
from uavaccel.envs.hover import Hover
from uavaccel.envs.kernel_batch import KernelBatch
from uavaccel.envs.obstacle_lane import ObstacleLane

WINDY = {"difficulty": {"wind_m_s": 5.0, "mass_ratio": 1.1}, "speed_m_s": 2.0, "altitude_m": 1.0}
DRAWN = {
    "randomise": {"wind_m_s": [0, 6], "mass_ratio": [0.8, 1.2], "altitude_m": [1, 4], "min_gap_m": [1.5, 3]},
    "max_commands": 12,
    "wall_reward": -0.1,
}
OWN_LANE = {
    "lane": {
        "obstacles": [
            {"x_m": 6, "y_m": 0.6, "radius_m": 0.5, "texture": "blue"},
            {"x_m": 9, "y_m": -1.0, "half_side_m": 0.4},
        ]
    }
}
FLOWN: list[tuple[type[FlightEnv], dict[str, Any]]] = [
    (ObstacleLane, {"observation": "state", "history": 2}),
    (ObstacleLane, {"observation": "state", **WINDY}),
    (ObstacleLane, {"observation": "state", "clock_speed": 7.0, **DRAWN}),
    (ObstacleLane, {"observation": "state", "t_move_s": 0.5, "t_sample_s": 0.2, **OWN_LANE}),
    (Hover, {"hold_s": 0.4, "radius_m": 1.5, "max_commands": 40}),
    (Gates, {"t_move_s": 0.4, "t_sample_s": 0.2, "half_width_m": 1.5}),
]
UNEQUAL = ("host_phase_s",)


def actions_of(environment: Any, count: int, commands: int) -> np.ndarray:
    """Mostly ahead, so that some games are lost and others go far."""
    random, space = np.random.default_rng(count), environment.single_action_space
    if space.shape:
        return random.uniform((0.2, -0.6, -0.3), (1.0, 0.6, 0.3), (commands, count, 3)).astype(np.float32)
    return np.where(random.random((commands, count)) < 0.6, 2, random.integers(5, size=(commands, count)))


@pytest.mark.parametrize(("kind", "task"), FLOWN)
def test_a_lane_flies_as_in_the_exact_simulator(kind: type[FlightEnv], task: dict[str, Any]) -> None:
    """Observations, rewards, ends and infos of whole games, and of those that follow them, byte for byte."""
    count, commands = 5, 60
    with closing(KernelBatch(kind, count, threads=2, **task)) as batch:
        alone = [kind(**task) for _ in range(count)]
        seen = batch.reset(seed=7)[0]
        for lane, environment in enumerate(alone):
            assert seen[lane].tobytes() == environment.reset(seed=7 + lane)[0].tobytes()
        over, ends = [False] * count, 0
        for actions in actions_of(batch, count, commands):
            batch.step_async(actions)
            steps = batch.step_wait()
            for lane, environment in enumerate(alone):
                expected: Any = environment.step(actions[lane]) if not over[lane] else None
                if expected is None:  # autoreset in the next step
                    observation, info = environment.reset()
                    expected = (observation, 0.0, False, False, info)
                assert steps[4][lane] == expected[4]
                assert steps[0][lane].tobytes() == expected[0].tobytes()
                assert tuple(part[lane] for part in steps[1:4]) == expected[1:4]
                over[lane] = expected[2] or expected[3]
                ends += over[lane]
        for environment in alone:
            environment.close()
    assert ends >= count
