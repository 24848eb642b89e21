"""Our client on a connection, and sessions: what a game is started with, and that nothing of it reaches the next."""

from __future__ import annotations

import math
import random
import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.flying import pose
from tests.mutated import GOOD
from tests.simulating import NORTH, always, start
from uavaccel.errors import UserError
from uavaccel.kinematics import VelocityGoal
from uavaccel.wire import rpc
from uavaccel.wire.latency import QUANTILES, LatencyConfig
from uavaccel.wire.session import Client, VirtualSession, open_session
from uavaccel.wire.transport import VirtualTransport

MS = 1_000_000


class LoggingTransport(VirtualTransport):
    """A virtual transport that notes what is sent: method, parameters, blocking, coalesced."""

    def __init__(self, *inner: Any) -> None:
        super().__init__(*inner)
        self.sent: list[tuple[Any, ...]] = []

    def send(self, method: str, params: Sequence[Any], blocking: bool, coalesced: bool = False) -> Any:
        self.sent.append((method, tuple(params), blocking, coalesced))
        return super().send(method, params, blocking, coalesced)

    def methods(self) -> list[str]:
        """What was sent since the last look."""
        methods = [method for method, *_ in self.sent]
        self.sent.clear()
        return methods


def new_client(clock_speed: float = 1.0) -> tuple[Client, LoggingTransport]:
    client = start(clock_speed, transport=LoggingTransport)
    assert isinstance(client.transport, LoggingTransport)
    client.transport.sent.clear()
    return client, client.transport


# --- the known state ----------------------------------------------------------------------------------------


def test_two_clients_of_a_connection_know_the_same() -> None:
    """Each believes to be alone; after the second flew, the first must not go on telling where it left off."""
    first, transport = new_client()
    second = Client(transport)
    start = first.continue_for(2 * MS)
    second.move_async(NORTH, 1.0)
    end = second.continue_for(1000 * MS)
    assert end.position_m[0] > start.position_m[0] + 0.1
    assert first.kinematics() == second.kinematics() == end
    second.run()
    second.transport.clock.sleep_until(second.now_ns() + 500 * MS)
    assert first.kinematics().time_ns == end.time_ns + 500 * MS


def test_a_known_state_saves_messages() -> None:
    client, transport = new_client()
    state = client.continue_for(100 * MS)
    transport.sent.clear()
    assert client.kinematics() == state
    client.move_async(NORTH, 1.0)
    assert client.kinematics() == state, "a command acts from the next tick"
    assert client.collision() is None
    client.trace(False)
    assert client.kinematics() == state
    assert [(method, coalesced) for method, _, _, coalesced in transport.sent] == [
        ("moveByVelocity", True),
        ("uavaccelCollision", False),
        ("uavaccelTrace", False),
    ]


@pytest.mark.parametrize("call", [
    ("simPause", False),
    ("simPause", True),
    ("reset",),
    ("uavaccelStartGame", 1.0),
    ("simContinueForTime", 0.1),
    ("uavaccelContinueFor", 2 * MS),
    ("simSetVehiclePose", pose(-5.0, -5.0, -5.0), True),
])  # fmt: skip
def test_what_may_change_the_state_makes_it_unknown(call: tuple[Any, ...]) -> None:
    client, transport = new_client()
    client.continue_for(100 * MS)
    client.call(*call)
    transport.sent.clear()
    state = client.kinematics()
    assert transport.methods() == ["uavaccelState"]
    assert state == transport._api.simulation.kinematics()
    client.continue_for(2 * MS)
    with pytest.raises(rpc.RpcError):
        client.call("uavaccelNobodyKnows")  # it may be one of a server that is newer than its client
    assert transport.known.state is None


# --- what is sent -------------------------------------------------------------------------------------------


