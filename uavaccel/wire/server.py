"""The free-running server: one thread that advances the simulation, answers requests, and sleeps.

It wakes for a message, for the end of the next command or continue-for, and often enough in between that few ticks are
left to fly then. What it has received by a wake-up is handled at that wall time, one request per client and turn.

For each of at most MOST_CLIENTS clients it keeps one request and the answers to what came before: a client that sends
faster than it is served, or does not read, waits in its own socket's buffers. One that sends bad bytes loses its own
connection and nothing else.
"""

from __future__ import annotations

import logging
import selectors
import socket
from collections.abc import Callable
from typing import IO

from uavaccel.clock import MonotonicClock, request_fine_timers, wait_for_sockets
from uavaccel.errors import UserError
from uavaccel.sim.simulation import DeferredReply, Simulation
from uavaccel.wire import rpc
from uavaccel.wire.api import Api

MOST_CLIENTS = 16
READ_BYTES = 1 << 12
IDLE_NS = 2_000_000  # an idle server advances at least this often: well within what `airsim` catches up
CHUNK_TICKS = 30  # ticks per wake-up, about: 0.1 ms of computing
FINAL_NS = 60_000  # just before an end only the clock is polled: polling sockets takes as long as two ticks
SPIN_NS = 1_000_000  # before an end, poll instead of sleeping: a process wakes late
BUSY_NS = 200_000  # after a message, poll for the next one
TURNS_NS = 3_000_000  # wall time for requests before the simulation flies and the sockets are polled again
_LOG = logging.getLogger(__name__)


class Connection:
    """One client: its stream of requests, and the answers that its socket has not taken yet."""

    def __init__(self, connection: socket.socket) -> None:
        self.socket = connection
        self.framer = rpc.Framer()
        self.request: bytes | None = None  # received, and waiting for its turn
        self.unsent = bytearray()

    def asks(self) -> bool:
        """Return whether it has a request that can be served now."""
        return self.request is not None and not self.unsent


def packed(message_id: int, error: str | None, result: object) -> bytes:
    """Return an answer's message; an error in place of a result that cannot be packed or is too long.

    A `DeferredReply` in it is due by now.
    """
    try:
        if isinstance(result, DeferredReply):
            result = result.encode(result.value)
        message = rpc.pack_response(message_id, error, result)
    except Exception as failure:
        _LOG.error("an answer cannot be packed", exc_info=failure)
        return rpc.pack_response(message_id, f"the answer cannot be packed: {failure}", None)
    if len(message) <= rpc.MAX_ANSWER_BYTES:
        return message
    text = f"the answer has {len(message) >> 20} MiB, more than {rpc.MAX_ANSWER_BYTES >> 20}: ask for less"
    return rpc.pack_response(message_id, text, None)


