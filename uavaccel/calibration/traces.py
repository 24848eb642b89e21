"""Traces of the messages of a command, from both ends of the wire, for calibration and the trellis of Figure 4."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from uavaccel.commands import COMMANDS, VelocityGoal
from uavaccel.files import Plain
from uavaccel.units import NS_PER_S
from uavaccel.wire.client import Client
from uavaccel.wire.session import Session
from uavaccel.wire.transport import PendingCall, Transport

Event = dict[str, Plain]


class ClientEvent(NamedTuple):
    """An event at the client's end: `kind` is "call", "issued" (sent without waiting) or "return"."""

    kind: str
    method: str
    channel: str
    wall_ns: int
    coalesced: bool = False
    """Whether it travels with the next one."""


class TracingTransport(Transport):
    """A transport that records when the client calls, when it continues, and when it has its reply."""

    def __init__(self, inner: Transport) -> None:
        super().__init__(inner.clock, exclusive=False)
        self.known = inner.known
        self.events: list[ClientEvent] = []
        self._inner = inner

    def send(self, method: str, params: Sequence[object], blocking: bool, coalesced: bool = False) -> PendingCall:
        called_ns = self.clock.now_ns()
        call = self._inner.send(method, params, blocking, coalesced)
        self.events.append(ClientEvent("call", method, call.channel, called_ns, coalesced))
        if not blocking:
            self.events.append(ClientEvent("issued", method, call.channel, self.clock.now_ns(), coalesced))
        return call

    def wait(self, call: PendingCall, deadline_ns: int | None = None) -> bool:
        done = self._inner.wait(call, deadline_ns)
        if done:
            self.events.append(ClientEvent("return", call.method, call.channel, self.clock.now_ns()))
        return done

    def close(self) -> None:
        self._inner.close()


def record_trace(session: Session, command_name: str, clock_speed: float, t_move_s: float) -> list[Event]:
    """Return the messages of the second of two commands, in time order; the first one warms both ends up."""
    client = session.start_game(clock_speed, np.random.SeedSequence(0))
    command = COMMANDS[command_name]
    command.begin(client)
    for _ in command.fly(client, VelocityGoal((1.0, 0.0, 0.0)), t_move_s, t_move_s):
        pass
    tracing = TracingTransport(client.transport)
    client.trace(True)
    for _ in command.fly(Client(tracing, clock_speed), VelocityGoal((1.0, 0.0, 0.0)), t_move_s, t_move_s):
        pass
    return _merge(tracing.events, [event for event in client.trace(False) if "uavaccelTrace" not in event[0]])


def _merge(client: Sequence[ClientEvent], server: Sequence[tuple[str, int, int]]) -> list[Event]:
    """Merge both ends' events by wall time; the simulated time of a client's event is that of the server's last."""
    events: list[tuple[int, str, str, int | None]] = [
        (event.wall_ns, "client", f"{event.kind} {event.method}", None) for event in client if event.kind != "issued"
    ]
    events += [(wall, "server", event, simulated) for event, wall, simulated in server]
    events.sort(key=lambda event: event[0])
    simulated_ns = min((event[2] for event in server), default=0)
    merged = []
    for wall_ns, source, name, now_ns in events:
        simulated_ns = simulated_ns if now_ns is None else now_ns
        merged.append({"source": source, "event": name, "wall_s": wall_ns / NS_PER_S, "sim_s": simulated_ns / NS_PER_S})
    return merged
