"""Who is connected to the server: newcomers, what they send and are sent, and what is kept for them.

Bad bytes cost a client its own connection and nothing else; too many clients, and too much kept for them, cost those
who are silent or hold most theirs.
"""

from __future__ import annotations

import contextlib
import logging
import selectors
import socket
from collections.abc import Callable, Hashable, Iterator
from typing import IO, Generic, NamedTuple, TypeVar

from uavaccel.clock import MonotonicClock, wait_for_sockets
from uavaccel.errors import UserError
from uavaccel.sim.deferred_reply import DeferredReply
from uavaccel.wire import rpc
from uavaccel.wire.calls import Steps
from uavaccel.wire.rpc import Framer
from uavaccel.wire.transport import set_no_delay, set_quick_ack

MOST_HELD_BYTES = 1 << 28
MAX_ANSWER_BYTES = 1 << 26  # of one answer
READ_FIRST_BYTES = 1 << 23  # a client with so much to read is asked for nothing more, until it has read

Client = TypeVar("Client", bound=Hashable)
_LOG = logging.getLogger(__name__)
READ_BYTES = 1 << 12
MAX_CONNECTIONS = 512  # fewer than the files that a process may open
IDLE_LIMIT_NS = 10_000_000_000  # once there are so many, one that has been silent for so long makes room
ACCEPTED_AT_ONCE = 16  # newcomers per wake-up


class Held(Generic[Client]):
    """Bytes by client."""

    def __init__(self) -> None:
        self._bytes: dict[Client, int] = {}
        self._total = 0

    def note(self, client: Client, held_bytes: int) -> None:
        """It holds so much now."""
        self._total += held_bytes - self._bytes.pop(client, 0)
        if held_bytes:
            self._bytes[client] = held_bytes

    def overdrawn_by(self) -> tuple[Client, int] | None:
        """Who holds most, and how much, where all hold too much together."""
        if self._total <= MOST_HELD_BYTES:
            return None
        most = max(self._bytes, key=self._bytes.__getitem__)
        return most, self._bytes[most]


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


