"""Framing, and the two transports to the nanosecond and to the byte: when a message arrives, what a socket is given."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Iterator
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import msgpack
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from tests.simulating import NORTH, always, start, world_of
from uavaccel.commands import COMMANDS
from uavaccel.sim.profile import AIRSIM, NATIVE, Profile
from uavaccel.sim.simulation import Simulation
from uavaccel.wire import rpc
from uavaccel.wire.latency import LatencyConfig
from uavaccel.wire.session import Client
from uavaccel.wire.transport import SocketTransport

US, MS = 1_000, 1_000_000


# Every latency is another number, so that each of them shows in the sums below.
REQUEST_US = {"move": 101, "pause": 203, "pause@10ms": 907, "continue": 307, "continue@10ms": 811,
              "continue_for": 409, "state": 503, "state@10ms": 557, "call": 601}  # fmt: skip
REPLY_US = {"move": 113, "pause": 211, "pause@10ms": 919, "continue": 311, "continue@10ms": 821,
            "continue_for": 419, "continue_for@10ms": 499, "state": 509, "state@10ms": 563, "call": 607,
            "move@10ms": 149}  # fmt: skip
ISSUE_US, TIMER_US = 71, 709
FIXED = LatencyConfig(
    request_us={name: always(value) for name, value in REQUEST_US.items()},
    reply_us={name: always(value) for name, value in REPLY_US.items()},
    issue_us=always(ISSUE_US),
    timer_us=always(TIMER_US),
)


def new_client(clock_speed: float, profile: Profile = NATIVE) -> Client:
    """Its latencies are FIXED, its trace is on."""
    client = start(clock_speed, FIXED, profile=profile)
    client.trace(True)
    return client


def server_events(client: Client, wall0_ns: int) -> list[tuple[str, float]]:
    """The trace so far: event and microseconds after `wall0_ns`."""
    return [(event, (wall_ns - wall0_ns) / US) for event, wall_ns, _ in client.trace(False)[:-1]]


# --- a simulated wall clock ---------------------------------------------------------------------------------


def test_one_adsc_is_charged_with_every_latency_once() -> None:
    """At 10x a tick of 2 ms takes 200 us. The callback of the join is a reply like any other."""
    client = new_client(10.0)
    start_ns, wall0_ns = client.kinematics().time_ns, client.now_ns()
    COMMANDS["adsc"].begin(client)
    assert client.now_ns() - wall0_ns == (307 + 311) * US
    [sample] = COMMANDS["adsc"].fly(client, NORTH, 0.1, 0.1)
    accepted_us = 307 + 311 + 101  # on the 2nd tick after the clock began to run at 307
    end_us = 307 + (2 + 50) * 200  # after 9.988 ms, so that the messages are those of a wait of 10 ms
    paused_us = end_us + 149 + 907
    state_us = paused_us + 919 + 557
    running_us = state_us + 563 + 811
    assert client.now_ns() - wall0_ns == (running_us + 821) * US
    assert sample.time_ns - start_ns == (paused_us - 307) // 200 * 2 * MS
    assert [server_event for server_event in server_events(client, wall0_ns) if server_event[1] > 0] == [
        ("handle simPause", 307),
        ("run", 307),
        ("handle moveByVelocity", accepted_us),
        ("accept", accepted_us),
        ("end", end_us),
        ("handle simPause", paused_us),
        ("pause", paused_us),
        ("handle uavaccelState", state_us),
        ("handle simPause", running_us),
        ("run", running_us),
    ]


def test_two_tcscs_are_charged_with_every_latency_once() -> None:
    """The first asks for the state; the second knows it, and its command is overtaken by nothing."""
    client = new_client(10.0)
    COMMANDS["tcsc"].begin(client)
    wall0_ns, t_start = client.now_ns(), client.transport._api.simulation.time_ns  # type: ignore[attr-defined]
    samples = [sample for _ in range(2) for sample in COMMANDS["tcsc"].fly(client, NORTH, 0.1, 0.1)]
    assert [sample.time_ns - t_start for sample in samples] == [100 * MS, 200 * MS]
    first_us = 503 + 509 + ISSUE_US + 409  # continue-for, from when the command has been issued
    second_us = first_us + 10_000 + 499 + ISSUE_US + 409
    assert client.now_ns() - wall0_ns == (second_us + 10_000 + 499) * US
    assert [server_event for server_event in server_events(client, wall0_ns) if server_event[1] > 0] == [
        ("handle uavaccelState", 503),
        ("handle moveByVelocity", 503 + 509 + 101),
        ("accept", 503 + 509 + 101),
        ("handle uavaccelContinueFor", first_us),
        ("run", first_us),
        ("end", first_us + 10_000),
        ("pause", first_us + 10_000),
        ("handle moveByVelocity", first_us + 10_000 + 499 + 101),
        ("accept", first_us + 10_000 + 499 + 101),
        ("handle uavaccelContinueFor", second_us),
        ("run", second_us),
        ("end", second_us + 10_000),
        ("pause", second_us + 10_000),
    ]


def test_a_deadline_may_fall_before_the_end_or_before_the_callback() -> None:
    client = new_client(10.0)
    client.run()
    future = client.move_async(NORTH, 0.1)
    [_, accepted_ns] = next(event[:2] for event in client.trace(True) if event[0] == "accept")
    earliest_ns = accepted_ns + 49 * 200 * US
    assert not client.join(future, earliest_ns), "the command has not ended"
    assert client.now_ns() == earliest_ns
    end_ns = next(wall_ns for event, wall_ns, _ in _after(client, future) if event == "end")
    assert client.now_ns() == end_ns + 50 * US, "it has ended, but its callback is under way"
    assert client.join(future, end_ns + 149 * US)
    assert client.now_ns() == end_ns + 149 * US
    assert future.outcome() is True
    assert client.join(future), "a second join costs nothing"
    assert client.now_ns() == end_ns + 149 * US


def _after(client: Client, future: Any) -> list[tuple[str, int, int]]:
    """Wait for 50 us more than the command's end; the simulation's events until then."""
    simulation = client.transport._api.simulation  # type: ignore[attr-defined]
    end_ns = simulation.next_event_wall_ns()
    assert not client.join(future, end_ns + 50 * US)
    return list(simulation.trace.events)


def test_a_wall_timer_is_late_by_what_is_drawn() -> None:
    """AirSim's continue-for: 30 ms of wall time and 709 us; at 10x a tick of 3 ms takes 300 us."""
    client = new_client(10.0, AIRSIM)
    t_start, wall0_ns = client.kinematics().time_ns, client.now_ns()
    client.call("simContinueForTime", 0.03)
    end_us = 601 + 30_000 + TIMER_US
    assert client.now_ns() - wall0_ns == (end_us + 607) * US
    assert client.kinematics().time_ns - t_start == (30_000 + TIMER_US) // 300 * 3 * MS
    events = [event for event in client.trace(False) if event[0] in ("timer", "pause")]
    assert [(event, wall_ns - wall0_ns) for event, wall_ns, _ in events] == [
        ("timer", end_us * US),
        ("pause", end_us * US),
    ]


