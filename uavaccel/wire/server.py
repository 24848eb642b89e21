"""The free-running server: one thread that advances the simulation, answers what has arrived, and sleeps.

It wakes for a message, for the next thing that ends, and often enough in between that little is left to fly when
something ends. Bad bytes cost a client its own connection and nothing else.
"""

from __future__ import annotations

import selectors
import socket
from collections import deque
from collections.abc import Callable
from typing import IO

from uavaccel.clock import MonotonicClock, ask_for_fine_timers, wait_for_sockets
from uavaccel.errors import UserError
from uavaccel.sim.simulation import DeferredReply, Simulation
from uavaccel.wire import rpc
from uavaccel.wire.api import Api
from uavaccel.wire.connection import Answer, Connection
from uavaccel.wire.steps import Steps
from uavaccel.wire.transport import set_no_delay, set_quick_ack

IDLE_NS = 2_000_000  # an idle server advances at least so often: well within what `airsim` makes good
CHUNK_TICKS = 30  # ticks flown at a wake-up, about: 0.1 ms of computing
FINAL_NS = 60_000  # at the very last, look at the clock alone: sockets take as long to look at as two ticks
SPIN_NS = 1_000_000  # before something ends, poll instead of sleeping: a process wakes late
BUSY_NS = 200_000  # after a message, poll for the next one
READ_BYTES = 1 << 12
MAX_UNSENT_BYTES = 1 << 26
MAX_UNPACKED = 8  # answers that wait to be packed: one may be a recording of megabytes
MAX_CONNECTIONS = 512  # fewer than the files that a process may open
IDLE_LIMIT_NS = 10_000_000_000  # once there are so many, one that has been silent for so long makes room
ACCEPTED_AT_ONCE = 16  # newcomers per wake-up
TURN_NS = 3_000_000  # of wall time for the requests of one client, before the others have their turn