def test_goals_become_airsims_arguments() -> None:
    client, transport = new_client()
    client.move_async(VelocityGoal((1.0, 2.0, 3.0), None, 0.25, True), 0.5)
    client.move_async(VelocityGoal((1.0, 2.0, 3.0), -7.0, -0.5, False), 2.0)
    yaws = [{"is_rate": True, "yaw_or_rate": math.degrees(0.25)}, {"is_rate": False, "yaw_or_rate": math.degrees(-0.5)}]
    assert transport.sent == [
        ("moveByVelocity", (1.0, 2.0, 3.0, 0.5, 0, yaws[0], "", True), False, False),
        ("moveByVelocityZ", (1.0, 2.0, -7.0, 2.0, 0, yaws[1], "", True), False, False),
    ]


def test_the_client_expects_its_answers_when_they_are_due() -> None:
    """It polls around that moment, on the machine's clock; simulated time passes at ClockSpeed."""
    client, _ = new_client(clock_speed=20.0)
    client.run()
    now_ns = client.now_ns()
    assert client.move_async(NORTH, 1.0).expected_ns == now_ns + 50 * MS
    assert client.clock_speed == 20.0


def test_a_refusal_that_nobody_joins_comes_with_the_next_answer() -> None:
    """Once."""
    client, _ = new_client()
    client.move_async(NORTH, 0.0015)
    with pytest.raises(rpc.RpcError, match=r"0\.0015"):
        client.continue_for(2 * MS)
    assert client.continue_for(2 * MS).time_ns == 4 * MS


def test_a_recording_arrives_as_it_was_made() -> None:
    client, transport = new_client()
    client.move_async(NORTH, 0.5)
    client.continue_for(500 * MS)
    transport._api.simulation.world.recorder.record["dropped"] = 3
    found, made = client.recording(), transport._api.simulation.recording()
    np.testing.assert_array_equal(found.samples, made.samples)
    np.testing.assert_array_equal(found.commands, [[0, 250]])
    assert (found.tick_ns, found.dropped, found.commands_dropped) == (made.tick_ns, 3, 0)
    assert len(found.samples) == 11


def test_a_trace_is_told_once_and_only_while_switched_on() -> None:
    client, _ = new_client()
    client.continue_for(2 * MS)
    assert client.trace(True) == []
    client.continue_for(2 * MS)
    events = client.trace(False)
    assert [event for event, _, _ in events] == ["handle uavaccelContinueFor", "run", "pause", "handle uavaccelTrace"]
    assert [(wall_ns, time_ns) for _, wall_ns, time_ns in events] == [*[(2 * MS, 2 * MS)] * 2, *[(4 * MS, 4 * MS)] * 2]
    client.continue_for(2 * MS)
    assert client.trace(False) == []


# --- sessions ---------------------------------------------------------------------------------------------------------


SLOW = LatencyConfig(request_us={"call": always(1000.0)}, reply_us={"call": always(500.0)})
DRAWN = LatencyConfig(request_us={"call": tuple(100.0 * (1 + n) for n in range(len(QUANTILES)))})


def ping_ns(client: Client) -> int:
    start_ns = client.now_ns()
    client.call("ping")
    return client.now_ns() - start_ns


def test_only_virtual_has_latency() -> None:
    for timing, expected_ns in (("virtual", 1_500_000), ("lockstep", 0)):
        with open_session(timing, latency=SLOW) as session:
            assert isinstance(session, VirtualSession)
            assert ping_ns(session.start_game(1.0)) == expected_ns


def test_a_seed_is_a_games_latencies_and_wall_time_begins_anew() -> None:
    seeds = [np.random.SeedSequence(0), np.random.SeedSequence(1), np.random.SeedSequence(1), None]
    with VirtualSession("blocks", "native", DRAWN) as session:
        games = []
        for seed in seeds:
            client = session.start_game(5.0, seed)
            games.append((client.now_ns(), *[ping_ns(client) for _ in range(3)]))
    assert games[1] == games[2]
    assert games[0] == games[3], "without a seed it is 0"
    assert games[0] != games[1]
    assert len(set(games[0])) == 4


