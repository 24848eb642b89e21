"""Lanes over arrays keep time as the exact simulator does: its clock, its phases, its ticks."""

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

CHANNELS_US = {
    "call": 31.0,
    "move": 47.5,
    "move@10ms": 911.3,
    "pause": 83.2,
    "pause@20ms": 124.9,
    "continue": 21.7,
    "continue_for": 140.1,
    "continue_for@5ms": 77.7,
    "state": 19.3,
    "image": 1003.9,
}
PLATFORM = {"tick_us": 45.0, "integer_clock_speed": True, "frames": {"hz": 60.0, "stale_pose": True}}


def constant(platform: dict[str, Any] | None = None, scale: float = 1.0, factor: float = 1.0) -> dict[str, Any]:
    """A latency model that always draws the same."""
    request = {name: [each * factor] * 2 for name, each in CHANNELS_US.items()}
    reply = {name: [1.7 * factor * each] * 2 for name, each in CHANNELS_US.items()}
    tables = {"quantiles": [0.0, 1.0], "request_us": request, "reply_us": reply, "scale": scale}
    return {**tables, "issue_us": [10.3] * 2, "timer_us": [61.0] * 2, "platform": platform or {}}


def pair(kind: type[FlightEnv], task: dict[str, Any], count: int) -> Any:
    return KernelBatch(kind, count, threads=1, **task), [kind(**task) for _ in range(count)]


def actions_of(environment: Any, count: int, commands: int) -> Any:
    random, space = np.random.default_rng(count), environment.single_action_space
    if space.shape:
        return random.uniform((0.2, -0.6, -0.3), (1.0, 0.6, 0.3), (commands, count, 3)).astype(np.float32)
    return np.where(random.random((commands, count)) < 0.6, 2, random.integers(5, size=(commands, count)))


SLOW = {"t_move_s": 0.5, "t_sample_s": 0.2}
STEADY: list[tuple[type[FlightEnv], dict[str, Any]]] = [
    (kind, {"command": command, "profile": profile, "observation": "state", **keys})
    for command in ("adsc", "tcsc")
    for profile in ("native", "airsim")
    for kind, keys in (
        (ObstacleLane, {"timing": "virtual", "clock_speed": 1.0, "latency": constant()}),
        (ObstacleLane, {"timing": "virtual", "clock_speed": 7.5, "latency": constant(scale=1.3), **SLOW}),
        (ObstacleLane, {"timing": "virtual", "clock_speed": 30.0, "latency": constant(PLATFORM, factor=8.0)}),
        (Hover, {"timing": "lockstep", "clock_speed": 3.0, "max_commands": 20}),
    )
] + [
    (Gates, {"command": "adsc", "timing": "virtual", "latency": constant({"stall_us": 40_000.0}), **SLOW}),
    (
        Hover,
        {
            "timing": "virtual",
            "profile": "airsim",
            "t_th_wall_s": 0.0,
            "latency": constant({"stall_us": 900.0, "exact_pauses": True, "goal_timeout_s": 0.02}),
        },
    ),
]


@pytest.mark.parametrize(("kind", "task"), STEADY)
def test_a_lane_keeps_the_exact_simulators_time(kind: type[FlightEnv], task: dict[str, Any]) -> None:
    """Where latencies do not vary: observations, rewards, ends, and all times, byte for byte."""
    count, commands, random = 3, 25, np.random.default_rng(1)
    batch, alone = pair(kind, task, count)
    with closing(batch):
        seen = batch.reset(seed=7)[0]
        for lane, environment in enumerate(alone):
            assert seen[lane].tobytes() == environment.reset(seed=7 + lane)[0].tobytes()
        over = [False] * count
        for actions in actions_of(batch, count, commands):
            for lane, phase in enumerate(("inference", "learning", "inference")):
                spent_s = random.exponential(0.02)
                batch.call_each("charge", [(spent_s, phase)], [lane])
                alone[lane].charge(spent_s, phase)
            batch.step_async(actions)
            observations, rewards, ends, cuts, infos = batch.step_wait()
            for lane, environment in enumerate(alone):
                if over[lane]:
                    observation, info = environment.reset()
                    expected: Any = (observation, 0.0, False, False, info)
                else:
                    expected = environment.step(actions[lane])
                assert infos[lane] == expected[4]
                assert observations[lane].tobytes() == expected[0].tobytes()
                assert (rewards[lane], ends[lane], cuts[lane]) == expected[1:4]
                over[lane] = expected[2] or expected[3]
        for environment in alone:
            environment.close()
