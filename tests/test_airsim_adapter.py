"""ADSC and TCSC fly through the names and meanings of AirSim's own client."""

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.serving import client_of, running_server
from uavaccel.airsim import MultirotorClient, RpcError
from uavaccel.commands import COMMANDS, AirSimAdapter, MissionClient, tcsc
from uavaccel.kinematics import Kinematics, VelocityGoal
from uavaccel.wire.session import open_session

pytestmark = pytest.mark.wall_clock

CLOCK_SPEED = 20.0
EAST = VelocityGoal((0.0, 1.0, 0.0))
NORTH_AT_HEIGHT = VelocityGoal((1.0, 0.0, 0.0), height_m=-10.5, yaw=0.5, yaw_is_rate=False)


def flying(client: MultirotorClient) -> AirSimAdapter:
    """Connected, paused, with API control, in the settled hover: what an AirSim script begins with."""
    client.confirmConnection()
    client.simPause(True)
    client.reset()
    client.enableApiControl(True)
    client.armDisarm(True)
    return AirSimAdapter(client, CLOCK_SPEED)


def test_tcsc_flies_as_through_our_own_client() -> None:
    with open_session("lockstep", "native", "blocks") as session:
        own = session.start_game(CLOCK_SPEED, np.random.SeedSequence(0))
        expected = [list(tcsc(own, goal, 1.0, 0.25)) for goal in (NORTH_AT_HEIGHT, EAST)]
    with running_server(CLOCK_SPEED) as server, client_of(server.address[1]) as client:
        adapter: MissionClient = flying(client)
        t_start = adapter.kinematics().time_ns
        flown = [list(tcsc(adapter, goal, 1.0, 0.25)) for goal in (NORTH_AT_HEIGHT, EAST)]
    for states, ours in zip(flown, expected, strict=True):
        assert [state.time_ns - t_start for state in states] == [state.time_ns for state in ours]
        assert [state.position_m for state in states] == [state.position_m for state in ours]
        assert [state.orientation_wxyz for state in states] == [state.orientation_wxyz for state in ours]


def test_tcsc_reaches_its_end_where_continue_for_is_a_wall_timer() -> None:
    with running_server(CLOCK_SPEED, "airsim") as server, client_of(server.address[1]) as client:
        adapter = flying(client)
        t_start = adapter.kinematics().time_ns
        states = list(tcsc(adapter, EAST, 1.0, 0.5))
        assert client.simIsPause()
    assert len(states) == 2
    assert states[-1].time_ns - t_start >= 1_000_000_000


def test_adsc_samples_and_joins() -> None:
    with running_server(CLOCK_SPEED) as server, client_of(server.address[1]) as client:
        adapter = flying(client)
        t_start = adapter.kinematics().time_ns
        command = COMMANDS["adsc"]
        command.begin(adapter)
        states = list(command.fly(adapter, EAST, 1.0, 0.25))
        assert not client.simIsPause()
    times = [state.time_ns - t_start for state in states]
    assert len(times) == 4
    assert times == sorted(times)
    assert times[-1] >= 1_000_000_000
    assert states[-1].position_m[1] > 0.2


def test_a_refused_command_raises() -> None:
    with running_server() as server, client_of(server.address[1]) as client:
        adapter = AirSimAdapter(client, 1.0, vehicle_name="Nobody")
        with pytest.raises(RpcError, match="Nobody"):
            adapter.join(adapter.move_async(EAST, 1.0))


class FakeAirSim:
    """AirSim's client without AirSim: notes its calls, answers a state of distinct numbers."""

    def __init__(self) -> None:
        self.calls: list[tuple[Any, ...]] = []

    def __getattr__(self, name: str) -> Any:
        def call(*params: Any) -> Any:
            self.calls.append((name, *params))
            return STATE if name == "getMultirotorState" else f"{name}'s future"

        return call


def vector(x: float) -> SimpleNamespace:
    return SimpleNamespace(w_val=x, x_val=x + 1, y_val=x + 2, z_val=x + 3)


STATE = SimpleNamespace(
    timestamp=7.0,
    kinematics_estimated=SimpleNamespace(
        position=vector(10), orientation=vector(20), linear_velocity=vector(30), angular_velocity=vector(40),
        linear_acceleration=vector(50), angular_acceleration=vector(60),
    ),
)  # fmt: skip


def test_every_field_and_unit_of_airsims() -> None:
    fake = FakeAirSim()
    adapter = AirSimAdapter(fake, 4, "Drone1")
    assert adapter.clock_speed == 4.0
    three = {name: (x + 1, x + 2, x + 3) for name, x in zip("pvwab", (10, 30, 40, 50, 60), strict=True)}
    expected = Kinematics(7, three["p"], (20, 21, 22, 23), three["v"], three["w"], three["a"], three["b"])
    assert adapter.kinematics() == expected
    assert adapter.read_sample(expected) is expected
    assert adapter.continue_for(2_000_000_000) == expected
    level = {"is_rate": False, "yaw_or_rate": math.degrees(0.5)}
    assert adapter.move_async(NORTH_AT_HEIGHT, 2.0) == "moveByVelocityZAsync's future"
    adapter.move_async(EAST, 3.0)
    adapter.move_async(replace(EAST, height_m=0.0), 3.0)
    adapter.pause()
    adapter.run()
    assert fake.calls == [
        ("getMultirotorState", "Drone1"),
        ("simContinueForTime", 0.5),  # wall seconds
        ("getMultirotorState", "Drone1"),
        ("moveByVelocityZAsync", 1.0, 0.0, -10.5, 2.0, 0, level, "Drone1"),
        *(
            (f"moveByVelocity{z}Async", 0.0, 1.0, 0.0, 3.0, 0, {"is_rate": True, "yaw_or_rate": 0.0}, "Drone1")
            for z in ("", "Z")
        ),
        ("simPause", True),
        ("simPause", False),
    ]


def test_a_join_waits_for_the_deadline_or_for_the_future() -> None:
    adapter, got = AirSimAdapter(FakeAirSim(), 1.0), []
    future = SimpleNamespace(get=lambda: got.append("waited"))
    deadline_ns = adapter.now_ns() + 2_000_000
    assert adapter.join(future, deadline_ns) is False
    assert adapter.now_ns() >= deadline_ns
    assert not got
    assert adapter.join(future) is True
    assert got == ["waited"]
