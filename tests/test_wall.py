"""A server in a process of its own on the machine's clock: exact where it must be, honest where it cannot be.

Nothing here asserts how long something takes; speeds are compared with the server's own count of wall time.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from numpy.typing import NDArray

from uavaccel.commands import COMMANDS, SQUARE
from uavaccel.kinematics import VelocityGoal
from uavaccel.sim.profile import NATIVE
from uavaccel.wire import transport
from uavaccel.wire.session import Client, Session, VirtualSession, WallSession

pytestmark = pytest.mark.wall_clock

NORTH = VelocityGoal((1.0, 0.0, 0.0))
SEED = np.random.SeedSequence(0)


@pytest.fixture(scope="module")
def session() -> Iterator[Session]:
    """Its server ends with it, by itself, on however busy a machine."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(transport, "END_S", 60.0)
        with WallSession("blocks", "native") as session:
            yield session
        assert session.server.returncode == 0


def fly(client: Client, command: str, t_move_s: float, rounds: int) -> dict[str, NDArray[np.float64]]:
    COMMANDS[command].begin(client)
    for velocity in SQUARE * rounds:
        for _ in COMMANDS[command].fly(client, VelocityGoal(velocity), t_move_s, t_move_s):
            pass
    return client.recording().arrays()


@pytest.mark.parametrize(("t_move_s", "rounds"), [(0.1, 4), (1.0, 4)])
def test_tcsc_at_100x_equals_lockstep(session: Session, t_move_s: float, rounds: int) -> None:
    with VirtualSession("blocks", "native") as lockstep:
        expected = fly(lockstep.start_game(1.0, SEED), "tcsc", t_move_s, rounds)
    flown = fly(session.start_game(100, SEED), "tcsc", t_move_s, rounds)
    for name, array in expected.items():
        assert np.array_equal(flown[name], array), name


def test_adsc_at_100x_flies_its_commands_with_gaps(session: Session) -> None:
    """Every command lasts T_move to the tick; the time between two is what latency costs."""
    client = session.start_game(100, SEED)
    flown = fly(client, "adsc", 0.2, 2)
    lengths_s = flown["command_end_s"] - flown["command_start_s"]
    np.testing.assert_allclose(lengths_s, 0.2, atol=1e-9)
    gaps_s = flown["command_start_s"][1:] - flown["command_end_s"][:-1]
    assert len(gaps_s) == 7
    assert (gaps_s > 0).all()
    np.testing.assert_allclose(np.diff(flown["time_s"]), 0.05, atol=1e-9)


@pytest.mark.parametrize("clock_speed", [0.5, 1.5])
def test_the_clock_keeps_a_speed_that_is_no_whole_number(session: Session, clock_speed: float) -> None:
    """Simulated time is ClockSpeed times the wall time that the server did not report as lost, to a few ticks."""
    client = session.start_game(clock_speed, SEED)
    client.run()
    before = client.speed()
    client.transport.clock.sleep_until(client.now_ns() + 400_000_000)
    after = client.speed()
    simulated_ns, wall_ns, lost_ns = (
        after[name] - before[name] for name in ("simulated_ns", "wall_ns", "lost_wall_ns")
    )
    assert wall_ns >= 400_000_000
    assert abs(simulated_ns - clock_speed * (wall_ns - lost_ns)) <= 2 * NATIVE.tick_ns
    assert after["clock_speed"] == clock_speed
    assert after["real_time_factor"] <= clock_speed


@pytest.mark.parametrize("duration_ns", [2_000_000, 34_000_000, 330_000_000])
def test_a_continue_for_is_exact_and_never_early(session: Session, duration_ns: int) -> None:
    client = session.start_game(10, SEED)
    start = client.kinematics()
    called_ns = client.now_ns()
    state = client.continue_for(duration_ns)
    assert client.now_ns() - called_ns >= duration_ns // 10
    assert state.time_ns - start.time_ns == duration_ns
    assert client.call("simIsPaused") is True
    assert client.kinematics() == state, "the clock is paused"


def test_a_join_is_never_early_and_a_cancelled_command_answers_false(session: Session) -> None:
    client = session.start_game(20, SEED)
    client.run()
    issued_ns = client.now_ns()
    future = client.move_async(NORTH, 1.0)
    came = client.join(future, issued_ns + 1_000_000)
    assert not came or client.now_ns() - issued_ns >= 50_000_000  # this process may have been held up
    assert client.join(future)
    assert client.now_ns() - issued_ns >= 50_000_000
    assert future.outcome() is True
    cancelled = client.move_async(NORTH, 1000.0)
    client.call("cancelLastTask")
    client.join(cancelled)
    assert cancelled.outcome() is False