class Clients:
    """The clients of one listening socket, and those who wait to be. Raises UserError if the address is taken.

    `say_once` is told what the server's user should know. `ended` once `stop_at_eof` has come to its end.
    """

    def __init__(
        self,
        address: tuple[str, int],
        clock: MonotonicClock,
        say_once: Callable[[str], None],
        stop_at_eof: IO[bytes] | None = None,
    ) -> None:
        host, port = address
        if not 0 <= port < 1 << 16:
            raise UserError(f"port must be 0 to 65535, not {port}")
        try:
            self._listener = socket.create_server((host, port), backlog=MAX_CONNECTIONS)
        except OSError as error:
            reason = (error.strerror or str(error)).partition(" (while")[0]
            raise UserError(f"cannot listen on {host}:{port}: {reason}; choose another with --port") from None
        self.address: tuple[str, int] = self._listener.getsockname()[:2]
        self._listener.setblocking(False)
        self.clock = clock
        self.connected: set[Connection] = set()
        self.ended = False
        self._say_once = say_once
        self._held: Held[Connection] = Held()
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._listener, selectors.EVENT_READ)
        if stop_at_eof is not None:
            self._selector.register(stop_at_eof, selectors.EVENT_READ)

    def wait(self, until_ns: int) -> Iterator[tuple[Connection, int]]:
        """Let newcomers in; each client whose socket can be used before that wall time, and for what (EVENT_*)."""
        for key, events in wait_for_sockets(self._selector, until_ns):
            if key.fileobj is self._listener:
                for _ in range(ACCEPTED_AT_ONCE):
                    self.accept()
            elif key.data is None:
                self.ended = True
            else:
                yield key.data, events

    def accept(self) -> None:
        """Let one in, if one waits and there is room."""
        try:
            raw, _ = self._listener.accept()
        except OSError:
            return  # it has gone again
        if len(self.connected) >= MAX_CONNECTIONS and not self._make_room():
            raw.close()
            return
        connection = Connection(raw)
        connection.heard_ns = self.clock.now_ns()
        try:
            raw.setblocking(False)
            set_no_delay(raw)
            self._selector.register(raw, selectors.EVENT_READ, connection)
        except OSError:  # gone again
            raw.close()
        else:
            self.connected.add(connection)

    def _make_room(self) -> bool:
        """Drop the client that has been silent for longest, if that is long enough; say so, or that none was."""
        silent = min((one for one in self.connected if one.idle), key=lambda one: one.heard_ns, default=None)
        silent_ns = 0 if silent is None else self.clock.now_ns() - silent.heard_ns
        if silent is None or silent_ns < IDLE_LIMIT_NS:
            self._say_once(
                f"warning: {MAX_CONNECTIONS} clients are connected; others are turned away "
                f"until one of them has been silent for {IDLE_LIMIT_NS / 1e9:g} s"
            )
            return False
        self._say_once(
            f"warning: {MAX_CONNECTIONS} clients are connected; those silent for more than "
            f"{IDLE_LIMIT_NS / 1e9:g} s make room for others"
        )
        self.drop(silent)
        return True

    def receive(self, connection: Connection) -> bool:
        """Take in what it has sent; False where it has hung up instead, or nothing was there."""
        try:
            data = connection.socket.recv(READ_BYTES)
        except (BlockingIOError, InterruptedError):
            return False
        except OSError:
            data = b""
        if not data:
            self.drop(connection)
            return False
        connection.heard_ns = self.clock.now_ns()
        try:
            set_quick_ack(connection.socket)
        except OSError:  # gone again
            self.drop(connection)
            return False
        connection.take_next(data)
        self.note_held(connection)
        return True

    def send(self, connection: Connection) -> None:
        """Send what the socket takes now; the rest when it takes more."""
        try:
            while connection.unsent:
                sent = connection.socket.send(connection.unsent)
                del connection.unsent[:sent]
        except BlockingIOError:
            pass
        except OSError:
            self.drop(connection)
            return
        self.note_held(connection)
        self.watch(connection)

    def watch(self, connection: Connection) -> None:
        """Look out for what the socket can be used for now."""
        if not connection.open:
            return
        reading = 0 if connection.asks else selectors.EVENT_READ
        writing = selectors.EVENT_WRITE if connection.unsent else 0
        before = self._selector.get_map().get(connection.socket)
        if before is not None and before.events == (reading | writing):
            return
        if before is not None:
            self._selector.unregister(connection.socket)
        if reading | writing:
            self._selector.register(connection.socket, reading | writing, connection)

    def note_held(self, connection: Connection) -> None:
        """Account for what is kept for a client; hang up on who holds most where that is too much for all together."""
        self._held.note(connection, connection.held_bytes if connection.open else 0)
        while overdrawn := self._held.overdrawn_by():
            holder, held_bytes = overdrawn
            text = f"{held_bytes >> 20} MiB are kept for this client, and too much for all together"
            self._say_once(f"warning: a client was hung up on: {text}")
            self.hang_up(holder, text, holder.framer.unfinished_id())

    def hang_up(self, connection: Connection, text: str, message_id: int | None) -> None:
        """Drop a client; tell it why, if it waits for an answer and takes it at once."""
        if connection.open and message_id is not None and not connection.unsent:
            with contextlib.suppress(OSError):
                connection.socket.send(rpc.pack_response(message_id, text, None))
        self.drop(connection)

    def drop(self, connection: Connection) -> None:
        """Forget a client; a command of its own runs on."""
        if connection.open:
            connection.open = False
            connection.unsent.clear()
            connection.request = connection.begun = None
            self._held.note(connection, 0)
            if connection.socket in self._selector.get_map():
                self._selector.unregister(connection.socket)
            connection.socket.close()
            self.connected.discard(connection)

    def close(self) -> None:
        """Hang up on all, and listen no longer."""
        for connection in list(self.connected):
            self.drop(connection)
        self._selector.close()
        self._listener.close()
