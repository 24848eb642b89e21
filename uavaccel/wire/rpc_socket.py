"""A client's end of msgpack-rpc over TCP: it numbers requests, and finds the calls that are answered.

It imports nothing of the simulation, as AirSim's scripts have to start quickly.
"""

from __future__ import annotations

import selectors
import socket
from collections.abc import Callable, Iterator, Sequence
from typing import Generic, NamedTuple, TypeVar

from uavaccel.wire import rpc
from uavaccel.wire.rpc import Received

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
        self._decoder = rpc.Decoder(_MESSAGE_BYTES, _ITEMS)
        self._open: dict[int, Call] = {}
        self._next_id = 0

    def request(
        self, call: Call, method: str, params: Sequence[object], default: Callable[[object], object] | None = None
    ) -> bytes:
        """Return the bytes to send for a call; `default` converts values that msgpack cannot pack."""
        self._next_id = (self._next_id + 1) & 0xFFFFFFFF
        message = rpc.pack_request(self._next_id, method, params, default)
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
            if len(message) == 4 and message[0] == rpc.RESPONSE:
                call = self._open.pop(message[1], None)
                if call is not None:
                    yield Reply(call, message[2], message[3])

    def close(self) -> None:
        self.selector.close()
        self.socket.close()