def test_a_wall_timer_ends_on_the_dot_whoever_asks_next() -> None:
    """A message that comes long after it does not let the simulation run until then."""
    client = new_client(10.0, AIRSIM)
    t_start = client.kinematics().time_ns
    client.transport.send("simContinueForTime", (0.03,), blocking=False)
    client.transport.clock.sleep_until(client.now_ns() + 100 * MS)
    assert client.kinematics().time_ns - t_start == (30_000 + TIMER_US) // 300 * 3 * MS


# --- a socket -----------------------------------------------------------------------------------------------


class Peer:
    """The other end of a SocketTransport: reads requests, sends what it is told to."""

    def __init__(self, connection: socket.socket) -> None:
        self.connection = connection
        self._unpacker = msgpack.Unpacker()

    def requests(self) -> list[Any]:
        """What has arrived, without waiting for more."""
        self.connection.setblocking(False)
        with contextlib.suppress(BlockingIOError):
            while data := self.connection.recv(1 << 16):
                self._unpacker.feed(data)
        return list(self._unpacker)

    def answer(self, message_id: int, value: Any, error: str | None = None) -> None:
        self.connection.sendall(rpc.pack_response(message_id, error, value))


@pytest.fixture
def ends() -> Iterator[tuple[SocketTransport, Peer]]:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        server: Any = SimpleNamespace(port=listener.getsockname()[1])  # nobody is silent long enough to be looked at
        transport = SocketTransport(server)
        connection, _ = listener.accept()
        with connection:
            yield transport, Peer(connection)
            transport.close()


