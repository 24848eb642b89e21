"""A server's answers and their order; bad bytes and bad clients cost themselves their own connection alone."""

import contextlib
import random
import socket
import struct
import tracemalloc
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import msgpack
import pytest

from tests.flying import STRAIGHT
from tests.mutated import changed_bytes, mutated_calls, send
from tests.serving import client_of, running_server
from tests.simulating import simulate
from uavaccel.airsim import MultirotorClient, RpcError
from uavaccel.errors import UserError
from uavaccel.sim.simulation import DeferredReply
from uavaccel.wire import rpc
from uavaccel.wire.api import Api
from uavaccel.wire.server import Server

pytestmark = pytest.mark.wall_clock

PING = rpc.pack_request(1, "ping", [])
PONG = rpc.pack_response(1, None, True)


@pytest.fixture(scope="module")
def running() -> Iterator[Server]:
    with running_server(clock_speed=20.0) as running:
        yield running


@pytest.fixture
def witness(running: Server) -> Iterator[MultirotorClient]:
    """Another client, that must not notice anything."""
    with client_of(running.address[1]) as client:
        client.reset()
        client.simPause(False)
        client.enableApiControl(True)
        yield client
        wait_for_time(client, 0.01)
        assert client.ping()


def time_s(client: MultirotorClient) -> float:
    return float(client.getMultirotorState().timestamp) / 1e9


def wait_for_time(client: MultirotorClient, simulated_s: float) -> None:
    """Until simulated time has gone on, which it does by itself."""
    start_s = time_s(client)
    while time_s(client) < start_s + simulated_s:
        pass


@contextlib.contextmanager
def stranger(running: Server) -> Iterator[socket.socket]:
    """A bare connection."""
    with socket.create_connection(running.address, timeout=60) as connection:
        yield connection


def receive(connection: socket.socket, size: int) -> bytes:
    """So many bytes, or fewer where the server closes the connection."""
    data = b""
    with contextlib.suppress(ConnectionResetError):
        while len(data) < size and (more := connection.recv(size - len(data))):
            data += more
    return data


def send_for_ever(connection: socket.socket, data: bytes) -> None:
    while True:
        connection.sendall(data)


def answers(connection: socket.socket, requests: list[tuple[int, str, list[Any]]]) -> list[Any]:
    """Send requests in one packet, and return as many messages in the order in which they come."""
    connection.sendall(b"".join(rpc.pack_request(*request) for request in requests))
    unpacker, got = msgpack.Unpacker(), list[Any]()
    while len(got) < len(requests):
        unpacker.feed(connection.recv(1 << 16))
        got += unpacker
    return got


# --- answers ------------------------------------------------------------------------------------------------------


def test_a_deferred_answer_comes_when_due_and_the_last_one_first(running: Server, witness: MultirotorClient) -> None:
    """Where a command and its continue-for end together, the client waits for the latter."""
    witness.simPause(True)
    start_s, second_ns = time_s(witness), 1_000_000_000
    move = [1.0, 0.0, 0.0, 1.0, 0, STRAIGHT, ""]
    with stranger(running) as connection:
        requests: list[Any] = [(1, "moveByVelocity", move), (2, "uavaccelContinueFor", [second_ns]), (3, "ping", [])]
        got = answers(connection, requests)
    assert [message[:3] for message in got] == [[1, number, None] for number in (3, 2, 1)]
    assert time_s(witness) - start_s == pytest.approx(1.0)
    witness.simPause(False)


def test_errors_and_what_is_over_at_once_are_answered_in_turn(running: Server, witness: MultirotorClient) -> None:
    with stranger(running) as connection:
        first, second, third = answers(connection, [(7, "uavaccelContinueFor", [0]), (8, "fly", []), (9, "ping", [])])
    assert (first[:3], len(first[3])) == ([1, 7, None], 20)
    assert second[1:] == [8, "rpclib: server could not find function 'fly' with argument count 0.", None]
    assert third == [1, 9, None, True]
    witness.simPause(False)


def test_clients_of_airsims_time_send_bytes_as_text(running: Server, witness: MultirotorClient) -> None:
    """With msgpack 0.5, byte by byte: a request of four, a name, a list of text; and its answer."""
    with stranger(running) as connection:
        connection.sendall(b"\x94\x00\x07\xb3isApiControlEnabled\x91\xa0")
        assert receive(connection, 5) == b"\x94\x01\x07\xc0\xc3"
        connection.sendall(b"\x94\x00\x08\xb3simListSceneObjects\x91\xa2\xff\xfe")
        assert receive(connection, 5) == b"\x94\x01\x08\xc0\x90"


