"""Calibration: latencies of messages between client and server on this machine, from which `virtual` samples.

Messages are timed on the machine's clock at both ends of the wire; trajectories play no part. They are the messages of
ADSC and TCSC, since the time in which an end wakes depends on what it did before.

A model is checked by quantiles of the same games on both clocks. Each game is flown on the machine's clock, on the
simulated one, and on the machine's again, as two measured runs differ too: their difference is the floor of what a
model can be blamed for.

`advise` flies a path under such a model, and says which ClockSpeed ADSC tolerates.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from itertools import product
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from uavaccel.clock import calendar_time
from uavaccel.commands import COMMANDS, SynchronousCommand, VelocityGoal, velocities
from uavaccel.config import dump_yaml
from uavaccel.files import Plain
from uavaccel.machine import host
from uavaccel.metrics.intervals import NORMAL_QUANTILE
from uavaccel.metrics.stlc import mean_stlc
from uavaccel.metrics.trajectory import Trajectory, command_gaps_s, mean_position_rmse, trajectory
from uavaccel.sim.profile import PROFILES
from uavaccel.units import NS_PER_S
from uavaccel.wire.latency import QUANTILES, LatencyConfig, after_wait, shipped_latency
from uavaccel.wire.session import Client, Session, VirtualSession, WallSession
from uavaccel.wire.transport import PendingCall, Transport

ADVISED_SPEEDS = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0)
GAMES = 5
T_TH_WALL_S = 0.001  # as in the experiments' configurations
T_MOVES, ERROR = 0.81, 3.3
"""The gap, in T_move, at which policies lose five points of success, and the factor by which that misses tasks that
were not fitted: tools/fit_gap_law.py, of docs/tables/gap_law.csv (docs/why.md)."""


class SquareGame(NamedTuple):
    """A game's trajectory, the simulated gaps between its commands, and its wall time."""

    flight: Trajectory
    gap_s: np.ndarray
    wall_s: float


def fly_square(
    session: Session, command_name: str, clock_speed: float, t_move_s: float, rounds: int, seed: int, t_th_ns: int = 0
) -> SquareGame:
    """Fly the square of 1 m/s commands `rounds` times, one sample per command; `seed` is that of the latencies."""
    client = session.start_game(clock_speed, np.random.SeedSequence(seed))
    command = COMMANDS[command_name]
    command.begin(client)
    start_ns = client.now_ns()
    for velocity in velocities("square", rounds):
        for _ in command.fly(client, VelocityGoal(velocity), t_move_s, t_move_s, t_th_ns):
            pass
    wall_s = (client.now_ns() - start_ns) / NS_PER_S
    arrays = client.recording().arrays()
    gap_s = command_gaps_s(arrays["command_start_s"], arrays["command_end_s"])
    return SquareGame(trajectory(arrays["time_s"], arrays["position_m"]), gap_s, wall_s)


def advise(
    latency: LatencyConfig,
    profile: str,
    t_move_s: float,
    rounds: int,
    seed: int = 0,
    told: Callable[[], object] = lambda: None,
) -> pd.DataFrame:
    """Fly the square path with `rounds` rounds, and return a row for each of ADVISED_SPEEDS and command, ADSC first.

    `error_m` is the median RMSE against the flight without latency, `stlc` and `speedup` are against ADSC at 1x. `told`
    is called after each row.
    """
    rows: list[dict[str, Plain]] = []
    with VirtualSession("blocks", profile) as lockstep, VirtualSession("blocks", profile, latency) as session:
        t_th = partial(PROFILES[profile].t_th_ns, T_TH_WALL_S, t_sample_s=t_move_s)

        def games(command: str, clock_speed: float) -> tuple[list[Trajectory], float]:
            """Fly GAMES, and return their trajectories and their mean wall time."""
            flown = [
                fly_square(session, command, clock_speed, t_move_s, rounds, seed * GAMES + game, t_th(clock_speed))
                for game in range(GAMES)
            ]
            return [game.flight for game in flown], float(np.mean([game.wall_s for game in flown]))

        ideal = fly_square(lockstep, "tcsc", 1.0, t_move_s, rounds, seed, t_th(1.0)).flight
        real_time, real_time_s = games("adsc", 1.0)
        for clock_speed, command in product(ADVISED_SPEEDS, ("adsc", "tcsc")):
            flights, wall_s = games(command, clock_speed)
            errors_m, stlc = mean_position_rmse(flights, [ideal]), mean_stlc(flights, real_time)
            scores = {"error_m": np.median(errors_m), "stlc": np.median(stlc), "speedup": real_time_s / wall_s}
            rows.append({"clock_speed": clock_speed, "command": command, **scores})
            told()
    return pd.DataFrame(rows)


