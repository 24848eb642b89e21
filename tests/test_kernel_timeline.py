"""Lanes over arrays keep time as the exact simulator does: its clock, its phases, its ticks."""

from __future__ import annotations

from contextlib import closing
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import ks_2samp

from uavaccel.envs.flight_env import FlightEnv
from uavaccel.envs.hover import Hover
from uavaccel.envs.kernel_batch import KernelBatch
from uavaccel.envs.obstacle_lane import ObstacleLane
from uavaccel.errors import UserError
from uavaccel.kernels import cpu, lane_clocks, timeline
from uavaccel.kernels import latencies as wire
from uavaccel.kernels.fields import COLOUR, COLUMNS, DVS, ROWS
from uavaccel.wire.latency import Latency

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


def pair(kind: type[FlightEnv], task: dict[str, Any], count: int) -> Any:
    return KernelBatch(kind, count, threads=1, **task), [kind(**task) for _ in range(count)]


def actions_of(environment: Any, count: int, commands: int) -> Any:
    random, space = np.random.default_rng(count), environment.single_action_space
    if space.shape:
        return random.uniform((0.2, -0.6, -0.3), (1.0, 0.6, 0.3), (commands, count, 3)).astype(np.float32)
    return np.where(random.random((commands, count)) < 0.6, 2, random.integers(5, size=(commands, count)))


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
        ("adsc", "native", {"latency": FAULTY}),
        ("tcsc", "native", {"latency": FAULTY}),
    ],
)
def test_latencies_are_those_of_the_exact_simulator_in_distribution(
    command: str, profile: str, more: dict[str, Any]
) -> None:
    task = {"timing": "virtual", "command": command, "profile": profile, "clock_speed": 10.0, **more}
    ours, exact = walls_s(Hover, {**task, "max_commands": 100}, 100, 20)
    assert ks_2samp(ours, exact).pvalue > 0.01
    error_s = np.sqrt(ours.var() / ours.size + exact.var() / exact.size)
    assert abs(ours.mean() - exact.mean()) < 3.0 * error_s
    assert len(np.unique(ours)) > 0.9 * len(ours)


def test_no_latency_reaches_native_tcsc() -> None:
    """Whatever is drawn, the games are lockstep's; their clocks are not."""
    faults: dict[str, Any] = {
        "platform": {"faults": {"dropped": 0.05, "stalled": 0.1, "late": 0.2}, "stall_us": 40_000.0}
    }
    still: dict[str, Any] = {"observation": "state", "max_commands": 30}
    drawn = {**still, "timing": "virtual", "latency": faults, "clock_speed": 50.0}
    with (
        closing(KernelBatch(ObstacleLane, 8, **still)) as calm,
        closing(KernelBatch(ObstacleLane, 8, **drawn)) as hurried,
    ):
        assert (calm.reset(seed=1)[0] == hurried.reset(seed=1)[0]).all()
        for actions in actions_of(calm, 8, 40):
            hurried.call_each("charge", [(0.7, "learning")] * 8)
            expected, found = calm.step(actions), hurried.step(actions)
            assert expected[0].tobytes() == found[0].tobytes()
            assert all((a == b).all() for a, b in zip(expected[1:4], found[1:4], strict=True))
        assert (found[4]["wall_s"] != expected[4]["wall_s"]).all()


FRAMES = {"timing": "virtual", "profile": "airsim", "knows": ("last_action", "frame_age")}
SHOWN: list[dict[str, Any]] = [
    {"observation": "colour", "command": "adsc", "clock_speed": 20.0, **FRAMES},
    {"observation": "dvs", "command": "tcsc", "clock_speed": 20.0, "t_sample_s": 0.33, **FRAMES},
    {"observation": "dvs", "command": "adsc", "dvs_rate_hz": 200 / 3, "clock_speed": 9.0, **FRAMES},
    {"observation": "colour", "difficulty": {"light": [0.1, 0.1]}, **FRAMES, "profile": "native"},
]