def test_a_notification_is_heeded_and_gets_no_answer(running: Server, witness: MultirotorClient) -> None:
    with stranger(running) as connection:
        for method in ("simPause", "fly"):
            connection.sendall(msgpack.packb([2, method, [True]]))
        assert answers(connection, [(1, "ping", [])]) == [[1, 1, None, True]]
    assert witness.simIsPause()
    witness.simPause(False)


def test_an_answer_that_cannot_be_packed_is_an_error(
    running: Server, witness: MultirotorClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    late = DeferredReply()
    late.encode = lambda value: value.missing
    late.resolve(None, 0)
    results = iter((1 << 80, object(), late, True))
    with monkeypatch.context() as patch, stranger(running) as connection:
        patch.setitem(running.api.handlers, "ping", lambda: next(results))
        *failed, good = answers(connection, [(number, "ping", []) for number in range(4)])
    assert good == [1, 3, None, True]
    assert [number for _, number, text, _ in failed if "cannot be packed" in text] == [0, 1, 2]


def test_a_client_that_floods_leaves_others_their_turns(running: Server, witness: MultirotorClient) -> None:
    with stranger(running) as connection:
        flood = rpc.pack_request(1, "getMultirotorState", [""])
        connection.settimeout(0)
        with contextlib.suppress(BlockingIOError):
            send_for_ever(connection, flood)
        for _ in range(5):
            assert witness.ping()


@pytest.mark.parametrize("port", [-1, 65536])
def test_a_port_that_there_cannot_be_is_one_line(port: int) -> None:
    with pytest.raises(UserError, match=f"port must be 0 to 65535, not {port}"):
        Server(Api(simulate()), port=port)


def test_a_port_in_use_is_one_line() -> None:
    server = Server(Api(simulate()), port=0)
    with pytest.raises(UserError, match=r"^cannot listen on .*: Address already in use; choose another with --port$"):
        Server(Api(simulate()), port=server.address[1])
    server.close()


# --- bad bytes, bad clients ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("data", [
    b"GET / HTTP/1.1\r\n\r\n",
    b"\xc1",
    b"\x91" * 100_000,
    # the lengths of these are believed until they are too much
    *(head + b"\xff" * 4 + b"\x05" * (2 << 20) for head in (b"\xdb", b"\xdd", b"\xdf")),
    b"\x90",
    msgpack.packb([5, 1, "ping", []]),
    msgpack.packb([0, "id", "ping", []]),
    msgpack.packb([0, 1, 7, []]),
    msgpack.packb([0, 1, "ping", {}]),
    msgpack.packb([1, 1, None, None]),
], ids=lambda data: repr(data[:12]))  # fmt: skip
def test_what_is_no_request_is_hung_up_on(running: Server, witness: MultirotorClient, data: bytes) -> None:
    with stranger(running) as connection:
        with contextlib.suppress(ConnectionError):  # it may be closed before all is sent
            connection.sendall(data)
        assert receive(connection, 1) == b""


def test_half_a_message_waits_for_its_other_half(running: Server, witness: MultirotorClient) -> None:
    with stranger(running) as connection:
        connection.sendall(PING[:3])
        wait_for_time(witness, 0.5)
        connection.sendall(PING[3:])
        assert receive(connection, len(PONG)) == PONG


@pytest.mark.parametrize("polite", [True, False])
def test_half_a_message_and_a_client_gone(running: Server, witness: MultirotorClient, polite: bool) -> None:
    with stranger(running) as connection:
        connection.sendall(PING[:3])
        if not polite:  # close with a reset instead of an end
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))


def test_a_pause_releases_another_clients_continue_for(running: Server, witness: MultirotorClient) -> None:
    witness.simPause(True)
    with client_of(running.address[1]) as other:
        pending = other.client.call_async("simContinueForTime", 1e6)
        wait_for_time(witness, 0.1)
        assert not witness.simIsPause()
        witness.simPause(True)
        pending.join()
    witness.simPause(False)


def test_the_command_of_a_client_that_vanished_runs_on(running: Server, witness: MultirotorClient) -> None:
    with client_of(running.address[1]) as other:
        other.moveByVelocityAsync(1, 0, 0, 2.0)
        other.ping()
    wait_for_time(witness, 2.5)
    assert witness.getMultirotorState().kinematics_estimated.position.x_val > 0.5


def test_the_continue_for_of_a_client_that_vanished_ends(running: Server, witness: MultirotorClient) -> None:
    witness.simPause(True)
    start_s = time_s(witness)
    with client_of(running.address[1]) as other:
        other.client.call_async("uavaccelContinueFor", 1_000_000_000)
        other.ping()
    while not witness.simIsPause():
        pass
    assert time_s(witness) - start_s == pytest.approx(1.0)
    witness.simPause(False)


