"""A client of the server as the server sees it, and what it is to be told."""

from __future__ import annotations

import logging
import socket
from typing import NamedTuple

from uavaccel.sim.deferred_reply import DeferredReply
from uavaccel.wire import rpc
from uavaccel.wire.framing import Framer
from uavaccel.wire.held import MAX_ANSWER_BYTES, READ_FIRST_BYTES
from uavaccel.wire.steps import Steps

_LOG = logging.getLogger(__name__)


class Connection:
    """One client: its stream of requests, and what could not be sent yet."""

    def __init__(self, connection: socket.socket) -> None:
        self.socket = connection
        self.framer = Framer()
        self.request: bytes | None = None  # that has come, and has not had its turn yet
        self.begun: tuple[rpc.RpcRequest, Steps] | None = None  # whose result is not whole yet
        self.unsent = bytearray()
        self.waiting = 0  # answers that are not due yet
        self.heard_ns = 0
        self.served_ns, self.has_turn = 0, False  # uavaccel.wire.turns
        self.broken: rpc.ProtocolError | None = None  # its bytes are no messages any more
        self.open = True

    @property
    def idle(self) -> bool:
        """Whether nothing is to be done for it."""
        return not (self.asks or self.unsent or self.waiting)

    @property
    def asks(self) -> bool:
        """Whether there is something to be answered at once."""
        return self.request is not None or self.begun is not None

    @property
    def method(self) -> str:
        """What it asks for next; empty where that is nothing any more."""
        if self.begun:
            return self.begun[0].method
        return rpc.method_of(self.request) if self.request is not None else ""

    def take_next(self, data: bytes = b"") -> None:
        """Look for its next request, with what more of its stream has come; notes where that is `broken`."""
        try:
            self.framer.feed(data)
            self.request = self.request or self.framer.next()
        except rpc.ProtocolError as error:
            self.broken = error

    @property
    def may_ask(self) -> bool:
        """Whether it has read enough of what it was told to be told more."""
        return len(self.unsent) <= READ_FIRST_BYTES

    @property
    def held_bytes(self) -> int:
        """What is kept for it."""
        begun = self.begun[1].held_bytes if self.begun else 0
        return self.framer.held_bytes + len(self.unsent) + begun


class Answer(NamedTuple):
    """What a client is to be told; a `DeferredReply` is due by now."""

    connection: Connection
    message_id: int
    error: str | None
    result: object

    def pack(self) -> bytes:
        """What cannot be packed, or is too long, costs the caller its call and nobody else."""
        result = self.result
        try:
            if isinstance(result, DeferredReply):
                result = result.encode(result.value)
            packed = rpc.pack_response(self.message_id, self.error, result)
        except Exception as error:
            _LOG.error("an answer cannot be packed", exc_info=error)
            return rpc.pack_response(self.message_id, f"the answer cannot be packed: {error}", None)
        if len(packed) <= MAX_ANSWER_BYTES:
            return packed
        text = f"the answer has {len(packed) >> 20} MiB, more than {MAX_ANSWER_BYTES >> 20}: ask for less"
        return rpc.pack_response(self.message_id, text, None)
