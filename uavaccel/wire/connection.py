"""A client of the server as the server sees it, and what it is to be told."""

from __future__ import annotations

import socket
from collections import deque
from typing import Any, NamedTuple

from uavaccel.sim.simulation import DeferredReply
from uavaccel.wire import rpc
from uavaccel.wire.steps import Steps


class Connection:
    """One client: its stream of requests, and what could not be sent yet."""

    def __init__(self, connection: socket.socket) -> None:
        self.socket = connection
        self.decoder = rpc.Decoder()
        self.requests: deque[rpc.RpcRequest] = deque()  # that have come, and have not had their turn yet
        self.begun: tuple[rpc.RpcRequest, Steps] | None = None  # whose result is not whole yet
        self.unsent = bytearray()
        self.waiting = 0  # answers that are not due yet
        self.heard_ns = 0
        self.in_backlog = False
        self.broken = False  # its bytes are no messages any more
        self.open = True

    @property
    def idle(self) -> bool:
        """Whether nothing is to be done for it."""
        return not (self.asks or self.unsent or self.waiting)

    @property
    def asks(self) -> bool:
        """Whether there is something to be answered at once."""
        return bool(self.requests or self.begun)


class Answer(NamedTuple):
    """What a client is to be told; a `DeferredReply` is due by now."""

    connection: Connection
    message_id: int
    error: str | None
    result: Any

    def pack(self) -> bytes:
        result = self.result
        if isinstance(result, DeferredReply):
            result = result.encode(result.value)
        try:
            return rpc.pack_response(self.message_id, self.error, result)
        except (TypeError, ValueError, OverflowError) as error:  # costs the caller its call and nobody else
            return rpc.pack_response(self.message_id, f"the answer cannot be packed: {error}", None)
