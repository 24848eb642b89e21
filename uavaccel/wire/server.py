"""The free-running server: one thread that advances the simulation, answers requests, and sleeps.

It wakes for a message, for the end of the next command or continue-for, and often enough in between that few ticks are
left to fly then. `uavaccel.wire.clients` has the connections.
"""

from __future__ import annotations

import selectors
from collections.abc import Callable
from typing import IO

from uavaccel.clock import MonotonicClock, request_fine_timers
from uavaccel.sim.deferred_reply import DeferredReply
from uavaccel.sim.simulation import Simulation
from uavaccel.wire import rpc
from uavaccel.wire.api import Api
from uavaccel.wire.calls import PartialResult
from uavaccel.wire.clients import MAX_ANSWER_BYTES, Answer, Clients, Connection
from uavaccel.wire.fair_queue import DurationEstimates, FairQueue

IDLE_NS = 2_000_000  # an idle server advances at least this often: well within what `airsim` catches up
CHUNK_TICKS = 30  # ticks per wake-up, about: 0.1 ms of computing
FINAL_NS = 60_000  # just before an end only the clock is polled: polling sockets takes as long as two ticks
SPIN_NS = 1_000_000  # before an end, poll instead of sleeping: a process wakes late
BUSY_NS = 200_000  # after a message, poll for the next one
MAX_UNPACKED, MAX_UNPACKED_BYTES = 8, 1 << 24  # answers that wait to be packed
TURN_NS = 3_000_000  # wall time for one client's requests before the next client's
FLIGHT_NS = 5_000_000  # wall time for flying in a round: a slow machine would do nothing else
LONG_NS = 1_000_000  # a request expected to take longer is long
ROUND_NS = 10_000_000  # wall time for all clients' requests before the sockets are polled again


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
        self.clients = Clients((host, port), self.clock, api.notices.once, stop_at_eof)
        self.address = self.clients.address
        self._estimates = DurationEstimates(api.methods)
        self._queue: FairQueue[Connection] = FairQueue(self._expected_ns)
        self._answers: list[Answer] = []
        self._unpacked_bytes = 0
        self._round_end_ns = self._flown_ns = 0  # of wall time
        self._busy_until_ns = 0
        self._stopping = False

    def serve(self, each_turn: Callable[[], None] = lambda: None) -> None:
        """Run until `stop`, or an exception such as KeyboardInterrupt; `each_turn` is called after every wake-up."""
        request_fine_timers()
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
        """Just before a command or continue-for ends, fly tick by tick: only the last tick is left at its end."""
        event = simulation.next_event_wall_ns(turns=False)
        while event is not None and event - FINAL_NS < (now := self.clock.now_ns()) < event:
            simulation.advance_to(now)

    def stop(self) -> None:
        """Let `serve` return after the present wake-up."""
        self._stopping = True

    def close(self) -> None:
        self.clients.close()

    def _wake_ns(self, simulation: Simulation) -> int:
        """Return the wall time until which to sleep; in the past if it is time to poll."""
        now = self.clock.now_ns()
        if now < self._busy_until_ns or self._queue:
            return now
        if simulation.paused:
            return now + IDLE_NS
        wake = min(now + IDLE_NS, simulation.pacer.wall_due(simulation.world.tick + CHUNK_TICKS))
        # waking for every turn of a task would be polling
        event = simulation.next_event_wall_ns(turns=False)
        return wake if event is None else min(wake, event - SPIN_NS)

    def _serve_socket(self, connection: Connection, events: int) -> None:
        if events & selectors.EVENT_WRITE:
            self._send(connection)
        if events & selectors.EVENT_READ and connection.asks:
            self.clients.watch(connection)  # its request waits for a turn
        elif events & selectors.EVENT_READ and connection.open and self.clients.receive(connection):
            self._busy_until_ns = connection.heard_ns + BUSY_NS
            self._ask_again(connection, begins=True)

    def _ask_again(self, connection: Connection, begins: bool = False) -> None:
        """Queue a client that has a request; disconnect one whose stream is broken."""
        if connection.open and connection.asks and connection.may_request:
            self._queue.add(connection, begins)
        elif connection.open and connection.broken and not connection.asks:
            self._flush()  # the answers to its good requests
            self.clients.hang_up(connection, str(connection.broken), connection.broken.message_id)
        else:
            self.clients.watch(connection)

    def _serve_turns(self) -> None:
        """Serve the queued requests, least-served clients first, for ROUND_NS at most.

        Nothing more is read from a client whose request is queued, or that has many answers to read.
        """
        self._flown_ns = 0
        self._round_end_ns = self.clock.now_ns() + ROUND_NS
        while self._queue:
            connection = self._queue.next()
            if self._answers and self._expected_ns(connection) > LONG_NS:
                self._flush()  # finished answers do not wait for a long request
            self._serve_requests(connection)
            self._ask_again(connection)
            if self.clock.now_ns() >= self._round_end_ns:
                break

    def _serve_requests(self, connection: Connection) -> None:
        """Serve one request of a client; more of them, for TURN_NS at most, while no other client waits."""
        until_ns = self.clock.now_ns() + TURN_NS
        while connection.open and connection.asks and connection.may_request:
            if connection.begun:
                self._go_on(connection, *connection.begun)
            else:
                message, connection.request = connection.request, None
                self._handle(connection, message or b"")
                if not connection.broken:
                    connection.take_next()
            if self._unpacked_bytes > MAX_UNPACKED_BYTES or len(self._answers) >= MAX_UNPACKED:
                self._flush()  # the client may never read its answers
            if self._queue or self.clock.now_ns() >= until_ns:
                break

    def _fly(self) -> int:
        """Advance the simulation to now, unless the round has flown for FLIGHT_NS; returns its wall time."""
        begun_ns = self.clock.now_ns()
        if self._flown_ns < FLIGHT_NS:
            self.api.simulation.advance_to(begun_ns)
            self._flown_ns += self.clock.now_ns() - begun_ns
            self._round_end_ns += 2 * (self.clock.now_ns() - begun_ns)  # and as long for the waiting requests
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
        self._account(connection, request.method, False, begun_ns)  # without the flying, which is for all
        if isinstance(result, PartialResult):
            connection.begun = request, result
        elif request.message_id is not None:
            self._answer(Answer(connection, request.message_id, error, result))

    def _account(self, connection: Connection, method: str, piece: bool, begun_ns: int) -> None:
        took_ns = self.clock.now_ns() - begun_ns
        connection.served_ns += took_ns
        self._estimates.took(method, piece, took_ns)

    def _expected_ns(self, connection: Connection) -> int:
        """Return how long a client's next request is expected to take."""
        return self._estimates.expected_ns(connection.method, connection.begun is not None)

    def _answer(self, answer: Answer) -> None:
        result = answer.result
        if isinstance(result, DeferredReply) and result.due_wall_ns is None:
            answer.connection.waiting += 1
            result.on_due = lambda _: self._answer_late(answer)
        else:
            self._unpacked_bytes += rpc.bulk_bytes(result)
            self._answers.append(answer)

    def _go_on(self, connection: Connection, request: rpc.RpcRequest, partial: PartialResult) -> None:
        """Make one more item of a result; answer when it is complete."""
        error, begun_ns = None, self.clock.now_ns()
        try:
            if self.api.advance(partial, request.method, request.params):
                self._account(connection, request.method, True, begun_ns)
                self.clients.note_buffered(connection)
                if partial.buffered_bytes <= MAX_ANSWER_BYTES:
                    return
                error = f"the answer would have more than {MAX_ANSWER_BYTES >> 20} MiB: ask for less at once"
        except rpc.RpcError as failure:
            error = str(failure)
        connection.begun = None
        self.clients.note_buffered(connection)
        if request.message_id is not None and connection.open:
            self._answer(Answer(connection, request.message_id, error, None if error else partial.made))

    def _answer_late(self, answer: Answer) -> None:
        answer.connection.waiting -= 1
        self._answers.append(answer)

    def _flush(self) -> None:
        """Send the finished answers, in one packet per client.

        The last answer comes first: of a command and a continue-for that end together the client waits for the latter.
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
        """Send the rest of a client's answers; once it has read enough of them it is served again."""
        self.clients.send(connection)
        self._ask_again(connection)
