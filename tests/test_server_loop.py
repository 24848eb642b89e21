"""The server's loop turn by turn on a clock that the test moves: when it wakes, what it has flown, what it answers."""

from __future__ import annotations

import select
import selectors
import socket
from collections.abc import Generator, Iterator
from typing import Any

import msgpack
import pytest

from tests.simulating import simulate
from uavaccel.clock import MonotonicClock, VirtualClock, wait_for_sockets
from uavaccel.errors import UserError
from uavaccel.sim.flight.pilot import DeferredReply
from uavaccel.sim.profile import AIRSIM, NATIVE
from uavaccel.wire import rpc
from uavaccel.wire.api import Api
from uavaccel.wire.server import FINAL_NS, TURNS_NS, Server
from uavaccel.wire.server_process import ready_simulation
from uavaccel.wire.transport import SocketTransport

MS = 1_000_000
PING = rpc.pack_request(1, "ping", [])
MOVE = ("moveByVelocity", [1.0, 0.0, 0.0, 0.1, 0, {"is_rate": True, "yaw_or_rate": 0.0}, ""])


class SteppedClock(VirtualClock):
    """Goes on by itself by `step_ns` whenever it is looked at."""

    step_ns = 0

    def now_ns(self) -> int:
        self.charge(self.step_ns)
        return super().now_ns()


@pytest.fixture
def stepped() -> Iterator[tuple[Server, SteppedClock]]:
    """A server at wall time 0, its simulation running at 10x: a tick takes 200 us."""
    server, clock = Server(Api(simulate(10.0), render=False), port=0), SteppedClock()
    server.clock = clock  # type: ignore[assignment]
    yield server, clock
    server.close()


def play(server: Server, turns: Iterator[None]) -> None:
    """Serve; after each wake-up `turns` goes on, and at its end the server is stopped."""

    def go_on() -> None:
        for _ in turns:
            return
        server.stop()

    server.serve(go_on)


def received(client: socket.socket) -> list[Any]:
    """The messages [1, id, error, result] that have come since it was asked last; none while nothing has."""
    unpacker = msgpack.Unpacker()
    while select.select([client], [], [], 0)[0] and (data := client.recv(1 << 16)):
        unpacker.feed(data)
    return list(unpacker)


def replies(client: socket.socket, count: int) -> Generator[None, None, list[Any]]:
    """Let the server take turns until so many messages have come; returns them."""
    got: list[Any] = []
    while len(got) < count:
        yield
        got += received(client)
    return got


def silent_turns(client: socket.socket) -> Iterator[None]:
    for _ in range(5):
        yield
        assert received(client) == []


# --- when it wakes ------------------------------------------------------------------------------------------


