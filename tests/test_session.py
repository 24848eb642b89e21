"""Sessions: what a game is started with in each timing, and that nothing of one game reaches the next."""

from __future__ import annotations

import numpy as np
import pytest

from uavaccel.errors import UserError
from uavaccel.kinematics import VelocityGoal
from uavaccel.wire.client import Client
from uavaccel.wire.latency import QUANTILES, LatencyConfig
from uavaccel.wire.session import VirtualSession, open_session

MS = 1_000_000
SLOW = LatencyConfig(request_us={"call": (1000.0,) * len(QUANTILES)}, reply_us={"call": (500.0,) * len(QUANTILES)})
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
        assert client.transport.known.exclusive
        state = client.kinematics()
        assert (state.time_ns, state.position_m) == (0, (0.0, 0.0, -3.0))
        client.move_async(VelocityGoal((1.0, 0.0, 0.0)), 1.0)
        client.continue_for(100 * MS)
        assert client.now_ns() == 20 * MS
        again = session.start_game(1.0)
        assert len(again.recording().commands) == 0
        assert again.kinematics().position_m == (0.0, 0.0, -10.0)


def test_airsims_timers_are_late_in_virtual() -> None:
    late = LatencyConfig(timer_us=(3000.0,) * len(QUANTILES))
    with VirtualSession("blocks", "airsim", late) as session:
        client = session.start_game(1.0)
        assert client.continue_for(30 * MS).time_ns == 33 * MS


def test_a_lane_is_laid_out_before_the_game() -> None:
    """Its wind blows: the vehicle in a hover is carried along."""
    lane = {"obstacles": [{"x_m": 5.0, "y_m": 0.0, "radius_m": 0.5}], "wind_m_s": [0.0, 4.0, 0.0]}
    with VirtualSession("lane", "native") as session:
        calm = session.start_game(1.0, height_m=-2.0, lane={"obstacles": []}).continue_for(1000 * MS)
        windy = session.start_game(1.0, height_m=-2.0, lane=lane).continue_for(1000 * MS)
    assert abs(calm.position_m[1]) < 1e-3
    assert windy.position_m[1] > 0.01


def test_a_clock_speed_is_a_number() -> None:
    with open_session("lockstep") as session, pytest.raises(UserError, match=r"^clock_speed must be a finite"):
        session.start_game("2")  # type: ignore[arg-type]