def test_a_coalesced_call_travels_with_the_next(ends: tuple[SocketTransport, Peer]) -> None:
    transport, peer = ends
    transport.send("moveByVelocity", (1.0,), blocking=False, coalesced=True)
    assert peer.requests() == []
    transport.send("ping", (), blocking=True)
    assert peer.requests() == [[0, 1, "moveByVelocity", [1.0]], [0, 2, "ping", []]]


@pytest.mark.parametrize("leave", ["wait", "close"])
def test_a_coalesced_call_is_sent_before_its_caller_waits_or_leaves(
    ends: tuple[SocketTransport, Peer], leave: str
) -> None:
    transport, peer = ends
    call = transport.send("ping", (), blocking=False, coalesced=True)
    if leave == "wait":
        peer.answer(1, True)
        assert transport.wait(call)
    else:
        transport.close()
    assert peer.requests() == [[0, 1, "ping", []]]


def test_replies_find_their_calls_in_any_order(ends: tuple[SocketTransport, Peer]) -> None:
    transport, peer = ends
    calls = [transport.send("ping", (), blocking=False) for _ in range(3)]
    ids = [message_id for _, message_id, *_ in peer.requests()]
    peer.answer(99, "nobody's")
    for message_id, value in reversed(list(zip(ids, ("first", "second", "third"), strict=True))):
        peer.answer(message_id, value, "no" if value == "second" else None)
    assert all(transport.wait(call) for call in calls)
    assert (calls[0].outcome(), calls[2].outcome()) == ("first", "third")
    with pytest.raises(rpc.RpcError, match=r"^no$"):
        calls[1].outcome()
    calls[0].answer("", None)
    with pytest.raises(rpc.RpcError):  # without a word
        calls[0].outcome()


@pytest.mark.parametrize("expected_in_ns", [None, 0, 5 * MS, 10**12])
def test_a_deadline_ends_a_wait_and_not_the_call(
    ends: tuple[SocketTransport, Peer], expected_in_ns: int | None
) -> None:
    """Whenever the answer was expected; a deadline in the past only looks."""
    transport, peer = ends
    call = transport.send("ping", (), blocking=False)
    for later_ns in (-1, 3 * MS):
        deadline_ns = transport.clock.now_ns() + later_ns
        if expected_in_ns is not None:
            call.expected_ns = transport.clock.now_ns() + expected_in_ns
        assert not transport.wait(call, deadline_ns)
        assert transport.clock.now_ns() >= deadline_ns
        assert not call.done
    peer.answer(1, "late")
    assert transport.wait(call, transport.clock.now_ns() + 10**12)
    assert call.outcome() == "late"


def test_an_answer_comes_before_the_moment_it_was_expected_at(ends: tuple[SocketTransport, Peer]) -> None:
    transport, peer = ends
    call = transport.send("ping", (), blocking=False)
    call.expected_ns = transport.clock.now_ns() + 10**15
    peer.answer(1, True)
    assert transport.wait(call)


def test_a_server_that_has_gone_is_an_error(ends: tuple[SocketTransport, Peer]) -> None:
    transport, peer = ends
    call = transport.send("ping", (), blocking=True)
    assert len(peer.requests()) == 1  # with nothing unread it ends politely
    peer.connection.close()
    with pytest.raises(ConnectionError, match="the server closed the connection"):
        transport.wait(call, transport.clock.now_ns() + 10**9)


def test_what_a_socket_may_change_is_not_known_any_more(ends: tuple[SocketTransport, Peer]) -> None:
    transport, _ = ends
    state = Simulation(world_of(NATIVE)).kinematics()
    transport.known.state = state
    for method, known in (("uavaccelImage", state), ("uavaccelCollision", state), ("simPause", None)):
        transport.send(method, (), blocking=False)
        assert transport.known.state is known


# --- framing ----------------------------------------------------------------------------------------------------------


scalars = (
    st.none()
    | st.booleans()
    | st.integers(-(1 << 63), (1 << 64) - 1)
    | st.floats(allow_nan=False)
    | st.text()
    | st.binary()
)
values = st.recursive(
    scalars, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4), max_leaves=8
)
message_ids = st.integers(0, (1 << 32) - 1)
requests = st.tuples(message_ids, st.text(), st.lists(values, max_size=4))
places = st.lists(st.integers(min_value=0), max_size=8)