def sentence(advice: pd.DataFrame, error_m: float, t_move_s: float) -> str:
    """Return in words at which ClockSpeed each command is fastest within the error."""
    within = advice[advice.error_m <= error_m]
    fastest = within.loc[within.groupby("command").speedup.idxmax()].set_index("command")
    slow, fast = f"ADSC leaves {error_m:g} m at any ClockSpeed", "so does TCSC: its own timer is too coarse"
    if "adsc" in fastest.index:
        adsc = fastest.loc["adsc"]
        slow = f"ADSC is fastest within {error_m:g} m at ClockSpeed {adsc.clock_speed:g}, {adsc.speedup:.1f}x real time"
    if "tcsc" in fastest.index:
        fast = "TCSC at {clock_speed:g}, {speedup:.1f}x".format(**fastest.loc["tcsc"])
    return f"With commands of {t_move_s:g} s {slow}; {fast}. Modelled."


def policy_sentence(t_move_s: float, thinking_s: float) -> str:
    """Return in words the ClockSpeed at which a policy loses five points of success, with its 95 % interval."""
    spread, middle = ERROR**NORMAL_QUANTILE, T_MOVES * t_move_s / thinking_s
    speed, low, high = (f"{float(f'{each:.2g}'):g}" for each in (middle, middle / spread, middle * spread))
    return (
        f"Policies trained without a gap lose five points of success at one of about {T_MOVES:g} T_move: with "
        f"{thinking_s:g} s of thinking and messages at ClockSpeed {speed} (95 %: {low} to {high}). A rule of thumb, "
        f"which missed tasks that it was not fitted on by a factor of {ERROR:g} (docs/why.md)."
    )


CLOCK_SPEEDS = (50.0, 100.0)
T_MOVES_S = (0.1, 0.2, 0.5, 1.0)  # at these speeds the ends sleep for 1 to 20 ms, as they do in DP1
BATCH = 24  # commands per reading of the server's trace
DEFERRED = {"move": "end", "continue_for": "pause"}  # channels whose answer waits for an event of the server

Samples = dict[str, list[int]]
CHECKED_T_MOVES_S = (0.2, 1.0)
ROUNDS = 24
LEVELS = (0.1, 0.5, 0.9)
MEDIAN_WITHIN = 0.20  # relative to the measured median
AGREES = "agrees"
TAIL_FACTOR = 1.5  # relative to the difference between the two measured runs
AGREEMENT_HEAD = f"""\
10, 50 and 90 % quantiles of pauses and errors; they agree if the median is
within 20 %, the others within 1.5 times the difference of both runs on the wall
{"":26} {"wall":14} {"wall again":14} virtual"""

Quantiles = NDArray[np.float64]


class ClientEvent(NamedTuple):
    """An event at the client's end: `kind` is "call", "issued" (sent without waiting) or "return".

    A `coalesced` call travels with the next one, and has no latency of its own.
    """

    kind: str
    method: str
    channel: str
    wall_ns: int
    coalesced: bool = False


