"""Calibration: latencies of messages between client and server on this machine, from which `virtual` samples.

Messages are timed on the machine's clock at both ends of the wire; trajectories play no part. They are the messages of
ADSC and TCSC, since the time in which an end wakes depends on what it did before.

A model is checked by quantiles of the same games on both clocks. Each game is flown on the machine's clock, on the
simulated one, and on the machine's again, as two measured runs differ too: their difference is the floor of what a
model can be blamed for.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from itertools import product
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavaccel.calibration.advise import fly_square
from uavaccel.calibration.traces import TracingTransport
from uavaccel.clock import calendar_time
from uavaccel.commands import COMMANDS, VelocityGoal
from uavaccel.config import dump_yaml
from uavaccel.files import Plain
from uavaccel.machine import describe_run
from uavaccel.metrics.trajectory import mean_position_rmse
from uavaccel.wire.client import Client
from uavaccel.wire.latency import QUANTILES, LatencyConfig, after_wait
from uavaccel.wire.session import Session, VirtualSession, WallSession

CLOCK_SPEEDS = (50.0, 100.0)
T_MOVES_S = (0.1, 0.2, 0.5, 1.0)  # at these speeds the ends sleep for 1 to 20 ms, as they do in DP1
BATCH = 24  # commands per reading of the server's trace
STAY = VelocityGoal((0.0, 0.0, 0.0))

Samples = dict[str, list[int]]
CHECKED_T_MOVES_S = (0.2, 1.0)
ROUNDS = 24
LEVELS = (0.1, 0.5, 0.9)
MEDIAN_WITHIN = 0.20  # relative to the measured median
TAIL_FACTOR = 1.5  # relative to the difference between the two measured runs
LEVELS_TEXT = "10, 50 and 90 % quantiles; agreement: median within 20 %, the others within 1.5 times wall v wall"

Quantiles = NDArray[np.float64]


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
            sum(len(sample) for name, sample in samples.items() if "@" not in name)
            for samples in (self.request, self.reply)
        )
        return f"{request} requests, {reply} replies, {len(self.issue)} issues, {len(self.timer)} wall timers"

    def lines(self) -> Iterator[str]:
        """Yield medians and 99 % quantiles of each channel; the quantiles after a wait are in the file alone."""
        for kind, samples in (("request", self.request), ("reply", self.reply)):
            for channel in sorted(name for name in samples if "@" not in name):
                median_us, late_us = (quantiles_us(samples[channel])[QUANTILES.index(level)] for level in (0.5, 0.99))
                yield f"{kind:8} {channel:13} median {median_us:7.1f} us, 99 % {late_us:7.1f} us"


def model_file(latencies: Latencies, profile: str, verdict: str) -> str:
    """Return the YAML of a latency model, with what it was measured on in comments."""
    host = describe_run([], 0, "")["host"]
    return (
        f"# Measured by `uavaccel calibrate`, profile {profile}, on {calendar_time()}; machine: {verdict}\n"
        f"# {host['cpu_model']}, {host['cores']} cores, {host['platform']}\n# {latencies.counts()}\n"
        + dump_yaml({"latency": latencies.block()})
    )


def quantiles_us(samples_ns: Sequence[int]) -> list[float]:
    """Return quantiles of samples in ns, in microseconds, rounded to a tenth."""
    return [round(float(value) / 1e3, 1) for value in np.quantile(samples_ns, QUANTILES)]


def measure(profile: str, commands: int, images: bool) -> Latencies:
    """Fly about `commands` commands of each kind on this machine's clock, and return the latencies of their messages.

    With `images` as many images of the lane are requested too, rendering included; raises rpc.RpcError without OpenGL.
    """
    latencies = Latencies()
    batches = max(round(commands / BATCH / (len(CLOCK_SPEEDS) * len(T_MOVES_S))), 1)  # of each command, in each cell
    with WallSession("blocks", profile) as session:
        for name, clock_speed, t_move_s, _ in product(sorted(COMMANDS), CLOCK_SPEEDS, T_MOVES_S, range(batches)):
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


class Agreement(NamedTuple):
    """The 10, 50 and 90 % quantiles of one quantity in one cell, in both measured runs and in the model."""

    command: str
    clock_speed: float
    t_move_s: float
    quantity: str
    wall: Quantiles
    wall_again: Quantiles
    virtual: Quantiles

    @property
    def median_off(self) -> float:
        """The relative difference of the modelled median from the mean of the measured ones; 0 between zeros."""
        measured = float(self.wall[1] + self.wall_again[1]) / 2
        return abs(float(self.virtual[1]) - measured) / measured if measured else abs(float(self.virtual[1]))

    def texts(self) -> tuple[str, ...]:
        """Return the cell, the quantiles and the verdict, as columns of a table."""
        quantiles = (" ".join(f"{value:.3g}" for value in run) for run in (self.wall, self.wall_again, self.virtual))
        verdict = "agrees" if self.agrees else f"differs, median by {self.median_off:.0%}"
        return self.command.upper(), f"{self.clock_speed:g}x", f"{self.t_move_s:g}", self.quantity, *quantiles, verdict

    @property
    def agrees(self) -> bool:
        """Whether the median agrees within 20 %, the outer quantiles within 1.5 times the measured difference."""
        measured, floor = (self.wall + self.wall_again) / 2, abs(self.wall - self.wall_again)
        allowed = np.maximum(TAIL_FACTOR * floor, MEDIAN_WITHIN * measured)
        return self.median_off <= MEDIAN_WITHIN and bool(
            (abs(self.virtual - measured)[[0, 2]] <= allowed[[0, 2]]).all()
        )


def check_agreement(latency: LatencyConfig, profile: str, games: int) -> Iterator[Agreement]:
    """Fly `games` of each command, ClockSpeed and T_move on both clocks, and yield the agreement of gaps and errors.

    A gap is the simulated time in seconds between two commands, an error the RMSE in metres of a game against the
    flight without latency.
    """
    with (
        WallSession("blocks", profile) as wall,
        VirtualSession("blocks", profile, latency) as virtual,
        VirtualSession("blocks", profile) as lockstep,
    ):
        sessions: list[Session] = [wall, virtual, wall]
        for cell in product(sorted(COMMANDS), CLOCK_SPEEDS, CHECKED_T_MOVES_S):
            games_on_all = [[fly_square(session, *cell, ROUNDS, game) for session in sessions] for game in range(games)]
            ideal = fly_square(lockstep, *cell, ROUNDS, 0).flight
            flown = list(zip(*games_on_all, strict=True))
            gaps = [np.concatenate([game.gap_s for game in results]) for results in flown]
            errors = [mean_position_rmse([game.flight for game in results], [ideal]) for results in flown]
            for quantity, values in (("gap s", gaps), ("error m", errors)):
                first, model, again = (np.quantile(value, LEVELS) for value in values)
                yield Agreement(*cell, quantity, first, again, model)
