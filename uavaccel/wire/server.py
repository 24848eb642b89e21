"""The free-running server: one thread that advances the simulation, answers what has arrived, and sleeps.

It wakes for a message, for the next thing that ends, and often enough in between that little is left to fly when
something ends. Bad bytes cost a client its own connection and nothing else.
"""

from __future__ import annotations

import contextlib
import selectors
import socket
from collections.abc import Callable
from typing import IO

from uavaccel.clock import MonotonicClock, ask_for_fine_timers, wait_for_sockets
from uavaccel.errors import UserError
from uavaccel.sim.simulation import DeferredReply, Simulation
from uavaccel.wire import rpc
from uavaccel.wire.api import Api
from uavaccel.wire.connection import Answer, Connection
from uavaccel.wire.held import MAX_ANSWER_BYTES, Held
from uavaccel.wire.steps import Steps
from uavaccel.wire.transport import set_no_delay, set_quick_ack
from uavaccel.wire.turns import Costs, Turns

IDLE_NS = 2_000_000  # an idle server advances at least so often: well within what `airsim` makes good
CHUNK_TICKS = 30  # ticks flown at a wake-up, about: 0.1 ms of computing
FINAL_NS = 60_000  # at the very last, look at the clock alone: sockets take as long to look at as two ticks
SPIN_NS = 1_000_000  # before something ends, poll instead of sleeping: a process wakes late
BUSY_NS = 200_000  # after a message, poll for the next one
READ_BYTES = 1 << 12
MAX_UNPACKED, MAX_UNPACKED_BYTES = 8, 1 << 24  # answers that wait to be packed
MAX_CONNECTIONS = 512  # fewer than the files that a process may open
IDLE_LIMIT_NS = 10_000_000_000  # once there are so many, one that has been silent for so long makes room
ACCEPTED_AT_ONCE = 16  # newcomers per wake-up
TURN_NS = 3_000_000  # of wall time for the requests of one client, before the others have their turn
FLIGHT_NS = 5_000_000  # of a round, for flying: a machine that does not keep up would do nothing else
LONG_NS = 1_000_000  # of a request
ROUND_NS = 10_000_000  # for those of all, before sockets are looked at again


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
        self._costs = Costs(api.methods)
        self._turns: Turns[Connection] = Turns(self._expected_ns)
        self._held: Held[Connection] = Held()
        self._answers: list[Answer] = []
        self._unpacked_bytes = 0
        self._round_end_ns = self._flown_ns = 0  # of wall time
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
                self._serve_turns()
                self._wait_for_end(simulation)
                self._fly()
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
        if now < self._busy_until_ns or self._turns:
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
            if events & selectors.EVENT_READ and key.data.asks:
                self._watch(key.data)  # it has not had its turn
            elif events & selectors.EVENT_READ and key.data.open:
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
        except OSError:  # gone again
            self._drop(connection)
            return
        connection.take_next(data)
        self._note_held(connection)
        self._ask_again(connection, begins=True)

    def _ask_again(self, connection: Connection, begins: bool = False) -> None:
        """Have it wait for its turn if it asks for something; hang up where no more can come of it."""
        if connection.open and connection.asks and connection.may_ask:
            self._turns.add(connection, begins)
        elif connection.open and connection.broken and not connection.asks:
            self._flush()  # what it asked for in good order before
            self._hang_up(connection, str(connection.broken), connection.broken.message_id)
        else:
            self._watch(connection)

    def _serve_turns(self) -> None:
        """Answer what clients have asked for, those first who had least; after ROUND_NS sockets are looked at again.

        Of a client that has not had its turn, or that has much to read, nothing more is read before.
        """
        self._flown_ns = 0
        self._round_end_ns = self.clock.now_ns() + ROUND_NS
        while self._turns:
            connection = self._turns.next()
            if self._answers and self._expected_ns(connection) > LONG_NS:
                self._flush()  # what is done need not wait for that
            self._serve_requests(connection)
            self._ask_again(connection)
            if self.clock.now_ns() >= self._round_end_ns:
                break

    def _serve_requests(self, connection: Connection) -> None:
        """One request of a client; more, for TURN_NS at most, while nobody else asks for anything."""
        until_ns = self.clock.now_ns() + TURN_NS
        while connection.open and connection.asks and connection.may_ask:
            if connection.begun:
                self._go_on(connection, *connection.begun)
            else:
                message, connection.request = connection.request, None
                self._handle(connection, message or b"")
                if not connection.broken:
                    connection.take_next()
            if self._unpacked_bytes > MAX_UNPACKED_BYTES or len(self._answers) >= MAX_UNPACKED:
                self._flush()  # it may ask and never read
            if self._turns or self.clock.now_ns() >= until_ns:
                break

    def _watch(self, connection: Connection) -> None:
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

    def _fly(self) -> int:
        """Up to now; in a round that has flown for FLIGHT_NS no further. The wall time up to which it was."""
        begun_ns = self.clock.now_ns()
        if self._flown_ns < FLIGHT_NS:
            self.api.simulation.advance_to(begun_ns)
            self._flown_ns += self.clock.now_ns() - begun_ns
            self._round_end_ns += 2 * (self.clock.now_ns() - begun_ns)  # and as long for those who waited
        return self.api.simulation.wall_ns

    def _handle(self, connection: Connection, message: bytes) -> None:
        wall_ns = self._fly()
        begun_ns = self.clock.now_ns()
        try:
            request = rpc.unpack_request(message)
        except rpc.ProtocolError as failure:
            connection.broken = failure
            return
        try:
            result, error = self.api.begin(request.method, request.params, wall_ns), None
        except rpc.RpcError as failure:
            result, error = None, str(failure)
        self._account(connection, request.method, False, begun_ns)  # not what was flown: that is for all
        if isinstance(result, Steps):
            connection.begun = request, result
        elif request.message_id is not None:
            self._answer(Answer(connection, request.message_id, error, result))

    def _account(self, connection: Connection, method: str, piece: bool, begun_ns: int) -> None:
        took_ns = self.clock.now_ns() - begun_ns
        connection.served_ns += took_ns
        self._costs.took(method, piece, took_ns)

    def _expected_ns(self, connection: Connection) -> int:
        """How long what a client asks for next will take."""
        return self._costs.expected_ns(connection.method, connection.begun is not None)

    def _answer(self, answer: Answer) -> None:
        result = answer.result
        if isinstance(result, DeferredReply) and result.due_wall_ns is None:
            answer.connection.waiting += 1
            result.on_due = lambda _: self._answer_late(answer)
        else:
            self._unpacked_bytes += rpc.bulk_bytes(result)
            self._answers.append(answer)

    def _go_on(self, connection: Connection, request: rpc.RpcRequest, steps: Steps) -> None:
        """One more piece of a result; the answer, when it is whole."""
        error, begun_ns = None, self.clock.now_ns()
        try:
            if self.api.go_on(steps, request.method, request.params):
                self._account(connection, request.method, True, begun_ns)
                self._note_held(connection)
                if steps.held_bytes <= MAX_ANSWER_BYTES:
                    return
                error = f"the answer would have more than {MAX_ANSWER_BYTES >> 20} MiB: ask for less at once"
        except rpc.RpcError as failure:
            error = str(failure)
        connection.begun = None
        self._note_held(connection)
        if request.message_id is not None and connection.open:
            self._answer(Answer(connection, request.message_id, error, None if error else steps.made))

    def _answer_late(self, answer: Answer) -> None:
        answer.connection.waiting -= 1
        self._answers.append(answer)

    def _flush(self) -> None:
        """Send what this turn has answered, in one packet per client.

        The last answer first: where a command and its continue-for end together, the client waits for the latter.
        """
        answered: set[Connection] = set()
        self._unpacked_bytes = 0
        while self._answers:
            answer = self._answers.pop()
            if answer.connection.open:
                answer.connection.unsent += answer.pack()
                answered.add(answer.connection)
        for connection in answered:
            self._send(connection)

    def _send(self, connection: Connection) -> None:
        """Send what the socket takes now; the rest, and more, when it takes more."""
        try:
            while connection.unsent:
                sent = connection.socket.send(connection.unsent)
                del connection.unsent[:sent]
        except BlockingIOError:
            pass
        except OSError:
            self._drop(connection)
            return
        self._note_held(connection)
        self._watch(connection)
        self._ask_again(connection)

    def _note_held(self, connection: Connection) -> None:
        """Account for what is kept for a client; hang up on who holds most where that is too much for all together."""
        self._held.note(connection, connection.held_bytes if connection.open else 0)
        while overdrawn := self._held.overdrawn_by():
            holder, held_bytes = overdrawn
            text = f"{held_bytes >> 20} MiB are kept for this client, and too much for all together"
            self.api.notices.once(f"warning: a client was hung up on: {text}")
            self._hang_up(holder, text, holder.framer.unfinished_id())

    def _hang_up(self, connection: Connection, text: str, message_id: int | None) -> None:
        """Drop a client; tell it why, if it waits for an answer and takes it at once."""
        if connection.open and message_id is not None and not connection.unsent:
            with contextlib.suppress(OSError):
                connection.socket.send(rpc.pack_response(message_id, text, None))
        self._drop(connection)

    def _drop(self, connection: Connection) -> None:
        """Forget a client; a command of its own runs on."""
        if connection.open:
            connection.open = False
            connection.unsent.clear()
            connection.request = connection.begun = None
            self._held.note(connection, 0)
            if connection.socket in self._selector.get_map():
                self._selector.unregister(connection.socket)
            connection.socket.close()
            self._connections.discard(connection)
