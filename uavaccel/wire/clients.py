"""The server's connections: accepting them, reading requests, sending answers, and bounding the memory kept for them.

A client that sends bad bytes loses its own connection and nothing else. Too many clients disconnect the one that has
been silent longest; too much memory for all together disconnects the one for which most is kept: unfinished messages,
results in the making, answers that it does not read.
"""

from __future__ import annotations

import contextlib
import logging
import selectors
import socket
from collections.abc import Callable, Iterator
from typing import IO, NamedTuple

from uavaccel.clock import MonotonicClock, wait_for_sockets
from uavaccel.errors import UserError
from uavaccel.sim.deferred_reply import DeferredReply
from uavaccel.wire import rpc
from uavaccel.wire.calls import PartialResult
from uavaccel.wire.rpc import Framer
from uavaccel.wire.transport import set_no_delay, set_quick_ack

MOST_HELD_BYTES = 1 << 28
MAX_ANSWER_BYTES = 1 << 26
READ_FIRST_BYTES = 1 << 23  # of unread answers, above which a client's requests have to wait
READ_BYTES = 1 << 12
MAX_CONNECTIONS = 512  # fewer than the files that a process may open
IDLE_LIMIT_NS = 10_000_000_000  # silence after which a client may be disconnected in favour of a new one
ACCEPTED_AT_ONCE = 16  # new connections per wake-up
_LOG = logging.getLogger(__name__)


class Connection:
    """One client: its stream of requests, and the answers that could not be sent yet."""

    def __init__(self, connection: socket.socket) -> None:
        self.socket = connection
        self.framer = Framer()
        self.request: bytes | None = None  # received, and waiting for its turn
        self.begun: tuple[rpc.RpcRequest, PartialResult] | None = None
        self.unsent = bytearray()
        self.waiting = 0  # answers that are not due yet
        self.heard_ns = 0
        self.served_ns, self.has_turn = 0, False  # uavaccel.wire.fair_queue
        self.broken: rpc.ProtocolError | None = None  # its stream cannot be decoded any further
        self.open = True

    @property
    def idle(self) -> bool:
        """Whether the server has nothing to do for it."""
        return not (self.asks or self.unsent or self.waiting)

    @property
    def asks(self) -> bool:
        """Whether it has a request that can be served now."""
        return self.request is not None or self.begun is not None

    @property
    def method(self) -> str:
        """The method of the request to be served next; empty without one."""
        if self.begun:
            return self.begun[0].method
        return rpc.method_of(self.request) if self.request is not None else ""

    def take_next(self, data: bytes = b"") -> None:
        """Take the next whole request out of its stream, extended by `data`; sets `broken` where that is impossible."""
        try:
            self.framer.feed(data)
            self.request = self.request or self.framer.next()
        except rpc.ProtocolError as error:
            self.broken = error

    @property
    def may_request(self) -> bool:
        """Whether it has read enough of its answers to be served again."""
        return len(self.unsent) <= READ_FIRST_BYTES

    @property
    def buffered_bytes(self) -> int:
        """The memory that is kept for it."""
        begun = self.begun[1].buffered_bytes if self.begun else 0
        return self.framer.buffered_bytes + len(self.unsent) + begun


class Answer(NamedTuple):
    """The answer to a request; a `DeferredReply` in it is due by now."""

    connection: Connection
    message_id: int
    error: str | None
    result: object

    def pack(self) -> bytes:
        """Return the message; an error in place of a result that cannot be packed or is too long."""
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
    """The clients of one listening socket. Raises UserError if the address is taken.

    `say_once` shows a line to the server's user. `ended` is set at the end of the file `stop_at_eof`.
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
        self._held_bytes: dict[Connection, int] = {}
        self._held_in_all = 0
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._listener, selectors.EVENT_READ)
        if stop_at_eof is not None:
            self._selector.register(stop_at_eof, selectors.EVENT_READ)

    def wait(self, until_ns: int) -> Iterator[tuple[Connection, int]]:
        """Accept new clients until a wall time, and yield each client whose socket is ready with its EVENT_* flags."""
        for key, events in wait_for_sockets(self._selector, until_ns):
            if key.fileobj is self._listener:
                for _ in range(ACCEPTED_AT_ONCE):
                    self.accept()
            elif key.data is None:
                self.ended = True
            else:
                yield key.data, events

    def accept(self) -> None:
        """Accept a client, if one waits and there is room."""
        try:
            raw, _ = self._listener.accept()
        except OSError:
            return  # it has disconnected again
        if len(self.connected) >= MAX_CONNECTIONS and not self._make_room():
            raw.close()
            return
        connection = Connection(raw)
        connection.heard_ns = self.clock.now_ns()
        try:
            raw.setblocking(False)
            set_no_delay(raw)
            self._selector.register(raw, selectors.EVENT_READ, connection)
        except OSError:  # disconnected again
            raw.close()
        else:
            self.connected.add(connection)

    def _make_room(self) -> bool:
        """Disconnect the client that has been silent longest, if that is long enough, and say so."""
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
        """Read from a client; False if it has disconnected, or nothing has arrived."""
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
        except OSError:  # disconnected again
            self.drop(connection)
            return False
        connection.take_next(data)
        self.note_buffered(connection)
        return True

    def send(self, connection: Connection) -> None:
        """Send as much as the socket takes now; the rest is sent when it becomes writable."""
        try:
            while connection.unsent:
                sent = connection.socket.send(connection.unsent)
                del connection.unsent[:sent]
        except BlockingIOError:
            pass
        except OSError:
            self.drop(connection)
            return
        self.note_buffered(connection)
        self.watch(connection)

    def watch(self, connection: Connection) -> None:
        """Register the socket for the events that matter now."""
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

    def note_buffered(self, connection: Connection) -> None:
        """Account for the memory that is kept for a client; disconnects whoever holds most while all hold too much."""
        self._set_held(connection, connection.buffered_bytes if connection.open else 0)
        while self._held_in_all > MOST_HELD_BYTES:
            holder = max(self._held_bytes, key=self._held_bytes.__getitem__)
            kept = f"{self._held_bytes[holder] >> 20} MiB are kept for this client"
            text = f"{kept}, and too much for all together"
            self._say_once(f"warning: a client was hung up on: {text}")
            self.hang_up(holder, text, holder.framer.unfinished_id())

    def _set_held(self, connection: Connection, buffered_bytes: int) -> None:
        self._held_in_all += buffered_bytes - self._held_bytes.pop(connection, 0)
        if buffered_bytes:
            self._held_bytes[connection] = buffered_bytes

    def hang_up(self, connection: Connection, text: str, message_id: int | None) -> None:
        """Disconnect a client; its pending request is answered with `text` if the socket takes that at once."""
        if connection.open and message_id is not None and not connection.unsent:
            with contextlib.suppress(OSError):
                connection.socket.send(rpc.pack_response(message_id, text, None))
        self.drop(connection)

    def drop(self, connection: Connection) -> None:
        """Disconnect a client; its flight command continues."""
        if connection.open:
            connection.open = False
            connection.unsent.clear()
            connection.request = connection.begun = None
            self._set_held(connection, 0)
            if connection.socket in self._selector.get_map():
                self._selector.unregister(connection.socket)
            connection.socket.close()
            self.connected.discard(connection)

    def close(self) -> None:
        """Disconnect all clients, and stop listening."""
        for connection in list(self.connected):
            self.drop(connection)
        self._selector.close()
        self._listener.close()