class TracingTransport(Transport):
    """A transport that records when the client calls, when it continues, and when it has its reply."""

    def __init__(self, inner: Transport) -> None:
        super().__init__(inner.clock)
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

    def gather(self, client: Iterable[ClientEvent], server: Iterable[tuple[str, int, int]]) -> None:
        """Match the events of both ends; when the client was ready for the first call of a batch is not known."""
        times_ns: dict[str, list[int]] = defaultdict(list)  # of the server's events
        due_ns: int | None = None  # of a wall timer that is set
        for event, wall_ns, _ in server:
            times_ns[event].append(wall_ns)
            if event == "pause" and due_ns is not None:
                self.timer.append(wall_ns - due_ns)
            if event in ("timer", "pause"):
                due_ns = wall_ns if event == "timer" else None
        arrived: dict[str, int] = {}
        ready: int | None = None
        wait_ns: int | None = None
        for message in client:
            channel = message.channel
            if message.kind == "call":
                arrived[channel] = times_ns[f"handle {message.method}"].pop(0)
                if ready is not None and not message.coalesced:
                    self.add(self.request, channel, wait_ns, arrived[channel] - ready)
                continue
            if message.kind == "issued":
                if ready is not None and not message.coalesced:
                    self.issue.append(message.wall_ns - ready)
            else:
                answered = arrived[channel]
                if channel in DEFERRED:
                    answered = times_ns[DEFERRED[channel]].pop(0)
                    wait_ns = answered - arrived[channel]
                self.add(self.reply, channel, wait_ns, message.wall_ns - answered)
            ready = message.wall_ns

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
    """Return the YAML of a latency model, with what it was measured on in comments; its platform is the profile's."""
    machine, platform = host(), shipped_latency(profile).platform.model_dump(mode="json", exclude_defaults=True)
    block = latencies.block() | ({"platform": platform} if platform else {})
    return (
        f"# Measured by `uavaccel timing calibrate`, profile {profile}, on {calendar_time()}; machine: {verdict}\n"
        f"# {machine['cpu_model']}, {machine['cores']} cores, {machine['platform']}\n# {latencies.counts()}\n"
        + dump_yaml({"latency": block})
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
            COMMANDS[name].begin(client)
            time_batch(client, latencies, partial(_stay, COMMANDS[name], t_move_s))
            time_batch(client, latencies, lambda traced: traced.call("ping"))  # as all without a channel of their own
    if images:
        with WallSession("lane", profile) as session:
            client = session.start_game(CLOCK_SPEEDS[0], np.random.SeedSequence(0), lane=0)
            client.image("gray")  # creates the GL context
            for _ in range(max(commands // BATCH, 1)):
                time_batch(client, latencies, lambda traced: traced.image("gray"))
    return latencies


def _stay(command: SynchronousCommand, t_move_s: float, client: Client) -> None:
    for _ in command.fly(client, VelocityGoal((0.0, 0.0, 0.0)), t_move_s, t_move_s):
        pass


def time_batch(client: Client, latencies: Latencies, send: Callable[[Client], object]) -> None:
    """Let a client `send` a command or request BATCH times, and add the latencies of its messages."""
    tracing = TracingTransport(client.transport)
    traced = Client(tracing, client.clock_speed)
    client.trace(True)
    for _ in range(BATCH):
        send(traced)
    latencies.gather(tracing.events, client.trace(False))


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
    def verdict(self) -> str:
        """In words, whether the median agrees within 20 %, the others within 1.5 times the measured difference."""
        measured, floor = (self.wall + self.wall_again) / 2, abs(self.wall - self.wall_again)
        off, allowed = abs(self.virtual - measured), np.maximum(TAIL_FACTOR * floor, MEDIAN_WITHIN * measured)
        median_off = float(off[1] / (measured[1] or 1.0))
        if median_off <= MEDIAN_WITHIN and (off <= allowed)[[0, 2]].all():
            return AGREES
        return f"{median_off:.0%} off"

    @property
    def line(self) -> str:
        """The cell, the quantiles and the verdict, in the columns of AGREEMENT_HEAD."""
        cell = f"{self.command.upper()} {self.clock_speed:4g}x {self.t_move_s:3g} s  {self.quantity}"
        runs = (" ".join(map(_short, run)) for run in self[4:])
        return " ".join([f"{cell:26}", *(f"{run:14}" for run in runs), self.verdict])


def _short(value: float) -> str:
    return f"{value:.0f}" if value >= 1000 else f"{value:.{2 if value < 1 else 3}g}"


def check_agreement(latency: LatencyConfig, profile: str, games: int) -> Iterator[Agreement]:
    """Fly `games` of each command, ClockSpeed and T_move on both clocks, and yield the agreement of pauses and errors.

    A pause is simulated ms between two commands, an error a game's RMSE in cm against the flight without latency.
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
            for quantity, unit, values in (("pause ms", 1e-3, gaps), ("error cm", 1e-2, errors)):
                first, model, again = (np.quantile(value, LEVELS) / unit for value in values)
                yield Agreement(*cell, quantity, first, again, model)


def record_trace(session: Session, command_name: str, clock_speed: float, t_move_s: float) -> list[dict[str, Plain]]:
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
    server = [event for event in client.trace(False) if "uavaccelTrace" not in event[0]]
    messages = [event for event in tracing.events if event.kind != "issued"]
    events: list[tuple[int, str, str, int | None]] = [
        *((event.wall_ns, "client", f"{event.kind} {event.method}", None) for event in messages),
        *((wall_ns, "server", event, now_ns) for event, wall_ns, now_ns in server),
    ]
    events.sort(key=lambda event: event[0])
    simulated_ns = min((event[2] for event in server), default=0)
    merged = []
    for wall_ns, source, name, now_ns in events:  # a client's event has the simulated time of the server's last
        simulated_ns = simulated_ns if now_ns is None else now_ns
        merged.append({"source": source, "event": name, "wall_s": wall_ns / NS_PER_S, "sim_s": simulated_ns / NS_PER_S})
    return merged
