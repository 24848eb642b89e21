"""The free-running server: one thread that advances the simulation, answers what has arrived, and sleeps.

It wakes for a message, for the next thing that ends, and often enough in between that little is left to fly when
something ends. Who is connected, and what is kept for them, is `uavaccel.wire.clients`'s.
"""

from __future__ import annotations

import selectors
from collections.abc import Callable
from typing import IO

from uavaccel.clock import MonotonicClock, ask_for_fine_timers
from uavaccel.sim.deferred_reply import DeferredReply
from uavaccel.sim.simulation import Simulation
from uavaccel.wire import rpc
from uavaccel.wire.api import Api
from uavaccel.wire.calls import Steps
from uavaccel.wire.clients import MAX_ANSWER_BYTES, Answer, Clients, Connection
from uavaccel.wire.turns import Costs, Turns

IDLE_NS = 2_000_000  # an idle server advances at least so often: well within what `airsim` makes good
CHUNK_TICKS = 30  # ticks flown at a wake-up, about: 0.1 ms of computing
FINAL_NS = 60_000  # at the very last, look at the clock alone: sockets take as long to look at as two ticks
SPIN_NS = 1_000_000  # before something ends, poll instead of sleeping: a process wakes late
BUSY_NS = 200_000  # after a message, poll for the next one
MAX_UNPACKED, MAX_UNPACKED_BYTES = 8, 1 << 24  # answers that wait to be packed
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
        self.clients = Clients((host, port), self.clock, api.notices.once, stop_at_eof)
        self.address = self.clients.address
        self._costs = Costs(api.methods)
        self._turns: Turns[Connection] = Turns(self._expected_ns)
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
            while not (self._stopping or self.clients.ended):
                for connection, events in self.clients.wait(self._wake_ns(simulation)):
                    self._serve_socket(connection, events)
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
        self.clients.close()

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

    def _serve_socket(self, connection: Connection, events: int) -> None:
        if events & selectors.EVENT_WRITE:
            self._send(connection)
        if events & selectors.EVENT_READ and connection.asks:
            self.clients.watch(connection)  # it has not had its turn
        elif events & selectors.EVENT_READ and connection.open:
            self._read(connection)

    def _read(self, connection: Connection) -> None:
        if self.clients.receive(connection):
            self._busy_until_ns = connection.heard_ns + BUSY_NS
            self._ask_again(connection, begins=True)

    def _ask_again(self, connection: Connection, begins: bool = False) -> None:
        """Have it wait for its turn if it asks for something; hang up where no more can come of it."""
        if connection.open and connection.asks and connection.may_ask:
            self._turns.add(connection, begins)
        elif connection.open and connection.broken and not connection.asks:
            self._flush()  # what it asked for in good order before
            self.clients.hang_up(connection, str(connection.broken), connection.broken.message_id)
        else:
            self.clients.watch(connection)

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
                self.clients.note_held(connection)
                if steps.held_bytes <= MAX_ANSWER_BYTES:
                    return
                error = f"the answer would have more than {MAX_ANSWER_BYTES >> 20} MiB: ask for less at once"
        except rpc.RpcError as failure:
            error = str(failure)
        connection.begun = None
        self.clients.note_held(connection)
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
        """Send what is left of its answers; it may ask again once it has read enough of them."""
        self.clients.send(connection)
        self._ask_again(connection)
