"""What the two commands cost, on a simulated wall clock: exact, repeatable, and without end-less waits."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.simulating import start, world_of
from uavaccel.commands import COMMANDS, SQUARE, TWO_FORWARD_ONE_BACK
from uavaccel.kinematics import Vector, VelocityGoal
from uavaccel.sim.profile import AIRSIM, NATIVE
from uavaccel.wire.api import Api
from uavaccel.wire.latency import QUANTILES, LatencyConfig
from uavaccel.wire.rpc import RpcError
from uavaccel.wire.session import Client
from uavaccel.wire.transport import VirtualTransport

NASTY_US = (0.0, 1.0, 5.0, 20.0, 60.0, 150.0, 400.0, 2e3, 1e4, 5e4, 2e5, 1e6)
CHANNELS = ("call", "move", "pause", "continue", "continue_for", "state")
NASTY = LatencyConfig(
    request_us=dict.fromkeys(CHANNELS, NASTY_US),
    reply_us=dict.fromkeys(CHANNELS, NASTY_US),
    issue_us=NASTY_US,
    timer_us=NASTY_US,
)
LOOPBACK_US = (20.0, 22.0, 24.0, 25.0, 27.0, 30.0, 34.0, 40.0, 50.0, 90.0, 200.0, 500.0)
LOOPBACK = LatencyConfig(request_us={"call": LOOPBACK_US}, reply_us={"call": LOOPBACK_US}, issue_us=LOOPBACK_US)

Arrays = dict[str, NDArray[np.float64]]


def fly(
    client: Client,
    command: str,
    path: Sequence[Vector] = SQUARE,
    t_move_s: float = 1.0,
    t_sample_s: float = 1.0,
    t_th_ns: int = 0,
) -> Arrays:
    COMMANDS[command].begin(client)
    for velocity in path:
        for _ in COMMANDS[command].fly(client, VelocityGoal(velocity), t_move_s, t_sample_s, t_th_ns):
            pass
    return client.recording().arrays()


def equal(a: Arrays, b: Arrays) -> bool:
    return a.keys() == b.keys() and all(np.array_equal(a[name], b[name]) for name in a)


def position_rmse_m(a: Arrays, b: Arrays) -> float:
    shorter = min(len(a["time_s"]), len(b["time_s"]))
    errors = a["position_m"][:shorter] - b["position_m"][:shorter]
    return float(np.sqrt((errors**2).sum(axis=1).mean()))


# --- accuracy ---------------------------------------------------------------------------------------------


def test_tcsc_in_native_loses_nothing_at_any_clock_speed() -> None:
    lockstep = fly(start(1.0), "tcsc")
    for seed, clock_speed in enumerate((0.5, 1, 1.5, 10, 62.5, 100)):
        for t_sample_s in (1.0, 0.33):
            assert equal(fly(start(clock_speed, NASTY, seed), "tcsc", t_sample_s=t_sample_s), lockstep), clock_speed


def test_adsc_error_grows_with_clock_speed() -> None:
    lockstep = fly(start(1.0), "tcsc", SQUARE * 8)
    errors_m = [
        np.median([position_rmse_m(fly(start(k, LOOPBACK, seed), "adsc", SQUARE * 8), lockstep) for seed in range(3)])
        for k in (1, 10, 50, 100)
    ]
    assert errors_m == sorted(errors_m)
    assert errors_m[0] < 1e-3
    assert errors_m[-2] > 0.02
    assert errors_m[-1] > 2 * errors_m[-2]


def test_adsc_without_latency_is_lockstep() -> None:
    """The two commands differ in nothing but what latency does to them."""
    lockstep = fly(start(1.0), "tcsc", TWO_FORWARD_ONE_BACK)
    for clock_speed in (0.5, 1.5, 100):
        assert equal(fly(start(clock_speed), "adsc", TWO_FORWARD_ONE_BACK), lockstep)
        assert equal(fly(start(clock_speed), "adsc", TWO_FORWARD_ONE_BACK, t_sample_s=0.33), lockstep)


def test_one_socket_keeps_its_order(monkeypatch: pytest.MonkeyPatch) -> None:
    """A message that took long is not overtaken by the next, which was sent before it had arrived."""
    slow_moves = LatencyConfig(request_us={"call": LOOPBACK_US, "move": NASTY_US}, reply_us={"call": LOOPBACK_US})
    handled: list[tuple[str, int]] = []
    call = Api.call

    def noting(self: Api, method: str, params: Sequence[Any], wall_ns: int) -> Any:
        handled.append((method, wall_ns))
        return call(self, method, params, wall_ns)

    monkeypatch.setattr(Api, "call", noting)
    client = start(100, slow_moves)
    fly(client, "tcsc", SQUARE * 4)
    walls_ns = [wall_ns for _, wall_ns in handled]
    assert walls_ns == sorted(walls_ns)
    moves = [index for index, (method, _) in enumerate(handled) if method == "moveByVelocity"]
    assert len(moves) == 16
    assert all(handled[index + 1][0] == "uavaccelContinueFor" for index in moves)


def test_lockstep_takes_simulated_time_over_clock_speed() -> None:
    for command in COMMANDS:
        client = start(50)
        fly(client, command)
        assert client.now_ns() == 4 * 10**9 // 50
        assert client.speed()["real_time_factor"] == 50


# --- repeatability ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("command", ["adsc", "tcsc"])
def test_the_same_seed_gives_the_same_bytes(command: str) -> None:
    def flown(seed: int) -> tuple[bytes, int, Any]:
        client = start(50, NASTY, seed)
        arrays = fly(client, command, t_sample_s=0.5)
        return b"".join(array.tobytes() for array in arrays.values()), client.now_ns(), client.speed()

    first = flown(1)
    flown(2)  # what happens in between leaves no trace
    assert flown(1) == first
    assert flown(2)[1] != first[1]


# --- no end-less waits ------------------------------------------------------------------------------------

MOST_ADVANCES = 2_000


def bound(client: Client) -> Client:
    """Fail, instead of spinning for ever, where a simulated wall clock does not get anywhere."""
    transport = client.transport
    assert isinstance(transport, VirtualTransport)
    simulation = transport._api.simulation
    advance_to, left = simulation.advance_to, MOST_ADVANCES

    def counted(wall_ns: int) -> None:
        nonlocal left
        left -= 1
        assert left > 0, "the clock spins"
        advance_to(wall_ns)

    simulation.advance_to = counted  # type: ignore[method-assign]
    return client


table_us = st.lists(st.floats(0, 2e4), min_size=len(QUANTILES), max_size=len(QUANTILES)).map(sorted)
latencies = st.builds(
    lambda request, reply, issue, timer: LatencyConfig(
        request_us={"call": request}, reply_us={"call": reply}, issue_us=issue, timer_us=timer
    ),
    *[table_us.map(tuple)] * 4,
)
speeds = st.sampled_from([0.1, 0.3333333, 1.5, 62.5, 100]) | st.floats(0.01, 200)


@given(speeds, latencies, st.sampled_from(sorted(COMMANDS)), st.sampled_from([(0.1, 0.1), (0.2, 0.066), (0.01, 0.002)]))
@settings(max_examples=25)
def test_a_virtual_clock_never_spins_for_ever(
    clock_speed: float, latency: LatencyConfig, command: str, times_s: tuple[float, float]
) -> None:
    arrays = fly(bound(start(clock_speed, latency)), command, [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0)], *times_s)
    assert len(arrays["command_end_s"]) == 2
    np.testing.assert_allclose(arrays["command_end_s"] - arrays["command_start_s"], times_s[0], atol=1e-9)


@given(speeds, latencies, st.sampled_from(sorted(COMMANDS)))
@settings(max_examples=25)
def test_nor_does_it_with_airsims_wall_timers(clock_speed: float, latency: LatencyConfig, command: str) -> None:
    """T_th is a tick at the least there: a shorter continue-for may not bring any."""
    client = bound(start(clock_speed, latency, profile=AIRSIM))
    fly(client, command, [(1.0, 0.0, 0.0)], 0.5, 0.1, AIRSIM.tick_ns)


def test_a_failed_flight_ends(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Both commands come back, time goes on, the failure is told."""
    monkeypatch.chdir(tmp_path)  # MuJoCo writes a log
    for command in COMMANDS:
        client = start(100, LOOPBACK)
        fly(client, command, [(1.0, 0.0, 0.0)])
        world_of(NATIVE).data.qpos[0] = np.nan
        arrays = fly(bound(client), command)
        assert "mjWARN_BADQPOS" in str(client.speed()["failure"])
        assert len(arrays["command_end_s"]) == 5


def test_a_join_while_the_clock_stands_is_an_error() -> None:
    client = start(1.0)
    future = client.move_async(VelocityGoal((1.0, 0.0, 0.0)), 1.0)
    assert not client.join(future, client.now_ns() + 10**6)
    assert client.now_ns() == 10**6
    with pytest.raises(RuntimeError, match="moveByVelocity would wait for ever: the simulation is paused"):
        client.join(future)


def test_errors_come_back_to_their_call() -> None:
    client = start(1.0)
    with pytest.raises(RpcError, match="clock_speed must be a finite number above 0"):
        client.call("uavaccelSetClockSpeed", 0)
    refused = client.move_async(VelocityGoal((1.0, 0.0, 0.0)), 0.0333)
    with pytest.raises(RpcError, match="physics step of 2 ms"):
        client.join(refused)
    with pytest.raises(RpcError, match="finite"):
        client.join(client.move_async(VelocityGoal((float("nan"), 0.0, 0.0)), 1.0))
    assert equal(fly(client, "tcsc"), fly(start(1.0), "tcsc"))
