"""Batches of lanes over arrays on the CPU: saved, timed and aged; tests/test_engines_agree.py has their flights."""

from __future__ import annotations

from contextlib import closing
from itertools import count
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from uavaccel.envs.flight_env import FlightEnv
from uavaccel.envs.gates import Gates
from uavaccel.envs.hover import Hover
from uavaccel.envs.kernel_batch import KernelBatch
from uavaccel.envs.obstacle_lane import ObstacleLane


def actions_of(environment: Any, count: int, commands: int) -> np.ndarray:
    """Mostly ahead, so that some games are lost and others go far."""
    random, space = np.random.default_rng(count), environment.single_action_space
    if space.shape:
        return random.uniform((0.2, -0.6, -0.3), (1.0, 0.6, 0.3), (commands, count, 3)).astype(np.float32)
    return np.where(random.random((commands, count)) < 0.6, 2, random.integers(5, size=(commands, count)))


SAVED: list[tuple[type[FlightEnv], dict[str, Any]]] = [
    (ObstacleLane, {"history": 2, "knows": ["last_action", "frame_age"], "dvs_shot_noise_hz": 2.0, "max_commands": 3}),
    (
        ObstacleLane,
        {
            "observation": "state",
            "history": 2,
            "max_commands": 3,
            "timing": "virtual",
            "command": "adsc",
            "randomise": {"wind_m_s": [4, 6], "latency_scale": [1, 3], "widen_over_games": 9},
        },
    ),
    (Hover, {"hold_s": 0.4, "radius_m": 2.5, "max_commands": 3}),
    (Gates, {"max_commands": 3, "t_move_s": 1.0, "t_sample_s": 1.0, "half_width_m": 2.5, "spacing_m": 1.0}),
]


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
@pytest.mark.parametrize(("kind", "task"), SAVED)
def test_saved_lanes_go_on_in_another_batch_to_the_same_bytes(
    kind: type[FlightEnv], task: dict[str, Any], mode: str
) -> None:
    """One after its first command, one after its second, one whose game is over, each in its second game or later."""
    lanes = 3
    one, other = (KernelBatch(kind, lanes, threads=1, autoreset_mode=mode, **task) for _ in range(2))
    with closing(one), closing(other):
        one.reset(seed=4)
        actions = actions_of(one, lanes, 20)
        for number in range(5 if mode == "NextStep" else 4):
            one.step(actions[number])
        for which in ([1, 2], [2]):
            one.step_async(actions[5][which], which)
            one.step_wait(which)
        for lane, state in enumerate(one.call_each("get_state", [()] * lanes)):
            copied = {name: np.array(value) for name, value in state.items()}
            (seen,) = other.call_each("set_state", [(copied,)], [lane])
            assert seen.tobytes() == one.observations()[lane].tobytes()
        for number in range(6, 14):
            for each in (one, other):
                each.call_each("charge", [(0.01 * number, "learning")] * lanes)
                each.step_async(actions[number])
            kept, back = one.step_wait(), other.step_wait()
            assert [part.tobytes() for part in kept[:4]] == [part.tobytes() for part in back[:4]]
            assert_equal(kept[4], back[4])


def assert_equal(ours: Any, theirs: Any) -> None:
    """Infos, in which there may be arrays."""
    assert type(ours) is type(theirs)
    if isinstance(ours, dict):
        assert list(ours) == list(theirs)
        ours, theirs = list(ours.values()), list(theirs.values())
    if isinstance(ours, list):
        for our, other in zip(ours, theirs, strict=True):
            assert_equal(our, other)
    else:
        np.testing.assert_array_equal(ours, theirs)


def test_the_machines_time_of_a_batch_is_shared_by_the_lanes_that_flew(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a clock that goes on by a second whenever it is looked at, of two lanes and then of three."""
    seconds = count(0)
    clock = SimpleNamespace(now_ns=lambda: next(seconds) * 1_000_000_000)
    monkeypatch.setattr("uavaccel.envs.kernel_batch.MonotonicClock", lambda: clock)
    with closing(KernelBatch(ObstacleLane, 5, observation="state", report_host_times=True)) as batch:
        batch.reset(seed=0)
        for lanes in ([0, 3], [1, 2, 4]):
            batch.step_async([2] * len(lanes), lanes)
            infos = batch.step_wait(lanes)[4]
            spent_s = [info["host_phase_s"].pop("simulation") for info in infos]
            assert spent_s == pytest.approx([1.0 / len(lanes)] * len(lanes))
            assert all(set(info["host_phase_s"].values()) == {0.0} for info in infos)


def test_ages_are_those_at_the_collision_which_leaves_nothing_to_process() -> None:
    """ADSC in front of a post: pictures at 330 and 660 ms of a second, in levels of 20 ms, and one that is missing."""
    lane = {"obstacles": [{"x_m": 1.0, "y_m": 0.0, "half_side_m": 0.4}]}
    still: dict[str, Any] = {"quantiles": [0, 1], "issue_us": [0, 0], "timer_us": [0, 0]}
    still |= {"request_us": {"call": [0, 0]}, "reply_us": {"call": [0, 0]}}
    task: dict[str, Any] = {"command": "adsc", "timing": "virtual", "image_processing_s": 0.05, "latency": still}
    with closing(KernelBatch(ObstacleLane, 1, lane=lane, knows=["frame_age"], **task)) as batch:
        batch.reset(seed=0)
        seen, _, over, _, infos = batch.step([2])
        assert (over.tolist(), infos["collision"].tolist()) == ([True], ["obstacle_00"])
        bands = seen[0, -1].reshape(3, 12, 64)
        assert [np.unique(band).tolist() for band in bands] == [[128 + 33], [128 + 17], [128]]
