"""msgpack-rpc as AirSim's rpclib speaks it: messages, framing, error texts, and a client's end of it over TCP.

A request is [0, id, method, params], a response [1, id, error, result], a notification [2, method, params]. Nothing of
the simulation is imported, as AirSim's scripts have to start quickly.
"""

from __future__ import annotations

import selectors
import socket
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Generic, NamedTuple, TypeAlias, TypeVar

import msgpack
import numpy as np
from numpy.typing import NDArray

Received: TypeAlias = Any  # a value of a message as msgpack reads it; its reader knows the call's types

LOOPBACK, PORT = "127.0.0.1", 41451  # where AirSim's servers listen
REQUEST, RESPONSE, NOTIFY = 0, 1, 2
MAX_MESSAGE_BYTES = 1 << 20
MAX_ANSWER_BYTES = 1 << 26
MAX_ITEMS = 1 << 14  # of an array: msgpack allocates as many as it announces, at every level of nesting
_FLOAT32, _ARRAY32 = 0xCA, b"\xdd"  # MessagePack's
_PACKED_FLOAT = 5  # bytes of one
_LONGEST_HEAD = 16  # bytes of a message's outermost array header, its kind and its number
_BEGINNINGS = (  # headers of arrays of three or four: a notification, a request
    *(b"\x93", b"\x94", b"\xdc\x00\x03", b"\xdc\x00\x04"),
    *(b"\xdd\x00\x00\x00\x03", b"\xdd\x00\x00\x00\x04"),
)


class RpcError(Exception):
    """A failed call; its text is the client's error, `reason` the part that is not rpclib's phrase."""

    def __init__(self, text: str, reason: str = "") -> None:
        super().__init__(text)
        self.reason = reason or text


class ProtocolError(Exception):
    """A stream that is not msgpack-rpc; the connection cannot continue.

    `message_id` is the number of the broken request, if it is known.
    """

    def __init__(self, text: str, message_id: int | None = None) -> None:
        super().__init__(text)
        self.message_id = message_id


@dataclass(frozen=True)
class RpcRequest:
    """A request; `message_id` is None for a notification, which gets no answer."""

    message_id: int | None
    method: str
    params: Sequence[object]


class Decoder:
    """Decodes a stream of bytes into messages; raises ProtocolError for anything else."""

    def __init__(self, max_message_bytes: int = MAX_MESSAGE_BYTES, max_items: int = MAX_ITEMS) -> None:
        self._unpacker = msgpack.Unpacker(max_buffer_size=max_message_bytes, **_unpacking(max_items))

    def messages(self, data: bytes) -> Iterator[list[Received]]:
        """Yield the whole messages that `data` completes."""
        try:
            self._unpacker.feed(data)
            for message in self._unpacker:
                if not isinstance(message, list) or not message:
                    raise ProtocolError(f"not a msgpack-rpc message: {type(message).__name__}")
                yield message
        except (ValueError, TypeError, msgpack.UnpackException, msgpack.BufferFull, RecursionError) as error:
            raise ProtocolError(f"not msgpack: {error}") from error


def _unpacking(max_items: int) -> dict[str, object]:
    """Return the options with which msgpack reads messages; clients with msgpack 0.5 send bytes as text."""
    how = {"raw": False, "unicode_errors": "surrogateescape", "strict_map_key": False}
    return {**how, "max_array_len": max_items, "max_map_len": max_items}


_OF_REQUESTS = _unpacking(MAX_ITEMS)


def unpack_request(message: bytes) -> RpcRequest:
    """Return the request in a whole message's bytes. Raises ProtocolError if it is none."""
    try:
        return parse_request(msgpack.unpackb(message, **_OF_REQUESTS))
    except (ValueError, TypeError, msgpack.UnpackException, RecursionError) as error:
        raise ProtocolError(f"not msgpack: {error}") from error


def parse_request(message: object) -> RpcRequest:
    """Return the request in an unpacked message. Raises ProtocolError if it is none."""
    if not isinstance(message, list):
        raise ProtocolError("not a msgpack-rpc request")
    if len(message) == 4 and message[0] == REQUEST and type(message[1]) is int:
        message_id, method, params = message[1], message[2], message[3]
    elif len(message) == 3 and message[0] == NOTIFY:
        message_id, method, params = None, message[1], message[2]
    else:
        raise ProtocolError("not a msgpack-rpc request")
    if not isinstance(method, str) or not isinstance(params, list):
        raise ProtocolError("not a msgpack-rpc request")
    return RpcRequest(message_id, method, params)


