"""Framing: what was packed comes out again however the stream is cut, and no bytes crash the decoder."""

from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import msgpack
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from uavaccel.wire import rpc

scalars = (
    st.none()
    | st.booleans()
    | st.integers(-(1 << 63), (1 << 64) - 1)
    | st.floats(allow_nan=False)
    | st.text()
    | st.binary()
)
values = st.recursive(
    scalars, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4)
)
message_ids = st.integers(0, (1 << 32) - 1)
requests = st.tuples(message_ids, st.text(), st.lists(values, max_size=4))


def pieces(data: bytes, cuts: list[int]) -> Iterator[bytes]:
    """`data`, cut at these places."""
    places = [0, *sorted(cut % (len(data) + 1) for cut in cuts), len(data)]
    return (data[start:end] for start, end in pairwise(places))


def decode(chunks: Iterator[bytes], decoder: rpc.Decoder | None = None) -> list[Any]:
    decoder = decoder or rpc.Decoder()
    return [message for chunk in chunks for message in decoder.messages(chunk)]


def understand(data: bytes) -> list[rpc.RpcRequest]:
    return [rpc.parse_request(message) for message in decode(iter([data]))]


@given(st.lists(requests, max_size=5), st.lists(st.integers(min_value=0)))
def test_requests_survive_any_cutting(calls: list[tuple[int, str, list[Any]]], cuts: list[int]) -> None:
    stream = b"".join(rpc.pack_request(*call) for call in calls)
    decoded = [rpc.parse_request(message) for message in decode(pieces(stream, cuts))]
    assert decoded == [rpc.RpcRequest(*call) for call in calls]


@given(message_ids, st.none() | st.text(st.characters(exclude_categories=["Cs"])), values)
def test_responses_come_out_as_they_went_in(message_id: int, error: str | None, result: Any) -> None:
    [message] = decode(iter([rpc.pack_response(message_id, error, result)]))
    assert message == [rpc.RESPONSE, message_id, error, result]


@given(st.binary(max_size=300), st.lists(st.integers(min_value=0)))
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
    try:
        for message in decode(pieces(data, cuts)):
            rpc.parse_request(message)
    except rpc.ProtocolError:
        pass


@pytest.mark.parametrize("message", [
    [],
    [rpc.REQUEST],
    [rpc.REQUEST, 1, "ping"],
    [rpc.REQUEST, "1", "ping", []],
    [rpc.REQUEST, True, "ping", []],
    [rpc.REQUEST, 1, 7, []],
    [rpc.REQUEST, 1, b"ping", []],
    [rpc.REQUEST, 1, "ping", {}],
    [rpc.REQUEST, 1, "ping", None],
    [rpc.RESPONSE, 1, None, None],
    [rpc.NOTIFY, 1, "ping", []],
    [3, 1, "ping", []],
    {"method": "ping"},
    7,
])  # fmt: skip
def test_what_is_no_request_is_refused(message: Any) -> None:
    with pytest.raises(rpc.ProtocolError):
        understand(msgpack.packb(message))


def test_a_notification_has_no_id() -> None:
    [message] = decode(iter([msgpack.packb([rpc.NOTIFY, "ping", []])]))
    assert rpc.parse_request(message) == rpc.RpcRequest(None, "ping", [])


def test_a_message_is_bounded_and_so_is_what_it_announces() -> None:
    whole = rpc.pack_request(1, "ping", ["x" * 900])
    assert len(decode(iter([whole]), rpc.Decoder(max_message_bytes=1024))) == 1
    with pytest.raises(rpc.ProtocolError):
        decode(iter([whole[:500], whole[500:]]), rpc.Decoder(max_message_bytes=512))
    with pytest.raises(rpc.ProtocolError):  # before a single item has come
        decode(iter([b"\xdc" + (rpc.MAX_ITEMS + 1).to_bytes(2, "big")]))


def test_many_messages_are_no_large_message() -> None:
    stream = rpc.pack_request(1, "ping", []) * 1000
    assert len(decode(iter([stream[:5000], stream[5000:]]), rpc.Decoder(max_message_bytes=1 << 14))) == 1000


def test_raw_bytes_of_old_clients_are_text() -> None:
    old = msgpack.packb([rpc.REQUEST, 1, "ping", [b"\xff\xfe"]], use_bin_type=False)
    [message] = decode(iter([old]))
    assert rpc.parse_request(message).params == ["\udcff\udcfe"]


def test_an_error_that_quotes_such_bytes_is_sent_as_text() -> None:
    packed = rpc.pack_response(1, str(rpc.unknown_method("p\udcff", 0)), None)
    [message] = decode(iter([packed]))
    assert message[2] == "rpclib: server could not find function 'p?' with argument count 0."


def test_error_texts_are_rpclibs() -> None:
    assert str(rpc.unknown_method("fly", 2)) == ("rpclib: server could not find function 'fly' with argument count 2.")
    assert str(rpc.wrong_arity("fly", 1, 2)) == (
        "rpclib: Function 'fly' was called with an invalid number of arguments. Expected: 1, got: 2"
    )
    assert str(rpc.threw("fly", 2, "no wings")) == (
        "rpclib: function 'fly' (called with 2 arg(s)) threw an exception. "
        "The exception contained this information: no wings."
    )