class Server:
    """Serves an `Api` on a listening socket. Raises UserError if the address is taken.

    `port` 0 lets the system choose; `address` says what became of it. The server ends when `stop_at_eof`, a readable
    file, comes to its end: so it does not outlive the process that holds the other end of a pipe.
    """

    def __init__(
        self, api: Api, host: str = "127.0.0.1", port: int = 41451, stop_at_eof: IO[bytes] | None = None
    ) -> None:
        self.api = api
        self.clock = MonotonicClock()
        if not 0 <= port < 1 << 16:
            raise UserError(f"port must be 0 to 65535, not {port}")
        try:
            self._listener = socket.create_server((host, port), backlog=MAX_CONNECTIONS)
        except OSError as error:
            reason = (error.strerror or str(error)).partition(" (while")[0]
            raise UserError(f"cannot listen on {host}:{port}: {reason}; choose another with --port") from None
        self.address: tuple[str, int] = self._listener.getsockname()[:2]
        self._listener.setblocking(False)
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._listener, selectors.EVENT_READ)
        if stop_at_eof is not None:
            self._selector.register(stop_at_eof, selectors.EVENT_READ)
        self._connections: set[Connection] = set()
        self._backlog: deque[Connection] = deque()  # those with requests that wait for their turn
        self._answers: list[Answer] = []
        self._busy_until_ns = 0
        self._stopping = False

    def serve(self, each_turn: Callable[[], None] = lambda: None) -> None:
        """Run until `stop`, or an exception such as KeyboardInterrupt; `each_turn` is called after every wake-up."""
        ask_for_fine_timers()
        simulation = self.api.simulation
        simulation.advance_to(self.clock.now_ns())
        try:
            while not self._stopping:
                for key, events in wait_for_sockets(self._selector, self._wake_ns(simulation)):
                    self._serve_socket(key, events)
                self._serve_backlog()
                self._wait_for_end(simulation)
                simulation.advance_to(self.clock.now_ns())
                self._flush()
                each_turn()
        finally:
            self.close()

    def _wait_for_end(self, simulation: Simulation) -> None:
        """If something is about to end, fly up to it tick by tick, so that the last one is all that is left then."""
        event = simulation.next_event_wall_ns(turns=False)
        while event is not None and event - FINAL_NS < (now := self.clock.now_ns()) < event:
            simulation.advance_to(now)

    def stop(self) -> None:
        """Let `serve` return after its present turn."""
        self._stopping = True

    def close(self) -> None:
        for connection in list(self._connections):
            self._drop(connection)
        self._selector.close()
        self._listener.close()

    def _wake_ns(self, simulation: Simulation) -> int:
        """The wall time to sleep to; in the past where polling is due."""
        now = self.clock.now_ns()
        if now < self._busy_until_ns or self._backlog:
            return now
        if simulation.paused:
            return now + IDLE_NS
        wake = min(now + IDLE_NS, simulation.pacer.wall_due(simulation.world.tick + CHUNK_TICKS))
        # waiting for every turn of a task would be polling
        event = simulation.next_event_wall_ns(turns=False)
        return wake if event is None else min(wake, event - SPIN_NS)

    def _serve_socket(self, key: selectors.SelectorKey, events: int) -> None:
        if key.fileobj is self._listener:
            for _ in range(ACCEPTED_AT_ONCE):
                self._accept()
        elif key.data is None:
            self.stop()  # the watched stream ended
        else:
            if events & selectors.EVENT_WRITE:
                self._send(key.data)
            if events & selectors.EVENT_READ and key.data.open:
                self._read(key.data)

    def _accept(self) -> None:
        try:
            raw, _ = self._listener.accept()
        except OSError:
            return  # it has gone again
        if len(self._connections) >= MAX_CONNECTIONS and not self._make_room():
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
            self._connections.add(connection)

    def _make_room(self) -> bool:
        """Drop the client that has been silent for longest, if that is long enough; say so, or that none was."""
        silent = min(
            (one for one in self._connections if one.idle), key=lambda one: one.heard_ns, default=None
        )
        silent_ns = 0 if silent is None else self.clock.now_ns() - silent.heard_ns
        if silent is None or silent_ns < IDLE_LIMIT_NS:
            self.api.notices.once(
                f"warning: {MAX_CONNECTIONS} clients are connected; others are turned away "
                f"until one of them has been silent for {IDLE_LIMIT_NS / 1e9:g} s"
            )
            return False
        self.api.notices.once(
            f"warning: {MAX_CONNECTIONS} clients are connected; those silent for more than "
            f"{IDLE_LIMIT_NS / 1e9:g} s make room for others"
        )
        self._drop(silent)
        return True

    def _read(self, connection: Connection) -> None:
        try:
            data = connection.socket.recv(READ_BYTES)
        except (BlockingIOError, InterruptedError):
            return
        except OSError:
            data = b""
        if not data:
            self._drop(connection)
            return
        connection.heard_ns = self.clock.now_ns()
        self._busy_until_ns = connection.heard_ns + BUSY_NS
        try:
            set_quick_ack(connection.socket)
            connection.requests.extend(map(rpc.parse_request, connection.decoder.messages(data)))
        except (rpc.ProtocolError, OSError):
            connection.broken = True
        self._serve_requests(connection)

    def _serve_requests(self, connection: Connection) -> None:
        """Answer what a client has asked for, for TURN_NS at most; what is left waits until the others had theirs.

        Nothing more is read from it before.
        """
        until_ns = self.clock.now_ns() + TURN_NS
        while connection.asks and connection.open:
            if connection.begun:
                self._go_on(connection, *connection.begun)
            else:
                self._handle(connection, connection.requests.popleft())
            if len(self._answers) >= MAX_UNPACKED:
                self._flush()  # it may ask and never read, and then is open no more
            if self.clock.now_ns() >= until_ns:
                break
        if connection.open and connection.asks:
            if not connection.in_backlog:
                connection.in_backlog = True
                self._backlog.append(connection)
                self._watch(connection)
        elif connection.open and connection.broken:
            self._flush()  # what it asked for in good order before
            self._drop(connection)

    def _serve_backlog(self) -> None:
        """One more turn for each client that was cut short."""
        for _ in range(len(self._backlog)):
            connection = self._backlog.popleft()
            connection.in_backlog = False
            if connection.open:
                self._serve_requests(connection)
                self._watch(connection)

    def _watch(self, connection: Connection) -> None:
        """Look out for what the socket can be used for now."""
        if not connection.open:
            return
        reading = 0 if connection.in_backlog else selectors.EVENT_READ
        writing = selectors.EVENT_WRITE if connection.unsent else 0
        before = self._selector.get_map().get(connection.socket)
        if before is not None and before.events == (reading | writing):
            return
        if before is not None:
            self._selector.unregister(connection.socket)
        if reading | writing:
            self._selector.register(connection.socket, reading | writing, connection)

    def _handle(self, connection: Connection, request: rpc.RpcRequest) -> None:
        wall_ns = self.clock.now_ns()
        self.api.simulation.advance_to(wall_ns)
        try:
            result, error = self.api.begin(request.method, request.params, wall_ns), None
        except rpc.RpcError as failure:
            result, error = None, str(failure)
        if isinstance(result, Steps):
            connection.begun = request, result
            return
        if request.message_id is None:
            return
        answer = Answer(connection, request.message_id, error, result)
        if isinstance(result, DeferredReply) and result.due_wall_ns is None:
            connection.waiting += 1
            result.on_due = lambda _: self._answer_late(answer)
        else:
            self._answers.append(answer)

    def _go_on(self, connection: Connection, request: rpc.RpcRequest, steps: Steps) -> None:
        """One more piece of a result; the answer, when it is whole."""
        error = None
        try:
            if self.api.go_on(steps, request.method, request.params):
                return
        except rpc.RpcError as failure:
            error = str(failure)
        connection.begun = None
        if request.message_id is not None:
            result = None if error else steps.made
            self._answers.append(Answer(connection, request.message_id, error, result))

    def _answer_late(self, answer: Answer) -> None:
        answer.connection.waiting -= 1
        self._answers.append(answer)

    def _flush(self) -> None:
        """Send what this turn has answered, in one packet per client.

        The last answer first: where a command and its continue-for end together, the client waits for the latter.
        """
        answered: set[Connection] = set()
        while self._answers:
            answer = self._answers.pop()
            if answer.connection.open:
                answer.connection.unsent += answer.pack()
                answered.add(answer.connection)
        for connection in answered:
            self._send(connection)

    def _send(self, connection: Connection) -> None:
        """Send what the socket takes now and the rest when it takes more; drop a client that never reads."""
        try:
            while connection.unsent:
                sent = connection.socket.send(connection.unsent)
                del connection.unsent[:sent]
        except BlockingIOError:
            pass
        except OSError:
            self._drop(connection)
            return
        if len(connection.unsent) > MAX_UNSENT_BYTES:
            self._drop(connection)
            return
        self._watch(connection)

    def _drop(self, connection: Connection) -> None:
        """Forget a client; a command of its own runs on."""
        if connection.open:
            connection.open = False
            connection.unsent.clear()
            connection.requests.clear()
            connection.begun = None
            if connection.socket in self._selector.get_map():
                self._selector.unregister(connection.socket)
            connection.socket.close()
            self._connections.discard(connection)
