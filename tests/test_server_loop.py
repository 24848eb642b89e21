"""The server's loop turn by turn on a clock that the test moves: when it wakes, what it has flown, what it answers."""

from __future__ import annotations

import contextlib
import select
import selectors
import socket
from collections.abc import Iterator
from typing import Any

import msgpack
import pytest

from tests.simulating import simulate
from uavaccel.clock import MonotonicClock, VirtualClock
from uavaccel.errors import UserError
from uavaccel.sim.deferred_reply import DeferredReply
from uavaccel.sim.profile import AIRSIM, NATIVE
from uavaccel.wire import rpc
from uavaccel.wire.api import Api
from uavaccel.wire.clients import IDLE_LIMIT_NS, Answer, Connection
from uavaccel.wire.server import TURN_NS, Server
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
    server.clock = server.clients.clock = clock  # type: ignore[assignment]
    yield server, clock
    server.close()


def connected(server: Server) -> tuple[Connection, socket.socket]:
    """A connection of the server's, and its client's end."""
    client = socket.create_connection(server.address)
    server.clients._listener.setblocking(True)
    server.clients.accept()
    [connection] = server.clients.connected
    return connection, client


def take_in(server: Server, connection: Connection) -> None:
    """Let the server read what a client has sent, once that has come: a busy kernel takes a moment."""
    assert select.select([connection.socket], [], [], 60)[0]
    server._serve_socket(connection, selectors.EVENT_READ)


def read(server: Server, connection: Connection) -> None:
    """Let it read that, and answer what it has read."""
    take_in(server, connection)
    server._serve_turns()


def silent(client: socket.socket) -> bool:
    """Whether nothing has been sent to it that it has not read."""
    return not select.select([client], [], [], 0)[0]


def replies(client: socket.socket) -> list[Any]:
    """What the server has sent in one turn, once that has come: messages [1, id, error, result]."""
    unpacker = msgpack.Unpacker()
    assert select.select([client], [], [], 60)[0]
    client.setblocking(False)
    try:
        while data := client.recv(1 << 16):
            unpacker.feed(data)
    except BlockingIOError:
        pass
    return list(unpacker)


# --- when it wakes ------------------------------------------------------------------------------------------


def test_it_never_stands_still_for_long(stepped: tuple[Server, SteppedClock]) -> None:
    """Paused or not it wakes within 5 ms, which `airsim` makes good, and while it flies about every 30 ticks."""
    server, clock = stepped
    simulation = server.api.simulation
    simulation.pause(0)
    clock.charge(7 * MS)
    assert 0 < server._wake_ns(simulation) - clock.now_ns() <= AIRSIM.catch_up_wall_ns
    simulation.run(clock.now_ns())
    assert 0 < server._wake_ns(simulation) - clock.now_ns() <= AIRSIM.catch_up_wall_ns
    simulation.set_clock_speed(100.0, clock.now_ns())
    assert server._wake_ns(simulation) - clock.now_ns() == 30 * NATIVE.tick_ns // 100