class Server:
    """Serves an `Api` on a listening socket. Raises UserError if the address is taken.

    With `port` 0 the system chooses one; `address` has it. The server stops at the end of the readable file
    `stop_at_eof`, so that it does not outlive the process at the other end of a pipe.
    """

    def __init__(
        self, api: Api, host: str = rpc.LOOPBACK, port: int = rpc.PORT, stop_at_eof: IO[bytes] | None = None
    ) -> None:
        self.api = api
        self.clock = MonotonicClock()
        if not 0 <= port < 1 << 16:
            raise UserError(f"port must be 0 to 65535, not {port}")
        try:
            self._listener = socket.create_server((host, port), backlog=MOST_CLIENTS)
        except OSError as error:
            reason = (error.strerror or str(error)).partition(" (while")[0]
            raise UserError(f"cannot listen on {host}:{port}: {reason}; choose another with --port") from None
        self.address: tuple[str, int] = self._listener.getsockname()[:2]
        self._listener.setblocking(False)
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._listener, selectors.EVENT_READ)
        if stop_at_eof is not None:
            self._selector.register(stop_at_eof, selectors.EVENT_READ)
        self.connected: list[Connection] = []
        self._answers: list[tuple[Connection, int, str | None, object]] = []
        self._busy_until_ns = 0
        self._stopping = False

    def serve(self, each_turn: Callable[[], None] = lambda: None) -> None:
        """Run until `stop`, or an exception such as KeyboardInterrupt; `each_turn` is called after every wake-up."""
        request_fine_timers()
        simulation = self.api.simulation
        simulation.advance_to(self.clock.now_ns())
        try:
            while not self._stopping:
                self._receive(self._wake_ns(simulation))
                # just before a command or continue-for ends, fly tick by tick: only the last one is left at its end
                event = simulation.next_event_wall_ns(turns=False)
                while event is not None and event - FINAL_NS < (now := self.clock.now_ns()) < event:
                    simulation.advance_to(now)
                simulation.advance_to(self.clock.now_ns())
                self._flush()
                # one request of each client, and again while there are others, for TURNS_NS and the last turn
                end_ns = self.clock.now_ns() + TURNS_NS
                while (asking := [each for each in self.connected if each.asks()]) and self.clock.now_ns() < end_ns:
                    for connection in asking:
                        self._serve(connection)
                each_turn()
        finally:
            self.close()

    def stop(self) -> None:
        """Let `serve` return after the present wake-up."""
        self._stopping = True

    def close(self) -> None:
        """Disconnect all clients, and stop listening."""
        for connection in self.connected.copy():
            self._drop(connection)
        self._selector.close()
        self._listener.close()

    def _wake_ns(self, simulation: Simulation) -> int:
        """Return the wall time until which to sleep; in the past if it is time to poll."""
        now = self.clock.now_ns()
        if now < self._busy_until_ns or any(connection.asks() for connection in self.connected):
            return now
        if simulation.paused:
            return now + IDLE_NS
        wake = min(now + IDLE_NS, simulation.pacer.wall_due(simulation.world.tick + CHUNK_TICKS))
        # waking for every turn of a task would be polling
        event = simulation.next_event_wall_ns(turns=False)
        return wake if event is None else min(wake, event - SPIN_NS)

    # --- sockets ----------------------------------------------------------------------------------

    def _receive(self, until_ns: int) -> None:
        """Wait for sockets that are ready, until a wall time; read from them, or go on sending to them."""
        ready = wait_for_sockets(self._selector, until_ns)
        for key, events in sorted(ready, key=lambda each: each[0].data is None):  # who leaves makes room for others
            connection: Connection | None = key.data
            if key.fileobj is self._listener:
                self._accept()
            elif connection is None:
                self._stopping = True
            elif events & selectors.EVENT_WRITE:
                self._send(connection)
            elif connection.request is None:
                self._read(connection)

    def _accept(self) -> None:
        try:
            raw, _ = self._listener.accept()
        except OSError:  # it has disconnected again
            return
        if len(self.connected) >= MOST_CLIENTS:
            self.api.scenery.say_once(
                f"warning: {MOST_CLIENTS} clients are connected, as many as may be; one was refused"
            )
            raw.close()
            return
        try:
            raw.setblocking(False)
            rpc.set_no_delay(raw)
        except OSError:
            raw.close()
            return
        connection = Connection(raw)
        self._selector.register(raw, selectors.EVENT_READ, connection)
        self.connected.append(connection)

    def _read(self, connection: Connection) -> None:
        try:
            data = connection.socket.recv(READ_BYTES)
            rpc.set_quick_ack(connection.socket)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self._drop(connection)
            return
        self._busy_until_ns = self.clock.now_ns() + BUSY_NS
        self._take_next(connection, data)

    def _take_next(self, connection: Connection, data: bytes = b"") -> None:
        """Take the next whole request out of a stream, extended by `data`; hang up where that is impossible."""
        try:
            connection.request = connection.framer.next(data)
        except rpc.ProtocolError as error:
            self._hang_up(connection, error)

    def _send(self, connection: Connection) -> None:
        """Send as much as the socket takes now; the rest is sent when it becomes writable."""
        try:
            while connection.unsent:
                del connection.unsent[: connection.socket.send(connection.unsent)]
        except BlockingIOError:
            pass
        except OSError:
            self._drop(connection)
            return
        events = selectors.EVENT_WRITE if connection.unsent else selectors.EVENT_READ
        if events != self._selector.get_key(connection.socket).events:
            self._selector.modify(connection.socket, events, connection)

    def _hang_up(self, connection: Connection, error: rpc.ProtocolError) -> None:
        """Disconnect a client; its broken request is answered if the socket takes that at once."""
        if error.message_id is not None and not connection.unsent:
            connection.unsent += rpc.pack_response(error.message_id, str(error), None)
            self._send(connection)
        self._drop(connection)

    def _drop(self, connection: Connection) -> None:
        """Disconnect a client; its flight command continues."""
        if connection in self.connected:
            self.connected.remove(connection)
            connection.request = None
            self._selector.unregister(connection.socket)
            connection.socket.close()

    # --- requests ---------------------------------------------------------------------------------

    def _serve(self, connection: Connection) -> None:
        if not connection.asks():  # any more: it may have been disconnected
            return
        message, connection.request = connection.request or b"", None
        try:
            request = rpc.unpack_request(message)
        except rpc.ProtocolError as failure:
            self._hang_up(connection, failure)
            return
        try:
            result, error = self.api.call(request.method, request.params, self.api.simulation.wall_ns), None
        except rpc.RpcError as failure:
            result, error = None, str(failure)
        if request.message_id is not None:
            answer = connection, request.message_id, error, result
            if isinstance(result, DeferredReply) and result.due_wall_ns is None:
                result.on_due = lambda _: self._answers.append(answer)
            else:
                self._answers.append(answer)
        self._flush()
        if connection in self.connected:
            self._take_next(connection)

    def _flush(self) -> None:
        """Send the finished answers, in one packet per client.

        The last answer comes first: of a command and a continue-for that end together the client waits for the latter.
        """
        if not self._answers:
            return
        while self._answers:
            connection, number, error, result = self._answers.pop()
            connection.unsent += packed(number, error, result)
        for connection in self.connected.copy():
            self._send(connection)
