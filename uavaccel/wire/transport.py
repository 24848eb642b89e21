"""The two transports from a client to a simulation: a socket to a server's process, and in-process calls under a
simulated wall clock. The process is watched: whether it responds is seen, and it is ended in any state.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import socket
import struct
import subprocess
from abc import ABC, abstractmethod
from collections.abc import Sequence

from uavaccel.clock import MonotonicClock, VirtualClock, WallClock, wait_for_sockets
from uavaccel.errors import UserError
from uavaccel.kinematics import Kinematics
from uavaccel.processes.lifetime import end_within, single_core_rendering, start_python
from uavaccel.processes.stalls import FIRST_POLLS, StallDetector
from uavaccel.sim.simulation import DeferredReply, Simulation
from uavaccel.sim.world import World
from uavaccel.units import NS_PER_S
from uavaccel.wire import rpc
from uavaccel.wire.api import CALLS, Api
from uavaccel.wire.broadcast import show_on_page
from uavaccel.wire.latency import DEFAULT, Channel, Latency
from uavaccel.wire.rpc import ServerGoneError

START_S = 600.0  # to compile the hot loop
SILENT_POLLS = 2  # a server that is silent and uses no CPU for so many seconds has been stopped, or waits for ever
BUSY_S = 60.0  # longest silence of a busy server: its first picture, drawn in software on a loaded machine
END_S = 3.0
SILENCE_POLL_NS = 1_000_000_000  # silence after which the server is pinged
STALL_NS = 100_000_000  # a responsive server answers a ping sooner
POLL_NS = 1_000_000
AT_ONCE = {"pause", "continue", "state"}  # channels whose calls keep a server busy for microseconds


class WatchedServer:
    """A process of uavaccel.wire.service, listening on `port`.

    Raises UserError for a scene that cannot be flown in, and ServerGoneError if it never listens.
    """

    def __init__(self, options: dict[str, object]) -> None:
        self._clock = MonotonicClock()
        self._process = start_python(
            *("-m", "uavaccel.wire.service", json.dumps({**options, "parent": os.getpid()})),
            environment=single_core_rendering(),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        self.pid = self._process.pid
        self.answered()
        try:
            told = json.loads(self._first_line())
            if "error" in told:
                raise UserError(told["error"])
            self.port: int = told["port"]
        except BaseException:
            self._process.kill()  # it does not heed the end of its standard input before it listens
            self.end()
            raise

    @property
    def returncode(self) -> int | None:
        return self._process.returncode

    def answered(self) -> None:
        """Count its silence from now on."""
        self._detector, self._heard_ns = StallDetector(), self._clock.now_ns()

    def check(self, idle_polls: int = SILENT_POLLS, busy_s: float = BUSY_S) -> None:
        """Raise ServerGoneError if it has ended, is stopped, or was idle at so many calls, or silent for `busy_s`.

        To be called about once a second while an answer is overdue.
        """
        status = self._process.poll()
        if status is not None:
            raise ServerGoneError(f"the server's process ended with status {status}")
        silent_ns = self._clock.now_ns() - self._heard_ns
        if self._detector.poll([self.pid], idle_polls) or silent_ns > busy_s * NS_PER_S:
            self._process.kill()  # it would not end by itself
            raise ServerGoneError(f"the server's process did not answer for {silent_ns / NS_PER_S:.1f} s")

    def _first_line(self) -> bytes:
        stdout = self._process.stdout
        assert stdout is not None
        while not select.select([stdout], [], [], 1.0)[0]:
            self.check(FIRST_POLLS, START_S)
        line = stdout.readline()
        if not line:
            raise ServerGoneError(f"the server's process ended with status {self._process.wait()} before it listened")
        return line

    def end(self) -> None:
        """End it by closing its standard input, or by force."""
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                pipe.close()
        end_within(self._process, END_S)


class PendingCall(rpc.Future):
    """A call that a client has sent over a transport, which waits for its answer."""

    def __init__(self, method: str, params: Sequence[object]) -> None:
        super().__init__(method)
        known = CALLS.get(method)
        self.channel: Channel = DEFAULT if known is None else known.channel_of(params)
        self.deferred: DeferredReply | None = None
        self.handled_ns = 0
        self.reply_wall_ns: int | None = None
        self.sent_ns = 0
        self.expected_ns: int | None = None  # when the client expects the answer

    def due_ns(self) -> int | None:
        """Return when a responsive server has answered, on the client's clock; None where that is unknown."""
        if self.channel in AT_ONCE:
            return self.sent_ns
        return self.expected_ns if self.channel == "continue_for" else None

    def ended_early(self) -> bool:
        """Return whether a later call, such as a new command, has ended what nobody has waited for to its end."""
        return self.deferred is not None and self.deferred.due_wall_ns is not None and self.reply_wall_ns is None