def pack_request(
    message_id: int, method: str, params: Sequence[object], default: Callable[[object], object] | None = None
) -> bytes:
    """Return a request's bytes; `default` converts values that msgpack cannot pack."""
    return bytes(msgpack.packb([REQUEST, message_id, method, list(params)], default=default))


def pack_response(message_id: int, error: str | None, result: object) -> bytes:
    """Return a response's bytes."""
    if error is not None:  # it may quote bytes that are not valid text
        error = error.encode("utf-8", "replace").decode()
    return pack([RESPONSE, message_id, error, result])


def bulk_bytes(fields: Mapping[str, object]) -> int:
    """Return the packed size of the bytes and arrays in a map, such as an image's."""
    texts = (len(field) for field in fields.values() if isinstance(field, bytes))
    return sum(texts) + sum(_PACKED_FLOAT * field.size for field in fields.values() if isinstance(field, np.ndarray))


def pack(value: object) -> bytes:
    """Pack what a call returns: plain values, and NumPy's arrays as lists of numbers."""
    try:
        return bytes(msgpack.packb(value))
    except TypeError:  # it contains arrays
        return b"".join(_pieces(msgpack.Packer(), value))


def _pieces(packer: msgpack.Packer, value: object) -> Iterator[bytes]:
    """Pack a value that contains arrays, which become lists of single precision."""
    if isinstance(value, np.ndarray):
        yield _packed_floats(value)
    elif isinstance(value, dict):
        yield packer.pack_map_header(len(value))
        for key, inner in value.items():
            yield packer.pack(key)
            yield from _pieces(packer, inner)
    elif isinstance(value, list):
        yield packer.pack_array_header(len(value))
        for inner in value:
            yield from _pieces(packer, inner)
    else:
        yield packer.pack(value)


def _packed_floats(numbers: NDArray[np.generic]) -> bytes:
    """Return a MessagePack array: its header, then a type byte and four big-endian bytes per number."""
    packed = np.empty((numbers.size, _PACKED_FLOAT), np.uint8)
    packed[:, 0] = _FLOAT32
    packed[:, 1:] = numbers.astype(">f4").reshape(-1, 1).view(np.uint8)
    return _ARRAY32 + numbers.size.to_bytes(4, "big") + packed.tobytes()


def unknown_method(method: str, count: int) -> RpcError:
    """rpclib's error for a method that the server does not have."""
    return RpcError(f"rpclib: server could not find function '{method}' with argument count {count}.")


def wrong_arity(method: str, expected: int, got: int) -> RpcError:
    """rpclib's error for a wrong number of arguments."""
    return RpcError(
        f"rpclib: Function '{method}' was called with an invalid number of arguments. Expected: {expected}, got: {got}"
    )


def threw(method: str, count: int, message: str) -> RpcError:
    """rpclib's error for a method that threw an exception."""
    return RpcError(
        f"rpclib: function '{method}' (called with {count} arg(s)) threw an exception. "
        f"The exception contained this information: {message}.",
        reason=message,
    )


