"""msgpack-rpc as AirSim's rpclib speaks it: messages, framing, error texts, and a client's end of it over TCP.

A request is [0, id, method, params], a response [1, id, error, result], a notification [2, method, params]. Nothing of
the simulation is imported, as AirSim's scripts have to start quickly.
"""

from __future__ import annotations

import selectors
import socket
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from typing import Any, Generic, NamedTuple, TypeAlias, TypeVar

import msgpack
import numpy as np

Received: TypeAlias = Any  # a value of a message as msgpack reads it; its reader knows the call's types
Default: TypeAlias = Callable[[object], object] | None

LOOPBACK, PORT = "127.0.0.1", 41451  # where AirSim's servers listen
MAX_MESSAGE_BYTES = 1 << 20
MAX_ANSWER_BYTES = 1 << 26
MAX_ITEMS = 1 << 14  # of an array: msgpack allocates as many as it announces, at every level of nesting
_FLOAT32, _ARRAY32 = 0xCA, b"\xdd"  # MessagePack's
_PACKED_FLOAT = 5  # bytes of one
_LONGEST_HEAD = 16  # bytes of a message's outermost array header, its kind and its number
# clients with msgpack 0.5 send bytes as text
_READING = {"raw": False, "unicode_errors": "surrogateescape", "strict_map_key": False}
_UNREADABLE = (ValueError, TypeError, msgpack.UnpackException, msgpack.BufferFull, RecursionError)
_QUICKACK = getattr(socket, "TCP_QUICKACK", None)
_CONNECT_S = 10.0
_READ_BYTES = 1 << 16
_ANSWER_BYTES, _ANSWER_ITEMS = 1 << 28, 1 << 24  # a recording, images and a picture of floats are large answers


class RpcError(Exception):
    """A failed call; its text is the client's error, in rpclib's words, and `reason` why it was refused."""

    @property
    def reason(self) -> str:
        return str(self).rpartition("contained this information: ")[2].removesuffix(".")


class ServerGoneError(ConnectionError):
    """The server of a session has ended, or has stopped responding."""


class ProtocolError(Exception):
    """A stream that is not msgpack-rpc, so that the connection cannot continue.

    `message_id` is the number of the broken request, if it is known.
    """

    def __init__(self, text: str, message_id: int | None = None) -> None:
        super().__init__(text)
        self.message_id = message_id


class RpcRequest(NamedTuple):
    """A request; `message_id` is None for a notification, which gets no answer."""

    message_id: int | None
    method: str
    params: Sequence[object]


def unpack_request(message: bytes) -> RpcRequest:
    """Return the request in a whole message's bytes. Raises ProtocolError if it is none."""
    try:
        unpacked = msgpack.unpackb(message, **_READING, max_array_len=MAX_ITEMS, max_map_len=MAX_ITEMS)
    except _UNREADABLE as error:
        raise ProtocolError(f"not msgpack: {error}") from error
    match unpacked:
        case [0, int(number), str(method), list(params)] if type(number) is int:
            return RpcRequest(number, method, params)
        case [2, str(method), list(params)]:
            return RpcRequest(None, method, params)
    raise ProtocolError("not a msgpack-rpc request")


def pack_request(number: int, method: str, params: Sequence[object], default: Default = None) -> bytes:
    """Return a request's bytes; `default` converts values that msgpack cannot pack."""
    return bytes(msgpack.packb([0, number, method, list(params)], default=default))


def pack_response(message_id: int, error: str | None, result: object) -> bytes:
    if error is not None:  # it may quote bytes that are not valid text
        error = error.encode("utf-8", "replace").decode()
    return pack([1, message_id, error, result])


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
    if isinstance(value, np.ndarray):  # a header, then a type byte and four big-endian bytes per number
        packed = np.empty((value.size, _PACKED_FLOAT), np.uint8)
        packed[:, 0] = _FLOAT32
        packed[:, 1:] = value.astype(">f4").reshape(-1, 1).view(np.uint8)
        yield _ARRAY32 + value.size.to_bytes(4, "big") + packed.tobytes()
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


class Framer:
    """Cuts a client's stream into whole messages without unpacking any, so that half a message costs only its bytes.

    Unpacked as they arrive, nested arrays take a hundred times the memory of their bytes, and an array that announces
    items takes their memory before they have arrived.
    """

    def __init__(self) -> None:
        # more may be fed while whole messages wait
        self._scanner = msgpack.Unpacker(max_buffer_size=2 * MAX_MESSAGE_BYTES, strict_map_key=False)
        self._kept = bytearray()
        self._passed = 0  # bytes of the messages that have been returned

    def next(self, data: bytes = b"") -> bytes | None:
        """Add bytes of the stream, and take its next whole message; None until it is complete.

        Raises ProtocolError if it is invalid or too long.
        """
        self._kept += data
        if not self._kept:  # as after most requests
            return None
        try:
            self._scanner.feed(data)
            self._scanner.skip()
            size = self._scanner.tell() - self._passed
        except msgpack.OutOfData:
            size = 0
        except msgpack.BufferFull:
            raise self._too_long() from None
        except _UNREADABLE as error:
            raise ProtocolError(f"not msgpack: {error}") from error
        if (size or len(self._kept)) > MAX_MESSAGE_BYTES:
            raise self._too_long()
        self._passed += size
        message = bytes(self._kept[:size])
        del self._kept[:size]
        return message or None

    def _too_long(self) -> ProtocolError:
        """Return the error for a message, with its number if that has arrived."""
        head = msgpack.Unpacker()
        head.feed(bytes(self._kept[:_LONGEST_HEAD]))
        kind, number = None, None
        with suppress(ValueError, msgpack.UnpackException):
            head.read_array_header()
            kind, number = head.unpack(), head.unpack()
        known = kind == 0 and isinstance(number, int)
        return ProtocolError(f"a message may have {MAX_MESSAGE_BYTES >> 20} MiB, not more", number if known else None)


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