def understood(data: bytes, cuts: list[int]) -> list[rpc.RpcRequest]:
    """What a server takes out of `data`, which arrives cut at these places."""
    framer, found = rpc.Framer(), list[rpc.RpcRequest]()
    for begin, end in pairwise([0, *sorted(cut % (len(data) + 1) for cut in cuts), len(data)]):
        message = framer.next(data[begin:end])
        while message is not None:
            found.append(rpc.unpack_request(message))
            message = framer.next()
    return found


@given(st.lists(requests, max_size=5), places)
def test_requests_survive_any_cutting(calls: list[tuple[int, str, list[Any]]], cuts: list[int]) -> None:
    stream = b"".join(rpc.pack_request(*call) for call in calls)
    assert understood(stream, cuts) == [rpc.RpcRequest(*call) for call in calls]


@given(message_ids, st.none() | st.text(st.characters(exclude_categories=["Cs"])), values)
def test_responses_come_out_as_they_went_in(message_id: int, error: str | None, result: Any) -> None:
    assert msgpack.unpackb(rpc.pack_response(message_id, error, result)) == [1, message_id, error, result]


@given(st.binary(max_size=300), places)
@example(b"GET / HTTP/1.1\r\n\r\n", [])
@example(b"\xc1", [])  # the one byte that msgpack never uses
@example(b"\x91" * 100_000, [])  # nested deeper than any stack
@example(b"\x81\x90\x90", [])  # a list as a key
@example(b"\xd4\xff\x00", [])  # a time stamp of one byte
@example(b"\xdd\xff\xff\xff\xff", [])  # an array of four thousand million
@example(b"\xdf\xff\xff\xff\xff", [])
@example(b"\xdb\xff\xff\xff\xff", [])
@example(b"\xc6\xff\xff\xff\xff", [])
@example(b"\xc9\xff\xff\xff\xff\x00", [])
def test_any_bytes_are_requests_or_a_protocol_error(data: bytes, cuts: list[int]) -> None:
    with contextlib.suppress(rpc.ProtocolError):
        understood(data, cuts)


def test_what_is_no_request_is_refused() -> None:
    for message in (
        *([], [0], [0, 1, "ping"], [0, "1", "ping", []], [0, True, "ping", []], [0, 1, 7, []], [0, 1, b"ping", []]),
        *([0, 1, "ping", {}], [0, 1, "ping", None], [1, 1, None, None], [2, 1, "ping", []], [3, 1, "ping", []]),
        *({"method": "ping"}, 7, [0, 1, "ping", [[None] * (rpc.MAX_ITEMS + 1)]]),
    ):
        with pytest.raises(rpc.ProtocolError):
            understood(msgpack.packb(message), [])


def test_a_notification_has_no_id_and_bytes_of_old_clients_are_text() -> None:
    old = msgpack.packb([2, "ping", [b"\xff\xfe"]], use_bin_type=False)
    assert understood(old, []) == [rpc.RpcRequest(None, "ping", ["\udcff\udcfe"])]
    assert msgpack.unpackb(rpc.pack_response(1, "no function 'p\udcff'", None))[2] == "no function 'p?'"


def test_a_message_is_bounded_and_many_messages_are_no_large_one() -> None:
    def ping(count: int) -> bytes:
        return rpc.pack_request(1, "ping", ["x" * count])

    most = rpc.MAX_MESSAGE_BYTES - len(ping(1 << 16)) + (1 << 16)
    for cuts in ([], [700, 500_000]):
        assert len(understood(ping(most), cuts)) == 1
        with pytest.raises(rpc.ProtocolError, match="a message may have 1 MiB, not more") as refused:
            understood(ping(most + 1), cuts)
        assert refused.value.message_id == 1
    framer, whole = rpc.Framer(), ping(30_000) * 100
    taken = [framer.next(whole[at : at + 4096]) for at in range(0, len(whole), 4096)]
    assert [message for message in taken if message] == [ping(30_000)] * 100
    assert len(understood(ping(30_000) * 50, [])) == 50, "1.5 MB that arrive in one piece"