@pytest.mark.parametrize("task", SHOWN)
def test_pictures_are_of_the_frame_shown_and_cost_what_they_cost(
    task: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Clocks and ages equal the exact simulator's, a guard's second looks too; pictures of other poses would not do."""
    wait_ns, frames = 20_000_000, {"hz": 60.0, "stale_pose": True, "after_continue": True}
    monkeypatch.setattr(Latency, "frame_ns", lambda _: wait_ns)
    latency = constant({"frames": frames} if task["profile"] == "airsim" else None)
    batch, alone = pair(ObstacleLane, {**task, "latency": latency}, 1)
    batch._plan.timing.latencies.tables_us[wire.FRAME] = wait_ns / 1e3
    told = -len(task["knows"])
    with closing(batch), closing(alone[0]) as environment:
        batch.reset(seed=3)
        environment.reset(seed=3)
        for action in actions_of(batch, 1, 8):
            batch.call_each("charge", [(0.02, "inference")])
            environment.charge(0.02, "inference")
            batch.step_async(action)
            observations, *_, infos = batch.step_wait()
            seen, *_, info = environment.step(action[0])
            assert infos[0] == info
            assert (observations[0][told:] == seen[told:]).all()
            assert np.abs(observations[0][:told] - seen[:told].astype(float)).mean() < 0.3


def test_a_clock_that_does_not_fit_is_refused() -> None:
    with pytest.raises(UserError, match=r"simulator = kernels: clock_speed = 1\.23456789 has more digits"):
        KernelBatch(Hover, 1, clock_speed=1.23456789)


@pytest.mark.parametrize(
    ("kind", "levels", "last", "brightness", "suspect"),
    [
        (DVS, (18, -1, -1), np.nan, 18.0, False),  # the first one has nothing to differ from
        (DVS, (18, -1, -1), 16.0, 18.0, True),  # by an eighth
        (DVS, (18, -1, -1), 17.0, 18.0, False),
        (DVS, (9, -1, -1), np.nan, 9.0, True),  # too dark
        (DVS, (10, -1, -1), np.nan, 10.0, False),
        (COLOUR, (100, 0, 0), 29.0, 29.9, False),
        (COLOUR, (0, 100, 0), 50.0, 58.7, True),
        (COLOUR, (0, 0, 100), 11.0, 11.4, False),
        (COLOUR, (10, 20, 30), 18.0, 18.15, False),
        (COLOUR, (30, 20, 10), 18.0, 21.85, True),
    ],
)
def test_the_guard_weighs_colours_and_remembers_the_last_pictures_brightness(
    kind: int, levels: tuple[int, int, int], last: float, brightness: float, suspect: bool
) -> None:
    """On both devices alike, by 0.299 of red, 0.587 of green and 0.114 of blue; of one lane alone."""
    sums = np.array([[0, 0, 0], [level * ROWS * COLUMNS if level >= 0 else -1 for level in levels]])
    channels: Any = np.maximum(levels, 0)[:, None, None] * np.ones((1, COLUMNS, ROWS), int)
    timing: Any = SimpleNamespace(rules=np.zeros(timeline.RULES, np.int64))
    on_cpu, on_gpu = timeline.clocks(2, 1), timeline.clocks(2, 1)
    for clocks in (on_cpu, on_gpu):
        clocks.brightness[1] = last
    assert not lane_clocks.guard.py_func(1, sums, timing, on_gpu)
    np.testing.assert_array_equal(on_gpu.brightness, [0.0, last])
    timing.rules[timeline.GUARDED] = 1
    assert lane_clocks.guard.py_func(1, sums, timing, on_gpu) == suspect
    bright = cpu.brightness_in_lane.py_func(kind, SimpleNamespace(channels=channels))
    assert timeline.is_suspect.py_func(1, bright, on_cpu) == suspect
    for clocks in (on_cpu, on_gpu):
        np.testing.assert_allclose(clocks.brightness, [0.0, brightness])