class Future:
    """A call that was sent, under the names of msgpack-rpc, which AirSim's scripts use; `wait` waits for its answer.

    `result` and `error` are valid once it is `done`; `error` is the server's text, or None. `late` says that no answer
    came in time. `watch`, if given, is called with a future to which a callback is attached.
    """

    late = False
    watch: Callable[[Any], object] | None = None
    _callback: Callable[[Any], object] | None = None
    _result_handler: Callable[[Any], object] | None = None
    _error_handler: Callable[[Any], object] | None = None

    def __init__(self, method: str, wait: Callable[[Any], object] = lambda call: None) -> None:
        self.method = method
        self.done = False
        self.result: Received = None
        self.error: str | None = None
        self.wait = wait

    def join(self) -> None:
        """Wait for the answer, or until it is late. As in AirSim an error is not raised."""
        if not self.done:
            self.wait(self)
            self.tell()

    def get(self) -> Received:
        """Wait for the answer and return it, or None if a handler takes it. Raises as `outcome` does."""
        self.join()
        taken = self.result if self.error is None else self.error
        handler = self._result_handler if self.error is None else self._error_handler
        if handler is None or taken is None:
            return self.outcome()
        handler(taken)
        return None

    def attach_callback(self, callback: Callable[[Any], object]) -> None:
        """Let it be called with this future when the answer arrives while its client waits for this or another call."""
        self._callback = callback
        if self.watch is not None:
            self.watch(self)

    def tell(self) -> None:
        """Call what is attached, once."""
        if (callback := vars(self).pop("_callback", None)) is not None:
            callback(self)

    def attach_result_handler(self, handler: Callable[[Any], object]) -> None:
        """Let `get` hand it the result."""
        self._result_handler = handler

    def attach_error_handler(self, handler: Callable[[Any], object]) -> None:
        """Let `get` hand it the error's text, and not raise one."""
        self._error_handler = handler

    def outcome(self) -> Received:
        """Return what has been answered. Raises RpcError with the server's text, TimeoutError if it is late."""
        if self.late:
            raise TimeoutError(f"{self.method}: {self.error}")
        if self.error is not None:
            raise RpcError(self.error)
        return self.result

    def answer(self, error: str | None, result: object, late: bool = False) -> None:
        """Set the server's answer, or that none came in time."""
        self.error, self.result, self.late, self.done = error, result, late, True


Call = TypeVar("Call", bound=Future)


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
        most = {"max_array_len": _ANSWER_ITEMS, "max_map_len": _ANSWER_ITEMS}
        self._unpacker = msgpack.Unpacker(max_buffer_size=_ANSWER_BYTES, **_READING, **most)
        self._open: dict[int, Call] = {}
        self._next_id = 0

    def request(self, call: Call, method: str, params: Sequence[object], default: Default = None) -> bytes:
        """Return the bytes to send for a call; `default` converts values that msgpack cannot pack."""
        self._next_id = (self._next_id + 1) & 0xFFFFFFFF
        message = pack_request(self._next_id, method, params, default)
        self._open[self._next_id] = call
        return message

    def receive(self) -> list[Call]:
        """Read once, waiting if nothing has arrived; return the calls that were answered.

        Raises ConnectionError at the end.
        """
        try:
            data = self.socket.recv(_READ_BYTES)
        except ConnectionError as error:
            raise ConnectionError(f"the server closed the connection: {error}") from None
        if not data:
            raise ConnectionError("the server closed the connection")
        set_quick_ack(self.socket)
        answered = []
        try:
            self._unpacker.feed(data)
            for message in self._unpacker:
                if not isinstance(message, list) or not message:
                    raise ProtocolError(f"not a msgpack-rpc message: {type(message).__name__}")
                call = self._open.pop(message[1], None) if len(message) == 4 and message[0] == 1 else None
                if call is not None and not call.done:
                    call.answer(None if message[2] is None else str(message[2]), message[3])
                    answered.append(call)
        except _UNREADABLE as error:
            raise ProtocolError(f"not msgpack: {error}") from error
        return answered

    def close(self) -> None:
        self.selector.close()
        self.socket.close()