def test_it_is_awake_before_something_ends_and_after_a_message(stepped: tuple[Server, SteppedClock]) -> None:
    server, clock = stepped
    simulation = server.api.simulation
    simulation.continue_for(20 * MS, 0)  # ends at 2 ms
    assert server._wake_ns(simulation) == 1 * MS
    connection, client = connected(server)
    with client:
        client.sendall(rpc.pack_request(1, "ping", []))
        clock.charge(MS // 2)
        read(server, connection)
        assert server._wake_ns(simulation) == clock.now_ns(), "the next one may come at once"
        clock.charge(MS // 4)
        assert server._wake_ns(simulation) == 1 * MS


def test_what_ends_soon_is_flown_up_to_without_looking_at_sockets(stepped: tuple[Server, SteppedClock]) -> None:
    server, clock = stepped
    simulation = server.api.simulation
    reply = simulation.continue_for(20 * MS, 0)
    clock.charge(1 * MS)
    server._wait_for_end(simulation)
    assert simulation.world.tick == 0, "there is time to look at sockets"
    clock.charge(940_000)
    clock.step_ns = 1_000
    server._wait_for_end(simulation)
    assert simulation.world.tick == 9
    assert reply.due_wall_ns is None
    assert clock.now_ns() >= 2 * MS


# --- what it answers ----------------------------------------------------------------------------------------


def test_a_message_sees_what_is_due_when_it_is_handled(stepped: tuple[Server, SteppedClock]) -> None:
    server, clock = stepped
    connection, client = connected(server)
    with client:
        start_ns = server.api.simulation.time_ns
        clock.charge(1_050_000)
        client.sendall(rpc.pack_request(7, "uavaccelState", []))
        read(server, connection)
        assert silent(client), "all answers of a turn go together"
        server._flush()
        [[kind, message_id, error, state]] = replies(client)
    assert (kind, message_id, error) == (rpc.RESPONSE, 7, None)
    assert state[0] - start_ns == 1_050_000 // 200_000 * 2 * MS


def test_a_deferred_reply_leaves_when_it_is_due_and_the_last_answer_first(stepped: tuple[Server, SteppedClock]) -> None:
    """Where a command and its continue-for end together, the client waits for the latter."""
    server, clock = stepped
    simulation = server.api.simulation
    simulation.pause(0)
    connection, client = connected(server)
    with client:
        requests: list[Any] = [(1, *MOVE), (2, "uavaccelContinueFor", [100 * MS]), (3, "ping", [])]
        client.sendall(b"".join(rpc.pack_request(*request) for request in requests))
        read(server, connection)
        server._flush()
        assert replies(client) == [[rpc.RESPONSE, 3, None, True]]
        clock.charge(10 * MS - 1)
        simulation.advance_to(clock.now_ns())
        server._flush()
        assert silent(client)
        clock.charge(1)
        simulation.advance_to(clock.now_ns())
        server._flush()
        assert [(message_id, error) for _, message_id, error, _ in replies(client)] == [(2, None), (1, None)]


def test_one_that_is_over_at_once_and_an_error_are_answered_in_their_turn(stepped: tuple[Server, SteppedClock]) -> None:
    server, _ = stepped
    connection, client = connected(server)
    with client:
        client.sendall(rpc.pack_request(1, "uavaccelContinueFor", [0]) + rpc.pack_request(2, "fly", []))
        read(server, connection)
        server._flush()
        second, first = replies(client)
    assert first[1:3] == [1, None]
    assert len(first[3]) == 20
    assert second[1:] == [2, "rpclib: server could not find function 'fly' with argument count 0.", None]


def test_a_notification_gets_no_answer(stepped: tuple[Server, SteppedClock]) -> None:
    server, _ = stepped
    server.api.simulation.pause(0)
    connection, client = connected(server)
    with client:
        for method in ("simPause", "fly"):
            client.sendall(msgpack.packb([rpc.NOTIFY, method, [False]]))
        client.sendall(rpc.pack_request(1, "ping", []))
        read(server, connection)
        server._flush()
        assert replies(client) == [[rpc.RESPONSE, 1, None, True]]
    assert not server.api.simulation.paused, "it was heeded"


def test_what_the_socket_does_not_take_follows_when_it_does(stepped: tuple[Server, SteppedClock]) -> None:
    server, _ = stepped
    text = "x" * (1 << 20)
    server.api.methods["ping"].handler = lambda: text
    connection, client = connected(server)
    received = b""
    with client:
        client.sendall(rpc.pack_request(1, "ping", []) * 8)
        read(server, connection)
        server._flush()
        assert connection.unsent, "the buffers of both ends hold less"
        assert server.clients._selector.get_key(connection.socket).events & selectors.EVENT_WRITE
        client.settimeout(60)
        while connection.unsent:
            received += client.recv(1 << 20)
            server._send(connection)
        assert not server.clients._selector.get_key(connection.socket).events & selectors.EVENT_WRITE
        while len(received) < 8 * len(rpc.pack_response(1, None, text)):
            received += client.recv(1 << 20)
    assert received == rpc.pack_response(1, None, text) * 8


def test_each_turn_reads_flies_and_answers() -> None:
    """`serve` on the machine's clock, ended by what is called after every turn."""
    simulation = simulate(10.0, wall_ns=MonotonicClock().now_ns())
    simulation.reset(MonotonicClock().now_ns())
    server = Server(Api(simulation, render=False), port=0)
    ticks: list[int] = []
    with socket.create_connection(server.address) as client:
        client.sendall(rpc.pack_request(1, "ping", []))

        def count() -> None:
            ticks.append(simulation.world.tick)
            if len(ticks) == 150:
                server.stop()

        server.serve(count)
        assert replies(client) == [[rpc.RESPONSE, 1, None, True]]
        assert client.recv(1) == b"", "it hung up when it ended"
    assert ticks[-1] > ticks[100], "no message has come for long, and it flies on"


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


@pytest.fixture
def clients() -> Iterator[contextlib.ExitStack]:
    """Closes their sockets."""
    with contextlib.ExitStack() as stack:
        yield stack


def joined(server: Server, clients: contextlib.ExitStack) -> tuple[Connection | None, socket.socket]:
    """One more connection, None if it was turned away."""
    before = set(server.clients.connected)
    client = clients.enter_context(socket.create_connection(server.address))
    server.clients._listener.setblocking(True)
    server.clients.accept()
    return next(iter(server.clients.connected - before), None), client


def test_a_client_that_floods_has_its_turn_and_the_others_theirs(
    stepped: tuple[Server, SteppedClock], clients: contextlib.ExitStack
) -> None:
    server, clock = stepped
    clock.step_ns = TURN_NS // 8  # every look at the clock
    (flooding, flood), (other, client) = joined(server, clients), joined(server, clients)
    assert flooding is not None
    assert other is not None
    flood.sendall(b"".join(rpc.pack_request(number, "ping", []) for number in range(60)))
    read(server, flooding)
    server._flush()
    answered = [[reply[1] for reply in replies(flood)]]
    assert server.clients._selector.get_map().get(flooding.socket) is None, "it is not read before its turn"
    client.sendall(rpc.pack_request(7, "ping", []))
    take_in(server, other)
    server._serve_turns()
    server._flush()
    assert [reply[1] for reply in replies(client)] == [7], "who has had less comes first"
    answered.append([reply[1] for reply in replies(flood)])
    while server._queue:
        server._serve_turns()
        server._flush()
        answered.append([reply[1] for reply in replies(flood)])
    assert all(0 < len(turn) < 20 for turn in answered)
    assert sorted(number for turn in answered for number in turn) == list(range(60))
    assert [min(turn) for turn in answered] == sorted(min(turn) for turn in answered)
    assert server.clients._selector.get_key(flooding.socket).events == selectors.EVENT_READ


def test_silent_clients_make_room_and_a_line_says_so(
    stepped: tuple[Server, SteppedClock], clients: contextlib.ExitStack, monkeypatch: pytest.MonkeyPatch
) -> None:
    server, clock = stepped
    said: list[str] = []
    monkeypatch.setattr(server.api.notices, "say", said.append)
    monkeypatch.setattr("uavaccel.wire.clients.MAX_CONNECTIONS", 3)
    (waiting, pilot), (silent, _), (speaking, speaker) = (
        joined(server, clients),
        joined(server, clients),
        joined(server, clients),
    )
    assert None not in (waiting, silent, speaking)
    pilot.sendall(rpc.pack_request(1, "moveByVelocity", [1.0, 0.0, 0.0, 1e6, 0, MOVE[1][5]]))
    read(server, waiting)  # type: ignore[arg-type]
    assert joined(server, clients)[0] is None, "nobody has been silent for long"
    clock.charge(IDLE_LIMIT_NS + 1)
    speaker.sendall(PING)
    read(server, speaking)  # type: ignore[arg-type]
    newcomer, _ = joined(server, clients)
    assert server.clients.connected == {waiting, speaking, newcomer}, "who waits for an answer is not silent"
    assert [line.partition("; ")[0] for line in said] == ["warning: 3 clients are connected"] * 2
    assert "turned away" in said[0]
    assert "make room" in said[1]


def test_an_answer_that_cannot_be_packed_costs_the_caller_its_call(
    stepped: tuple[Server, SteppedClock], clients: contextlib.ExitStack
) -> None:
    server, _ = stepped
    connection, client = joined(server, clients)
    assert connection is not None
    late = DeferredReply()
    late.encode = lambda value: value.missing
    for number, result in enumerate((1 << 80, object(), late, True)):
        server._answers.append(Answer(connection, number, None, result))
    server._flush()
    told = {message[1]: (message[2], message[3]) for message in replies(client)}
    assert told[3] == (None, True)
    assert all("cannot be packed" in told[number][0] for number in range(3))


@pytest.mark.opengl
def test_many_images_of_one_call_take_turns_with_others(clients: contextlib.ExitStack) -> None:
    server, clock = Server(Api(simulate(10.0)), port=0), SteppedClock()
    clients.callback(server.close)
    server.clock = server.clients.clock = clock  # type: ignore[assignment]
    clock.step_ns = TURN_NS
    (drawing, painter), (other, client) = joined(server, clients), joined(server, clients)
    assert drawing is not None
    assert other is not None
    painter.sendall(rpc.pack_request(1, "simGetImages", [[{}] * 6]) + rpc.pack_request(2, "ping", []))
    read(server, drawing)
    client.sendall(rpc.pack_request(7, "ping", []))
    read(server, other)
    server._serve_turns()
    server._flush()
    assert [reply[1] for reply in replies(client)] == [7]
    turns = 2
    while server._queue:
        server._serve_turns()
        turns += 1
    assert turns >= 6
    server._flush()
    told = {reply[1]: reply[3] for reply in replies(painter)}
    assert len(told[1]) == 6
    assert told[2] is True
