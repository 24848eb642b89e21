"""Servers that die or hang under a `wall` run: noticed, started again, the game flown again, its row flagged."""

from __future__ import annotations

import io
import math
import os
import select
import signal
import socket
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from tests.processes import state_of
from tests.running import configured
from uavaccel.clock import VirtualClock
from uavaccel.errors import UserError
from uavaccel.processes.lifetime import start_python
from uavaccel.suites.dp1 import Dp1, Game
from uavaccel.suites.runner import MOST_RESTARTS, run_suite, start_run
from uavaccel.suites.suite import GameResult
from uavaccel.units import NS_PER_S
from uavaccel.wire import rpc, transport
from uavaccel.wire.rpc import ServerGoneError
from uavaccel.wire.session import WallSession
from uavaccel.wire.transport import SILENCE_POLL_NS, STALL_NS, SocketTransport, WatchedServer

pytestmark = pytest.mark.wall_clock

CORES = os.sched_getaffinity(0)  # before any session
SMALL = ("reference_games=1", "command=[tcsc]", "t_move_s=[0.1]", "rounds=[1]", "games=2", "clock_speed=[50]")


@pytest.fixture
def servers(monkeypatch: pytest.MonkeyPatch) -> list[WatchedServer]:
    """Every server that is started from now on."""
    started: list[WatchedServer] = []
    start = WatchedServer.__init__

    def noted(self: WatchedServer, options: dict[str, Any]) -> None:
        started.append(self)
        start(self, options)

    monkeypatch.setattr(WatchedServer, "__init__", noted)
    return started


@pytest.mark.slow
def test_a_stopped_server_is_noticed_and_does_not_outlive_its_session() -> None:
    with WallSession("blocks", "native") as session:
        client = session.start_game(10.0)
        stop(session.server.pid)
        client.transport.known.state = None
        with pytest.raises(ServerGoneError, match="did not answer"):
            client.kinematics()
    assert session.server.returncode == -signal.SIGKILL


