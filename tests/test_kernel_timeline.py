"""Lanes over arrays keep time as the exact simulator does: its clock, its phases, its ticks."""

from __future__ import annotations

from contextlib import closing
from itertools import count
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import ks_2samp

from uavaccel.envs.flight_env import FlightEnv
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


def constant(platform: dict[str, Any] | None = None, scale: float = 1.0, factor: float = 1.0) -> dict[str, Any]:
    """A latency model that always draws the same."""
    request = {name: [each * factor] * 2 for name, each in CHANNELS_US.items()}
    reply = {name: [1.7 * factor * each] * 2 for name, each in CHANNELS_US.items()}
    tables = {"quantiles": [0.0, 1.0], "request_us": request, "reply_us": reply, "scale": scale}
    return {**tables, "issue_us": [10.3] * 2, "timer_us": [61.0] * 2, "platform": platform or {}}


def walls_s(kind: type[FlightEnv], task: dict[str, Any], lanes: int, commands: int) -> tuple[Any, Any]:
    """Wall time of each command (n,) of lanes over arrays, and of games alone."""
    batch, environment, action = KernelBatch(kind, lanes, **task), kind(**task), np.zeros(3, np.float32)
    with closing(batch):
        before = np.array(batch.reset(seed=5)[1]["wall_s"])
        spent = []
        for _ in range(commands):
            batch.call_each("charge", [(0.003,)] * lanes)
            infos = batch.step(np.tile(action, (lanes, 1)))[4]
            spent.append(infos["wall_s"] - before)
            before = np.array(infos["wall_s"])
    alone = []
    for game in range(30):
        last = environment.reset(seed=1000 + game)[1]["wall_s"]
        for _ in range(commands):
            environment.charge(0.003)
            now = environment.step(action)[4]["wall_s"]
            alone.append(now - last)
            last = now
    environment.close()
    return np.concatenate(spent), np.array(alone)


FAULTY = {"platform": {"faults": {"dropped": 0.01, "stalled": 0.03, "late": 0.1, "late_us": 7000.0}}}
# At 10x a tick of AirSim's takes 3 ms of wall time here and not 0.3: a timer that ends before it waits for it.
COSTLY = {**constant({"tick_us": 3000.0}), "timer_us": [0.0, 6000.0]}


@pytest.mark.parametrize(
    ("command", "profile", "more"),
    [
        *((command, profile, {}) for command in ("adsc", "tcsc") for profile in ("native", "airsim")),
        ("tcsc", "airsim", {"latency": COSTLY}),
        ("tcsc", "airsim", {"latency": constant({"frames": {"hz": 60.0, "after_continue": True}})}),
        ("adsc", "native", {"latency": FAULTY}),
        ("tcsc", "native", {"latency": FAULTY}),
    ],
)
def test_latencies_are_distributed_as_the_exact_simulators(command: str, profile: str, more: dict[str, Any]) -> None:
    task = {"timing": "virtual", "command": command, "profile": profile, "clock_speed": 10.0, **more}
    ours, exact = walls_s(Hover, {**task, "max_commands": 100}, 100, 20)
    assert ks_2samp(ours, exact).pvalue > 0.01
    error_s = np.sqrt(ours.var() / ours.size + exact.var() / exact.size)
    assert abs(ours.mean() - exact.mean()) < 3.0 * error_s
    assert len(np.unique(ours)) > 0.9 * len(ours)


def test_the_machines_time_is_shared_by_the_lanes_that_flew(monkeypatch: pytest.MonkeyPatch) -> None:
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


def test_ages_are_those_at_the_collision() -> None:
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