def test_a_game_has_its_height_speed_and_connection() -> None:
    with VirtualSession("blocks", "native") as session:
        client = session.start_game(5.0, height_m=-3.0)
        assert client.clock_speed == client.speed()["clock_speed"] == 5.0
        state = client.kinematics()
        assert (state.time_ns, state.position_m) == (0, (0.0, 0.0, -3.0))
        client.move_async(VelocityGoal((1.0, 0.0, 0.0)), 1.0)
        client.continue_for(100 * MS)
        assert client.now_ns() == 20 * MS
        again = session.start_game(1.0)
        assert len(again.recording().commands) == 0
        assert again.kinematics().position_m == (0.0, 0.0, -10.0)


@pytest.mark.parametrize("seed", range(4))
def test_a_game_is_the_same_whatever_was_called_before_it(seed: int) -> None:
    """But for what changes the world or its settings, which stays."""
    stays = re.compile("Wind|Gains|Add|Spawn|Segmentation|Object|Images|uavaccelStartGame")
    calls = {name: params for name, params in GOOD.items() if not stays.search(name)}
    calls |= {name: [False, ""] for name in ("enableApiControl", "armDisarm")}
    calls |= {name: [] for name in ("startRecording", "stopRecording", "reset")}
    client, choose, games = start(), random.Random(seed), []
    for chosen in ([], choose.choices(sorted(calls), k=20)):
        for name in chosen:
            client.transport.send(name, calls[name], blocking=False)
            client.continue_for(20 * MS)
        client.move_async(NORTH, 0.0015)
        begun, begun_ns = client.start_game(5.0), client.now_ns()
        client.continue_for(20 * MS)
        client.move_async(NORTH, 0.3)
        states = [client.continue_for(120 * MS) for _ in range(3)]
        told = [client.call(name, "") for name in ("simGetCollisionInfo", "isApiControlEnabled", "getMultirotorState")]
        told[2] = told[2]["rc_data"]
        flown = [replace(state, time_ns=state.time_ns - begun.time_ns) for state in (begun, *states)]
        recording = client.recording()
        kept = [recording.samples.tolist(), recording.commands.tolist(), recording.dropped, client.call("isRecording")]
        games.append([flown, told, kept, client.collision(), client.speed(), client.now_ns() - begun_ns])
    assert games[1] == games[0], chosen


def test_a_lane_is_laid_out_before_the_game() -> None:
    """Its wind blows: the vehicle in a hover is carried along. Each game has its own lane, 0 too."""
    lane = {"obstacles": [{"x_m": 5.0, "y_m": 0.0, "radius_m": 0.5}], "wind_m_s": [0.0, 4.0, 0.0]}
    with VirtualSession("lane", "native") as session:
        calm = session.start_game(1.0, height_m=-2.0, lane={"obstacles": []}).continue_for(1000 * MS)
        windy = session.start_game(1.0, height_m=-2.0, lane=lane).continue_for(1000 * MS)
        games = (session.start_game(1.0, lane=each) for each in (1, 0, {"seed": 0}, 1))
        first, *others = [client.call("simGetObjectPose", "obstacle_00") for client in games]
    assert abs(calm.position_m[1]) < 1e-3
    assert windy.position_m[1] > 0.01
    assert [each == first for each in others] == [False, False, True]
    assert others[0] == others[1]


def test_a_flight_goes_on_in_another_scenery() -> None:
    with VirtualSession("lane", "native") as session:
        ends = []
        for scenery in ("plain", "forest"):
            client = session.start_game(1.0, height_m=-2.0, lane={"seed": 3})
            client.move_async(NORTH, 1.0)
            client.continue_for(500 * MS)
            client.set_lane({"seed": 3, "difficulty": {"scenery": scenery}})
            ends.append(client.continue_for(500 * MS))
    assert ends[1] == replace(ends[0], time_ns=ends[1].time_ns)


def test_a_clock_speed_is_a_number() -> None:
    with open_session("lockstep") as session, pytest.raises(UserError, match=r"^clock_speed must be a finite"):
        session.start_game("2")  # type: ignore[arg-type]