def test_a_client_that_does_not_read_is_asked_for_nothing_more(
    running: Server, witness: MultirotorClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What it asked for waits, and comes when it reads."""
    made = 0
    reply = bytes(1 << 20)

    def recording() -> bytes:
        nonlocal made
        made += 1
        return reply

    monkeypatch.setitem(running.api.handlers, "uavaccelRecording", recording)
    with stranger(running) as connection:
        connection.sendall(rpc.pack_request(1, "uavaccelRecording", []) * 40)
        while made == 0:
            assert witness.ping()
        wait_for_time(witness, 2.0)
        assert made < 20
        whole = rpc.pack_response(1, None, reply) * 40
        assert receive(connection, len(whole)) == whole
    assert made == 40


def test_what_is_too_long_is_refused_in_words(
    running: Server, witness: MultirotorClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    with stranger(running) as connection:
        with contextlib.suppress(ConnectionError):
            connection.sendall(rpc.pack_request(41, "ping", ["x" * (rpc.MAX_MESSAGE_BYTES + 1)]))
        refusal = rpc.pack_response(41, "a message may have 1 MiB, not more", None)
        assert receive(connection, len(refusal) + 1) == refusal
    with client_of(running.address[1]) as client:
        with monkeypatch.context() as patch:
            patch.setitem(running.api.handlers, "ping", lambda: bytes(rpc.MAX_ANSWER_BYTES))
            with pytest.raises(RpcError, match="the answer has 64 MiB, more than 64: ask for less"):
                client.ping()
        assert client.ping()


def nested(count: int) -> bytes:
    """The beginning of a request with so many arrays for parameters; unpacked each takes a hundred bytes."""
    return rpc.pack_request(9, "ping", [])[:-1] + b"\xdd\x7f\xff\xff\xff" + b"\x90" * count


def test_half_a_message_costs_what_was_sent(running: Server, witness: MultirotorClient) -> None:
    """Unpacked as they come, the arrays of one such message had been 60 MiB."""
    tracemalloc.start()
    try:
        with contextlib.ExitStack() as stack:
            for _ in range(4):
                stack.enter_context(stranger(running)).sendall(nested(1000 << 10))
            wait_for_time(witness, 2.0)
            assert tracemalloc.get_traced_memory()[1] < 32 << 20
    finally:
        tracemalloc.stop()


def test_a_server_survives_messages_that_are_nearly_requests(tmp_path: Path) -> None:
    """By the million: `python -m tests.soak.mutated_messages`."""
    choose = random.Random(0)
    with running_server(render=False, recordings=tmp_path) as server:
        calls = mutated_calls(server.api, choose)
        strange = [changed_bytes(next(calls), choose) for _ in range(100)]
        send(server.address[1], list(islice(calls, 300)), strange)
        with client_of(server.address[1]) as client:
            assert client.ping()


def test_one_too_many_is_refused_and_a_line_says_so() -> None:
    said: list[str] = []
    with running_server(say=said.append) as running, contextlib.ExitStack() as stack:
        others = [stack.enter_context(client_of(running.address[1])) for _ in range(15)]
        with client_of(running.address[1]) as last, stranger(running) as refused:
            assert all(client.ping() for client in (*others, last))
            assert receive(refused, 1) == b""
            assert said == ["warning: 16 clients are connected, as many as may be; one was refused"]
        for _ in range(20):  # each in the place of the one that has just left
            with client_of(running.address[1]) as successor:
                assert successor.ping()


def test_small_messages_leave_and_are_acknowledged_at_once(
    running: Server, witness: MultirotorClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else a continue-for behind an un-joined command waits 40 ms for the acknowledgement of the command."""
    acknowledged: list[tuple[str, int]] = []
    acknowledge = rpc.set_quick_ack

    def set_quick_ack(connection: socket.socket) -> None:
        acknowledge(connection)
        acknowledged.append(connection.getsockname())

    monkeypatch.setattr(rpc, "set_quick_ack", set_quick_ack)
    assert all(witness.ping() for _ in range(5))
    assert acknowledged.count(running.address) == 5
    assert all(each.socket.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY) for each in running.connected)
    with stranger(running) as connection:
        rpc.set_no_delay(connection)
        for option in ("TCP_NODELAY", "TCP_QUICKACK"):
            assert connection.getsockopt(socket.IPPROTO_TCP, getattr(socket, option))