def test_a_server_that_is_stopped_while_it_starts_is_noticed_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Not only after the time that a slow disk may take."""

    def start(*arguments: str, **options: Any) -> Any:
        process = start_python("-c", "import time; time.sleep(600)", **options)
        stop(process.pid)
        return process

    monkeypatch.setattr(transport, "start_python", start)
    monkeypatch.setattr(select, "select", lambda *_: ([], [], []))  # whatever a look takes
    monkeypatch.setattr(transport, "START_S", math.inf)
    with pytest.raises(ServerGoneError, match="did not answer"):
        WatchedServer({})


def test_a_server_that_ends_before_it_listens_is_told_by_its_status(monkeypatch: pytest.MonkeyPatch) -> None:
    """Though it has closed its output before it is gone."""
    program = "import os, time; os.close(1); time.sleep(0.05); os._exit(3)"
    monkeypatch.setattr(transport, "start_python", lambda *_, **how: start_python("-c", program, **how))
    with pytest.raises(ServerGoneError, match=r"ended with status 3 before it listened$"):
        WatchedServer({})


@pytest.mark.wall_clock
def test_a_scene_that_a_server_refuses_is_told_in_its_words() -> None:
    with pytest.raises(UserError, match=r"^scene = moon: is unknown; known: blocks"):
        WatchedServer({"scene": "moon", "profile": "native", "core": None})


@pytest.mark.parametrize(("computes", "patient_s"), [(True, 60), (False, 2)])
def test_a_silent_server_is_given_longer_while_it_computes(
    monkeypatch: pytest.MonkeyPatch, computes: bool, patient_s: int
) -> None:
    """For up to a minute, as of a first picture on a loaded machine; of one that does nothing 3 s are enough."""
    clock, cpu_s, killed = VirtualClock(), [0.0], list[bool]()
    process = SimpleNamespace(
        pid=0, poll=lambda: None, kill=lambda: killed.append(True), stdout=io.BytesIO(b'{"port": 7}')
    )
    monkeypatch.setattr(transport, "start_python", lambda *_, **__: process)
    monkeypatch.setattr(transport, "MonotonicClock", lambda: clock)
    monkeypatch.setattr("uavaccel.processes.stalls.cpu_time_s", lambda _: cpu_s[0])
    monkeypatch.setattr(select, "select", lambda *_: ([True], [], []))
    server = WatchedServer({})
    for _ in range(patient_s):
        clock.charge(NS_PER_S)
        cpu_s[0] += computes
        server.check()
    clock.charge(NS_PER_S)
    cpu_s[0] += computes
    with pytest.raises(ServerGoneError, match=rf"did not answer for {patient_s + 1}\.0 s"):
        server.check()
    assert killed == [True]


def test_a_long_command_is_no_silence_of_a_dead_server(monkeypatch: pytest.MonkeyPatch) -> None:
    """One of 2.5 s: at 1 s the server is asked whether it is there, and says so; its answer comes when it is due."""
    clock, asked = VirtualClock(), list[int]()
    monkeypatch.setattr(transport, "MonotonicClock", lambda: clock)
    server: Any = SimpleNamespace(answered=lambda: asked.append(clock.now_ns()), check=lambda: asked.append(-1))
    with socket.create_server(("127.0.0.1", 0)) as listener:
        server.port = listener.getsockname()[1]
        client: Any = SocketTransport(server)
        peer, _ = listener.accept()
        command = client.send("moveByVelocity", (), blocking=False)
        command.channel, command.expected_ns = "continue_for", 2_500_000_000

        def answer(number: int) -> None:
            peer.sendall(rpc.pack_response(number, None, True))
            client._receive()

        for number in (2, 3):
            clock.charge(SILENCE_POLL_NS)
            client._look()
            clock.charge(STALL_NS)
            answer(number)
        clock.sleep_until(2_500_000_000)
        answer(1)
        assert (command.done, client.stalled_ns) == (True, 0)
        assert asked == [SILENCE_POLL_NS, 2 * SILENCE_POLL_NS + STALL_NS]
        late, other = [client.send("uavaccelState", (), blocking=True) for _ in range(2)]
        clock.charge(2 * STALL_NS)
        answer(4)
        answer(5)
        assert (late.done, other.done, client.stalled_ns) == (True, True, 2 * STALL_NS), "no time is counted twice"
        for method, given in (("simPause", (False,)), ("uavaccelState", ())):
            client.send(method, given, blocking=True)
            clock.charge(STALL_NS)
        peer.sendall(rpc.pack_response(6, None, True) + rpc.pack_response(7, None, True))
        client._receive()
        assert client.stalled_ns == 4 * STALL_NS, "of answers that arrive together the first was due for longest"
        client._look()
        clock.charge(2 * STALL_NS)
        answer(8)
        assert client.stalled_ns == 6 * STALL_NS, "nor did it answer while nothing else was due"
        client._look()
        client._look()
        assert asked[3:] == [clock.now_ns(), -1], "it did not answer the ping: is its process there?"
        client.close()
        peer.close()


def test_a_short_stop_is_seen_and_counted_once() -> None:
    """The simulation loses nothing then, and says nothing: only the client knows."""
    with WallSession("blocks", "native") as session:
        assert os.sched_getaffinity(0) | os.sched_getaffinity(session.server.pid) == CORES
        client = session.start_game(50.0)
        sent = client.transport
        stop(session.server.pid)
        call = sent.send("simPause", (True,), blocking=True)
        asked_ns = sent.clock.now_ns()
        assert not sent.wait(call, asked_ns + 150_000_000)
        os.kill(session.server.pid, signal.SIGCONT)
        sent.wait(call)
        assert 150_000_000 <= sent.stalled_ns <= sent.clock.now_ns() - call.sent_ns
        sent.stalled_ns = 10**18
        assert session.start_game(50.0).transport.stalled_ns < 10**18, "a game counts its own"
        assert client.speed()["lost_wall_ns"] == 0
    assert os.sched_getaffinity(0) == CORES, "its own core is left to others again"


def stop(pid: int) -> None:
    """On return it does stand."""
    os.kill(pid, signal.SIGSTOP)
    while state_of(pid) != "T":
        pass


class Squares(Dp1):
    """Without the flights and messages of the paper's figures, for which servers start too."""

    def cases(self, config: Any) -> Iterator[Game]:
        return (case for case in super().cases(config) if case.role != "figure2")

    def finish(self, config: Any, run: Any) -> None:
        pass


def test_a_game_whose_server_was_killed_is_flown_again_and_flagged(
    tmp_path: Path, servers: list[WatchedServer]
) -> None:
    suite, config = Squares(), configured("dp1", *SMALL, timing="wall")
    run = start_run(suite, config, tmp_path / "run", {})
    killed: list[str] = []

    def kill_once(case: Any, row: Any) -> None:
        if row["timing"] == "wall" and not killed:
            killed.append(case.id)
            os.kill(servers[-1].pid, signal.SIGKILL)

    run_suite(suite, config, run, on_game=kill_once)
    cases = [case.id for case in suite.cases(config)]
    assert [row["case"] for row in run.rows()] == cases
    again = [row for row in run.rows() if "restarts" in row]
    assert [row["case"] for row in again] == [cases[cases.index(killed[0]) + 1]]
    assert again[0]["restarts"] == 1
    assert again[0]["disturbed"] is True
    assert sum(cell.get("disturbed_games", 0) for cell in suite.report(run).summary["cells"]) >= 1
    assert all(server.returncode is not None for server in servers)


def test_a_server_that_always_dies_ends_the_run_with_a_line(tmp_path: Path) -> None:
    class Dying(Dp1):
        attempts = 0

        def fly(self, config: Any, case: Any, opened: Any) -> GameResult:
            self.attempts += 1
            raise ServerGoneError("the server's process ended with status -9")

    suite, config = Dying(), configured("dp1", *SMALL, timing="lockstep")
    run = start_run(suite, config, tmp_path / "run", {})
    with pytest.raises(UserError, match=r"ended with status -9, 4 times; go on with --resume"):
        run_suite(suite, config, run)
    assert suite.attempts == MOST_RESTARTS + 1
    assert run.rows() == []