class KnownState:
    """The paused simulation's `state` as far as its connection knows it; all clients of the connection share it.

    There is no other connection. So the state in which a continue-for left the simulation stays the present one until
    a call is sent that may change it, and need not be requested.
    """

    state: Kinematics | None = None

    def sending(self, method: str) -> None:
        """Forget the state if the call that is about to be sent may change it."""
        if (called := CALLS.get(method)) is None or not called.leaves_state:
            self.state = None


class Transport(ABC):
    """One connection: sends calls in order, and waits for replies in any order."""

    stalled_ns = 0
    """Wall time for which a server did not answer, since it was last set to 0.

    A delay of 0.1 s is noticed in calls that take no simulated time and after the end of a continue-for, one of 1 s in
    all others.
    """

    def __init__(self, clock: WallClock) -> None:
        self.clock = clock
        self.known = KnownState()

    @abstractmethod
    def send(self, method: str, params: Sequence[object], blocking: bool, coalesced: bool = False) -> PendingCall:
        """Send a call; `blocking` means that the caller waits for its reply at once.

        A `coalesced` call may be sent together with the next: for a caller who knows that nothing happens before.
        """

    @abstractmethod
    def wait(self, call: PendingCall, deadline_ns: int | None = None) -> bool:
        """Wait for the reply; False if the wall deadline passes first."""

    def close(self) -> None:  # noqa: B027  nothing to release, unless there is a socket
        """Release the connection."""


class SocketTransport(Transport):
    """msgpack-rpc over TCP to a server of this machine. All raises ServerGoneError if that has gone."""

    def __init__(self, server: WatchedServer) -> None:
        super().__init__(MonotonicClock())
        self._server = server
        self._ping: PendingCall | None = None
        self._asked_ns = self._counted_ns = 0
        try:
            self._rpc: rpc.RpcSocket[PendingCall] = rpc.RpcSocket(rpc.LOOPBACK, server.port)
        except ConnectionError as error:
            raise ServerGoneError(str(error)) from None
        interval = struct.pack("ll", SILENCE_POLL_NS // NS_PER_S, 0)  # a wait without a deadline wakes now and then
        self._rpc.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, interval)
        self._unsent = b""

    def send(self, method: str, params: Sequence[object], blocking: bool, coalesced: bool = False) -> PendingCall:
        self.known.sending(method)
        call = PendingCall(method, params)
        call.sent_ns = self.clock.now_ns()
        self._unsent += self._rpc.request(call, method, params)
        if not coalesced:
            self._flush()
        return call

    def _flush(self) -> None:
        if self._unsent:
            unsent, self._unsent = self._unsent, b""
            try:
                self._rpc.socket.sendall(unsent)
            except ConnectionError as error:
                raise ServerGoneError(f"the server closed the connection: {error}") from None

    def wait(self, call: PendingCall, deadline_ns: int | None = None) -> bool:
        self._flush()
        if (expected_ns := call.expected_ns) is not None:  # poll around it: a sleeping process wakes late
            last_ns = expected_ns + POLL_NS if deadline_ns is None else min(expected_ns + POLL_NS, deadline_ns)
            while not call.done and self.clock.now_ns() < last_ns:
                if self._readable(min(expected_ns - POLL_NS, last_ns)):
                    self._receive()
        while not call.done:
            if deadline_ns is None or self._readable(deadline_ns):
                self._receive()
            elif self.clock.now_ns() >= deadline_ns:
                return False
        return True

    def _readable(self, deadline_ns: int) -> bool:
        """Wait until something arrives, or for the deadline, or to ask a silent server whether it is there."""
        look_ns = self.clock.now_ns() + SILENCE_POLL_NS
        if deadline_ns < look_ns:
            return bool(wait_for_sockets(self._rpc.selector, deadline_ns))
        if wait_for_sockets(self._rpc.selector, look_ns):
            return True
        self._look()
        return False

    def _receive(self) -> None:
        try:
            answered = self._rpc.receive()
        except BlockingIOError:  # nothing for SILENCE_POLL_NS
            self._look()
            return
        except ConnectionError as error:
            raise ServerGoneError(str(error)) from None
        self._count_silence([call.due_ns() for call in answered])

    def _look(self) -> None:
        """Ping the server after SILENCE_POLL_NS of silence; later see whether its process has gone."""
        if self._ping is not None:
            self._server.check()
        else:
            self._server.answered()
            self._ping, self._asked_ns = self.send("ping", (), blocking=True), self.clock.now_ns()

    def _count_silence(self, due_ns: Sequence[int | None]) -> None:
        """When answers arrive, add for how long the server had not responded; a server that only flies answers pings.

        `due_ns` are the times at which these answers were due. No wall time is counted twice.
        """
        since = [due for due in due_ns if due is not None]
        if self._ping is not None and self._ping.done:
            self._ping = None
            since.append(self._asked_ns)
        now_ns = self.clock.now_ns()
        silent_ns = now_ns - max(min(since, default=now_ns), self._counted_ns)
        if silent_ns > STALL_NS:
            self._counted_ns = now_ns
            self.stalled_ns += silent_ns

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self._flush()
        self._rpc.close()