def test_it_sleeps_until_little_is_left_to_fly_or_something_ends(
    stepped: tuple[Server, SteppedClock], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Paused or not it wakes within 5 ms, which `airsim` makes good, and while it flies about every 30 ticks."""
    server, clock = stepped
    simulation, until_ns = server.api.simulation, [0]

    def wait(selector: selectors.DefaultSelector, deadline_ns: int) -> Any:
        until_ns[0] = deadline_ns
        return wait_for_sockets(selector, 0)

    monkeypatch.setattr("uavaccel.wire.server.wait_for_sockets", wait)

    def turns() -> Iterator[None]:
        clock.charge(7 * MS)
        for change in (simulation.pause, simulation.run):
            change(clock.now_ns())
            yield
            assert 0 < until_ns[0] - clock.now_ns() <= AIRSIM.catch_up_wall_ns
        simulation.set_clock_speed(100.0, clock.now_ns())
        yield
        assert until_ns[0] - clock.now_ns() == 30 * NATIVE.tick_ns // 100
        simulation.continue_for(200 * MS, clock.now_ns())
        yield
        assert until_ns[0] == clock.now_ns() + 600_000
        clock.charge(500_000)
        yield  # in which it flies
        yield
        assert until_ns[0] == clock.now_ns() + 500_000, "1 ms before the end"
        with socket.create_connection(server.address) as client:
            client.sendall(PING)
            yield from replies(client, 1)
            yield
            assert until_ns[0] == clock.now_ns(), "the next one may come at once"

    play(server, turns())


def test_what_ends_soon_is_flown_up_to_at_once(stepped: tuple[Server, SteppedClock]) -> None:
    server, clock = stepped
    simulation = server.api.simulation

    def turns() -> Iterator[None]:
        reply = simulation.continue_for(20 * MS, clock.now_ns())
        clock.charge(2 * MS - FINAL_NS)
        yield
        assert simulation.world.tick == 9, "there is time to look at sockets"
        clock.step_ns = 1_000
        yield
        assert simulation.world.tick == 10
        assert reply.due_wall_ns == 2 * MS

    play(server, turns())


# --- what it answers ----------------------------------------------------------------------------------------


def test_a_message_sees_what_is_due_when_it_is_handled(stepped: tuple[Server, SteppedClock]) -> None:
    server, clock = stepped

    def turns() -> Iterator[None]:
        start_ns = server.api.simulation.time_ns
        clock.charge(1_050_000)
        with socket.create_connection(server.address) as client:
            client.sendall(rpc.pack_request(7, "uavaccelState", []))
            [[kind, message_id, error, state]] = yield from replies(client, 1)
        assert (kind, message_id, error) == (rpc.RESPONSE, 7, None)
        assert state[0] - start_ns == 1_050_000 // 200_000 * 2 * MS

    play(server, turns())


def test_a_deferred_reply_leaves_when_it_is_due_and_the_last_answer_first(stepped: tuple[Server, SteppedClock]) -> None:
    """Where a command and its continue-for end together, the client waits for the latter."""
    server, clock = stepped
    server.api.simulation.pause(0)

    def turns() -> Iterator[None]:
        with socket.create_connection(server.address) as client:
            requests: list[Any] = [(1, *MOVE), (2, "uavaccelContinueFor", [100 * MS]), (3, "ping", [])]
            client.sendall(b"".join(rpc.pack_request(*request) for request in requests))
            assert (yield from replies(client, 1)) == [[rpc.RESPONSE, 3, None, True]]
            clock.charge(10 * MS - FINAL_NS)
            yield from silent_turns(client)
            clock.step_ns = 1
            assert [reply[1:3] for reply in (yield from replies(client, 2))] == [[2, None], [1, None]]
            assert clock.now_ns() >= 10 * MS

    play(server, turns())


def test_one_that_is_over_at_once_and_an_error_are_answered_in_their_turn(stepped: tuple[Server, SteppedClock]) -> None:
    server, _ = stepped

    def turns() -> Iterator[None]:
        with socket.create_connection(server.address) as client:
            client.sendall(rpc.pack_request(1, "uavaccelContinueFor", [0]) + rpc.pack_request(2, "fly", []))
            first, second = yield from replies(client, 2)
        assert first[1:3] == [1, None]
        assert len(first[3]) == 20
        assert second[1:] == [2, "rpclib: server could not find function 'fly' with argument count 0.", None]

    play(server, turns())


def test_a_notification_is_heeded_and_gets_no_answer(stepped: tuple[Server, SteppedClock]) -> None:
    server, _ = stepped
    server.api.simulation.pause(0)

    def turns() -> Iterator[None]:
        with socket.create_connection(server.address) as client:
            for method in ("simPause", "fly"):
                client.sendall(msgpack.packb([rpc.NOTIFY, method, [False]]))
            client.sendall(PING)
            assert (yield from replies(client, 1)) == [[rpc.RESPONSE, 1, None, True]]
        assert not server.api.simulation.paused

    play(server, turns())


def test_an_answer_that_cannot_be_packed_costs_the_caller_its_call(stepped: tuple[Server, SteppedClock]) -> None:
    server, _ = stepped
    late = DeferredReply()
    late.encode = lambda value: value.missing
    late.resolve(None, 0)
    results = iter((1 << 80, object(), late, True))
    server.api.methods["ping"].handler = lambda: next(results)

    def turns() -> Iterator[None]:
        with socket.create_connection(server.address) as client:
            client.sendall(b"".join(rpc.pack_request(number, "ping", []) for number in range(4)))
            *failed, good = yield from replies(client, 4)
        assert good == [rpc.RESPONSE, 3, None, True]
        assert [message_id for _, message_id, text, _ in failed if "cannot be packed" in text] == [0, 1, 2]

    play(server, turns())


def test_a_client_that_floods_has_its_turns_and_the_others_theirs(stepped: tuple[Server, SteppedClock]) -> None:
    server, clock = stepped
    clock.step_ns = TURNS_NS // 8  # every look at the clock

    def turns() -> Iterator[None]:
        with socket.create_connection(server.address) as flood, socket.create_connection(server.address) as other:
            flood.sendall(b"".join(rpc.pack_request(number, "ping", []) for number in range(60)))
            answered = yield from replies(flood, 1)
            other.sendall(PING)
            yield from replies(other, 1)
            answered += received(flood)
            assert 1 < len(answered) < 60
            answered += yield from replies(flood, 60 - len(answered))
            assert [reply[1] for reply in answered] == list(range(60))

    play(server, turns())


def test_a_server_process_starts_settled_and_running_on_the_machines_clock() -> None:
    before_ns = MonotonicClock().now_ns()
    simulation = ready_simulation("blocks", AIRSIM, 3.0)
    assert (simulation.world.tick, simulation.paused, float(simulation.clock_speed)) == (0, False, 3.0)
    assert simulation.catch_up_wall_ns == AIRSIM.catch_up_wall_ns
    assert simulation.pacer.wall_due(0) >= before_ns
    assert simulation.kinematics().position_m == (0.0, 0.0, -10.0)
    simulation.world.close()


# --- addresses ----------------------------------------------------------------------------------------------


def test_a_port_in_use_is_one_line(stepped: tuple[Server, SteppedClock]) -> None:
    with pytest.raises(UserError, match=r"^cannot listen on .*: Address already in use; choose another with --port$"):
        Server(Api(simulate()), port=stepped[0].address[1])


@pytest.mark.parametrize("port", [-1, 65536])
def test_a_port_that_there_cannot_be_is_one_line(port: int) -> None:
    with pytest.raises(UserError, match=f"port must be 0 to 65535, not {port}"):
        Server(Api(simulate()), port=port)


def test_no_server_is_one_line() -> None:
    unused = Server(Api(simulate()), port=0)
    unused.close()
    with pytest.raises(UserError, match="start one with `uavaccel serve`"):
        SocketTransport(*unused.address)