class Framer:
    """Cuts a client's stream into whole messages without unpacking any, so that half a message costs only its bytes.

    Unpacked as they arrive, nested arrays take a hundred times the memory of their bytes, and an array that announces
    items takes their memory before they have arrived.
    """

    def __init__(self, max_message_bytes: int = MAX_MESSAGE_BYTES) -> None:
        self._most = max_message_bytes
        # more may be fed while whole messages wait
        self._scanner = msgpack.Unpacker(max_buffer_size=2 * max_message_bytes, strict_map_key=False)
        self._kept = bytearray()
        self._passed = 0  # bytes of the messages that have been returned

    def feed(self, data: bytes) -> None:
        """Add bytes of the stream. Raises ProtocolError if there are too many."""
        self._kept += data
        try:
            self._scanner.feed(data)
        except msgpack.BufferFull:
            raise self._too_long() from None

    def next(self) -> bytes | None:
        """Take the next whole message; None until it is complete. Raises ProtocolError if it is invalid or too long."""
        if not self._kept:
            return None
        self._check_beginning()
        try:
            self._scanner.skip()
        except msgpack.OutOfData:
            if len(self._kept) > self._most:
                raise self._too_long() from None
            return None
        except (ValueError, TypeError, msgpack.UnpackException) as error:
            raise ProtocolError(f"not msgpack: {error}") from error
        size = self._scanner.tell() - self._passed
        if size > self._most:
            raise self._too_long()
        self._passed += size
        message = bytes(self._kept[:size])
        del self._kept[:size]
        return message

    def _check_beginning(self) -> None:
        head = bytes(self._kept[:5])
        if not any(head.startswith(known[: len(head)]) for known in _BEGINNINGS):
            raise ProtocolError("not a msgpack-rpc message")

    def _too_long(self) -> ProtocolError:
        return ProtocolError(f"a message may have {self._most >> 20} MiB, not more", self.unfinished_id())

    def unfinished_id(self) -> int | None:
        """Return the number of the request that has arrived in part; None if it has none, or it is not known yet."""
        head = msgpack.Unpacker()
        head.feed(bytes(self._kept[:_LONGEST_HEAD]))
        try:
            head.read_array_header()
            kind, number = head.unpack(), head.unpack()
        except (ValueError, msgpack.UnpackException):
            return None
        return number if kind == REQUEST and isinstance(number, int) else None


_QUICKACK = getattr(socket, "TCP_QUICKACK", None)
_CONNECT_S = 10.0
_READ_BYTES = 1 << 16
_MESSAGE_BYTES = 1 << 28  # a recording and images are large replies
_ITEMS = 1 << 24  # so is a picture of floats
Call = TypeVar("Call")


def set_no_delay(connection: socket.socket) -> None:
    """Disable Nagle's algorithm and delayed acknowledgements.

    Together they hold the second of two small messages for 40 ms, such as a continue-for after a command. Linux resets
    the second option: set it again after every read.
    """
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    set_quick_ack(connection)


def set_quick_ack(connection: socket.socket) -> None:
    """Acknowledge what was just read at once, where the system can."""
    if _QUICKACK is not None:
        connection.setsockopt(socket.IPPROTO_TCP, _QUICKACK, 1)


class Reply(NamedTuple, Generic[Call]):
    """A call, and the server's answer to it."""

    call: Call
    error: str | None
    value: Received


class RpcSocket(Generic[Call]):
    """One connection, for calls of any kind. Raises ConnectionError if no server listens at the address."""

    def __init__(self, host: str, port: int) -> None:
        try:
            self.socket = socket.create_connection((host, port), timeout=_CONNECT_S)
        except OSError as error:
            reason = error.strerror or str(error)
            raise ConnectionError(f"no server at {host}:{port} ({reason}); start one with `uavaccel serve`") from None
        self.socket.settimeout(None)
        set_no_delay(self.socket)
        self.selector = selectors.DefaultSelector()
        self.selector.register(self.socket, selectors.EVENT_READ)
        self._decoder = Decoder(_MESSAGE_BYTES, _ITEMS)
        self._open: dict[int, Call] = {}
        self._next_id = 0

    def request(
        self, call: Call, method: str, params: Sequence[object], default: Callable[[object], object] | None = None
    ) -> bytes:
        """Return the bytes to send for a call; `default` converts values that msgpack cannot pack."""
        self._next_id = (self._next_id + 1) & 0xFFFFFFFF
        message = pack_request(self._next_id, method, params, default)
        self._open[self._next_id] = call
        return message

    def receive(self) -> Iterator[Reply[Call]]:
        """Read once, waiting if nothing has arrived, and yield the replies. Raises ConnectionError at the end."""
        try:
            data = self.socket.recv(_READ_BYTES)
        except ConnectionError as error:
            raise ConnectionError(f"the server closed the connection: {error}") from None
        if not data:
            raise ConnectionError("the server closed the connection")
        set_quick_ack(self.socket)
        for message in self._decoder.messages(data):
            if len(message) == 4 and message[0] == RESPONSE:
                call = self._open.pop(message[1], None)
                if call is not None:
                    yield Reply(call, message[2], message[3])

    def close(self) -> None:
        self.selector.close()
        self.socket.close()
