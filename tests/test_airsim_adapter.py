"""ADSC and TCSC fly through the names and meanings of AirSim's own client."""

import numpy as np
import pytest

from tests.airsim_client import MultirotorClient, RPCError
from tests.serving import running_server
from uavaccel.commands import COMMANDS, MissionClient, tcsc
from uavaccel.commands.airsim_adapter import AirSimAdapter
from uavaccel.kinematics import VelocityGoal
from uavaccel.wire.session import open_session

pytestmark = pytest.mark.wall_clock

CLOCK_SPEED = 20.0
EAST = VelocityGoal((0.0, 1.0, 0.0))
NORTH_AT_HEIGHT = VelocityGoal((1.0, 0.0, 0.0), height_m=-10.5, yaw=0.5, yaw_is_rate=False)


def flying(client: MultirotorClient, clock_speed: float) -> AirSimAdapter:
    """Connected, paused, with API control, in the settled hover: what an AirSim script begins with."""
    client.confirmConnection()
    client.simPause(True)
    client.reset()
    client.enableApiControl(True)
    client.armDisarm(True)
    return AirSimAdapter(client, clock_speed)


def test_tcsc_flies_as_through_our_own_client() -> None:
    with open_session("lockstep", "native", "blocks") as session:
        own = session.start_game(CLOCK_SPEED, np.random.SeedSequence(0))
        expected = [list(tcsc(own, goal, 1.0, 0.25)) for goal in (NORTH_AT_HEIGHT, EAST)]
    with running_server(CLOCK_SPEED) as server, MultirotorClient(port=server.address[1]) as client:
        adapter: MissionClient = flying(client, CLOCK_SPEED)
        t_start = adapter.kinematics().time_ns
        flown = [list(tcsc(adapter, goal, 1.0, 0.25)) for goal in (NORTH_AT_HEIGHT, EAST)]
    for states, ours in zip(flown, expected, strict=True):
        assert [state.time_ns - t_start for state in states] == [state.time_ns for state in ours]
        assert [state.position_m for state in states] == [state.position_m for state in ours]
        assert [state.orientation_wxyz for state in states] == [state.orientation_wxyz for state in ours]


def test_tcsc_reaches_its_end_where_continue_for_is_a_wall_timer() -> None:
    with running_server(CLOCK_SPEED, "airsim") as server, MultirotorClient(port=server.address[1]) as client:
        adapter = flying(client, CLOCK_SPEED)
        t_start = adapter.kinematics().time_ns
        states = list(tcsc(adapter, EAST, 1.0, 0.5))
        assert client.simIsPause()
    assert len(states) == 2
    assert states[-1].time_ns - t_start >= 1_000_000_000


def test_adsc_samples_and_joins() -> None:
    with running_server(CLOCK_SPEED) as server, MultirotorClient(port=server.address[1]) as client:
        adapter = flying(client, CLOCK_SPEED)
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
    with running_server() as server, MultirotorClient(port=server.address[1]) as client:
        adapter = AirSimAdapter(client, 1.0, vehicle_name="Nobody")
        with pytest.raises(RPCError, match="Nobody"):
            adapter.join(adapter.move_async(EAST, 1.0))
