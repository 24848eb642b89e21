"""Calibration: latencies of messages between client and server on this machine, from which `virtual` samples.

Messages are timed on the machine's clock at both ends of the wire; trajectories play no part. They are the messages of
ADSC and TCSC, since the time in which an end wakes depends on what it did before.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from itertools import product
from typing import Literal

import numpy as np

from uavaccel.bench.traces import TracingTransport
from uavaccel.commands import COMMANDS, VelocityGoal
from uavaccel.files import Plain
from uavaccel.wire.client import Client
from uavaccel.wire.latency import QUANTILES, after_wait
from uavaccel.wire.session import WallSession

CLOCK_SPEEDS = (50.0, 100.0)
T_MOVES_S = (0.1, 0.2, 0.5, 1.0)  # at these speeds the ends sleep for 1 to 20 ms, as they do in DP1
BATCH = 24  # commands per reading of the server's trace
STAY = VelocityGoal((0.0, 0.0, 0.0))

Samples = dict[str, list[int]]


class Latencies:
    """Latencies in nanoseconds by channel, from which the block `latency` is made."""

    def __init__(self) -> None:
        self.request: Samples = defaultdict(list)
        self.reply: Samples = defaultdict(list)
        self.issue: list[int] = []
        self.timer: list[int] = []

    def add(self, samples: Samples, channel: str, wait_ns: int | None, latency_ns: int) -> None:
        """Add a latency to its channel, and to the channel after a wait of that length."""
        samples[channel].append(latency_ns)
        if wait_ns is not None:
            samples[after_wait(channel, wait_ns)].append(latency_ns)

    def block(self) -> dict[str, Plain]:
        """Return the YAML block `latency`."""
        return {
            "quantiles": list(QUANTILES),
            "request_us": {name: quantiles_us(self.request[name]) for name in sorted(self.request)},
            "reply_us": {name: quantiles_us(self.reply[name]) for name in sorted(self.reply)},
            "issue_us": quantiles_us(self.issue),
            **({"timer_us": quantiles_us(self.timer)} if self.timer else {}),
        }

    def counts(self) -> str:
        request, reply = (
            sum(len(each) for name, each in samples.items() if "@" not in name)
            for samples in (self.request, self.reply)
        )
        return f"{request} requests, {reply} replies, {len(self.issue)} issues, {len(self.timer)} wall timers"


def quantiles_us(samples_ns: Sequence[int]) -> list[float]:
    """Return quantiles of samples in ns, in microseconds, rounded to a tenth."""
    return [round(float(value) / 1e3, 1) for value in np.quantile(samples_ns, QUANTILES)]


def calibrate(profile: str, commands: int, images: bool) -> Latencies:
    """Fly about `commands` commands of each kind on this machine's clock, and return the latencies of their messages.

    With `images` as many images of the lane are requested too, rendering included; raises rpc.RpcError without OpenGL.
    """
    latencies = Latencies()
    batches = max(
        round(commands / BATCH / (len(CLOCK_SPEEDS) * len(T_MOVES_S))), 1
    )  # of each command, in each cell
    with WallSession("blocks", profile) as session:
        for name, clock_speed, t_move_s, _ in product(
            sorted(COMMANDS), CLOCK_SPEEDS, T_MOVES_S, range(batches)
        ):
            client = session.start_game(clock_speed, np.random.SeedSequence(0))
            _fly_batch(client, name, t_move_s, latencies)
            _request(client, "ping", latencies)  # which stands for all calls without a channel of their own
    if images:
        _take_images(profile, commands, latencies)
    return latencies


def _fly_batch(client: Client, command_name: str, t_move_s: float, latencies: Latencies) -> None:
    command, tracing = COMMANDS[command_name], TracingTransport(client.transport)
    traced = Client(tracing, client.clock_speed)
    command.begin(client)
    client.trace(True)
    for _ in range(BATCH):
        for _ in command.fly(traced, STAY, t_move_s, t_move_s):
            pass
    _gather(tracing, client.trace(False), latencies)


def _take_images(profile: str, images: int, latencies: Latencies) -> None:
    with WallSession("lane", profile) as session:
        client = session.start_game(CLOCK_SPEEDS[0], np.random.SeedSequence(0), lane=0)
        client.image("gray")  # creates the GL context
        for _ in range(max(images // BATCH, 1)):
            _request(client, "image", latencies)


def _request(client: Client, what: Literal["ping", "image"], latencies: Latencies) -> None:
    tracing = TracingTransport(client.transport)
    traced = Client(tracing)
    client.trace(True)
    for _ in range(BATCH):
        traced.image("gray") if what == "image" else traced.call("ping")
    _gather(tracing, client.trace(False), latencies)


def _gather(tracing: TracingTransport, server: Iterable[tuple[str, int, int]], latencies: Latencies) -> None:
    """Match the events of both ends; when the client was ready for the first call of a batch is not known.

    A coalesced call travels with the next one, and has no latency of its own.
    """
    handled, ended, paused, late = _server_times(server)
    latencies.timer += late
    deferred = {"move": ended, "continue_for": paused}
    arrived: dict[str, int] = {}
    ready: int | None = None
    wait_ns: int | None = None
    for event in tracing.events:
        if event.kind == "call":
            arrived[event.channel] = handled[event.method].pop(0)
            if ready is not None and not event.coalesced:
                latencies.add(latencies.request, event.channel, wait_ns, arrived[event.channel] - ready)
        elif event.kind == "issued":
            if ready is not None and not event.coalesced:
                latencies.issue.append(event.wall_ns - ready)
            ready = event.wall_ns
        else:
            answered = arrived[event.channel]
            if event.channel in deferred:
                answered = deferred[event.channel].pop(0)
                wait_ns = answered - arrived[event.channel]
            latencies.add(latencies.reply, event.channel, wait_ns, event.wall_ns - answered)
            ready = event.wall_ns


def _server_times(
    server: Iterable[tuple[str, int, int]],
) -> tuple[dict[str, list[int]], list[int], list[int], list[int]]:
    """Return when each method was handled, commands ended and continue-fors paused, and how late wall timers were."""
    handled: dict[str, list[int]] = defaultdict(list)
    ended: list[int] = []
    paused: list[int] = []
    late: list[int] = []
    timer_due_ns: int | None = None
    for event, wall_ns, _ in server:
        if event == "end":
            ended.append(wall_ns)
        elif event == "timer":
            timer_due_ns = wall_ns
        elif event == "pause":
            paused.append(wall_ns)
            if timer_due_ns is not None:
                late.append(wall_ns - timer_due_ns)
            timer_due_ns = None
        elif event.startswith("handle "):
            handled[event.removeprefix("handle ")].append(wall_ns)
    return handled, ended, paused, late