class VirtualTransport(Transport):
    """Calls an `Api` in the same process, and advances its simulated wall clock as the latency model says."""

    def __init__(self, api: Api, clock: VirtualClock, latency: Latency) -> None:
        super().__init__(clock)
        self._api = api
        self._latency = latency
        self._handled_ns = clock.now_ns()
        self._unanswered: PendingCall | None = None  # the last command sent without waiting

    def send(self, method: str, params: Sequence[object], blocking: bool, coalesced: bool = False) -> PendingCall:
        self.known.sending(method)
        call = PendingCall(method, params)
        arrival = max(self.clock.now_ns() + self._latency.request_ns(call.channel), self._let_through_ns())
        self._run_to(arrival)
        try:
            value = self._api.call(method, params, self._handled_ns)
        except rpc.RpcError as error:
            call.error, value = str(error), None
        call.handled_ns = self._handled_ns
        if isinstance(value, DeferredReply):
            call.deferred = value
        else:
            call.result = value
            ready_ns = self._handled_ns
            if call.channel == "image":
                ready_ns = self._api.simulation.frames.ready_ns(ready_ns)
            call.reply_wall_ns = ready_ns + self._latency.reply_ns(call.channel)
        if not blocking:
            self._unanswered = call
            self.clock.charge(self._latency.issue_ns())
        return call

    def wait(self, call: PendingCall, deadline_ns: int | None = None) -> bool:
        if call.deferred is not None and not self._run_until_due(call, call.deferred, deadline_ns):
            return False
        reply = call.reply_wall_ns or 0
        if deadline_ns is not None and reply > deadline_ns:
            self.clock.sleep_until(deadline_ns)
            return False
        self.clock.sleep_until(reply)
        call.done = True
        return True

    def catch_up(self) -> None:
        """Advance the simulation to the clock's present, as the next message would."""
        self._run_to(self.clock.now_ns())

    def _let_through_ns(self) -> int:
        """Return when Nagle's algorithm on a modelled socket releases a request after an unanswered command.

        It waits for the answer or for the server's delayed acknowledgement, which `stall_us` models.
        """
        call, stall_ns = self._unanswered, self._latency.stall_ns
        if not stall_ns or call is None:
            return 0
        acknowledged_ns = call.handled_ns + stall_ns
        if call.deferred is None or (answered_ns := call.deferred.due_wall_ns) is None:
            return acknowledged_ns
        return min(acknowledged_ns, answered_ns)

    def _run_until_due(self, call: PendingCall, deferred: DeferredReply, deadline_ns: int | None) -> bool:
        simulation = self._api.simulation
        while deferred.due_wall_ns is None:
            due = simulation.next_event_wall_ns()
            if deadline_ns is not None and (due is None or due > deadline_ns):
                self.clock.sleep_until(deadline_ns)
                return False
            if due is None:
                raise RuntimeError(f"{call.method} would wait for ever: the simulation is paused")
            self._run_to(due)
        if call.reply_wall_ns is None:
            self._latency.waited(deferred.due_wall_ns - call.handled_ns)
            call.result = deferred.encode(deferred.value)
            call.reply_wall_ns = deferred.due_wall_ns + self._latency.reply_ns(call.channel)
        return True

    def _run_to(self, wall_ns: int) -> None:
        """Advance the simulation to a wall time; a wall timer before it ends exactly, as its lateness is included."""
        simulation = self._api.simulation
        self._handled_ns = max(self._handled_ns, wall_ns)  # one socket keeps its order
        timer = simulation.wall_timer_ns()
        if timer is not None and timer <= self._handled_ns:
            simulation.advance_to(timer)
        simulation.advance_to(self._handled_ns)


def modelled_simulation(world: World, clock_speed: float, latency: Latency) -> Simulation:
    """Start a settled hover, the clock running and API control off, on the simulator side that `latency` models."""
    platform = latency.platform
    simulation = Simulation(
        world,
        clock_speed,
        timer_lateness_ns=latency.timer_ns,
        executor=platform.executor(),
        frames=platform.new_frames(latency.frame_ns),
    )
    show_on_page(simulation, may_pause=True)
    return simulation
