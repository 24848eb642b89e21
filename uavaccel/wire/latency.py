"""The latency model of a simulated wall clock: how long messages take, drawn from measured quantiles.

Its platform is the simulator's side: what ticks and frames cost, and the faults of its connection.
A call costs a request (from the client being ready to send it to the server handling it) and a reply (from the call
being handled, or due, to the client being ready again). A channel is a kind of call with its own quantiles. How fast
either end responds depends on how long it slept before, so a channel may have quantiles for several waits.
"""

from __future__ import annotations

import math
import zlib
from bisect import bisect_left
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Final, Literal, get_args

import numpy as np
from pydantic import (
    BeforeValidator,
    Field,
    ValidationInfo,
    ValidatorFunctionWrapHandler,
    WrapValidator,
    field_validator,
    model_validator,
)

from uavaccel.config import MOST_LATENCY_US, MOST_SCALE, Config, LatencyUs, Share, load_yaml, validate
from uavaccel.errors import UserError, suggestion
from uavaccel.own_code import file_beside
from uavaccel.resources import experiment
from uavaccel.sim.profile import AIRSIM, PROFILES, Executor, Frames, Profile, airsim_variant
from uavaccel.units import QUANTILES as QUANTILES
from uavaccel.units import check_quantile_row, check_quantiles, seconds_to_ns

RESENT_NS = 200_000_000  # Linux's least time-out before TCP sends a lost segment again (TCP_RTO_MIN)
STALLED_NS = 40_000_000  # Linux's delayed acknowledgement, which Nagle's algorithm waits for (TCP_DELACK_MIN)


class FrameConfig(Config):
    """The model of Unreal's frames (uavaccel.sim.simulation)."""

    hz: Annotated[float, Field(ge=0.0, le=1e5)] = 0.0
    """Frames per wall second; with 0 an image is drawn when it is requested."""

    @field_validator("hz")
    @classmethod
    def _comes_to_an_end(cls, hz: float) -> float:
        if 0.0 < hz < 0.01:
            raise ValueError("must be 0, or 0.01 or more")
        return hz

    stale_pose: bool = False
    """Whether images show the pose of the last frame before a pause."""
    after_continue: bool = False
    """Whether the reply of a continue-for also waits for a frame, while the simulation is paused."""


class FaultConfig(Config):
    """The fractions of messages, in either direction, that suffer a fault."""

    dropped: Share = 0.0
    """Lost, and sent again after TCP's minimum time-out of 200 ms."""
    stalled: Share = 0.0
    """Held until a delayed acknowledgement comes, 40 ms."""
    late: Share = 0.0
    """Late by `late_us`."""
    late_us: LatencyUs = 10_000.0
    """Microseconds by which a late message comes later."""

    @model_validator(mode="after")
    def _at_most_all(self) -> FaultConfig:
        if self.dropped + self.stalled + self.late > 1.0:
            raise ValueError("dropped, stalled and late are fractions of all messages: together at most 1")
        return self


class PlatformConfig(Config):
    """The simulator's side of a modelled wall clock; by default it costs nothing and has no faults."""

    tick_us: LatencyUs = 0.0
    """Wall time of a physics tick; the speed saturates at the tick's duration divided by it."""
    integer_clock_speed: bool = False
    """Whether a ClockSpeed above 1 loses its fraction, as in AirSim."""
    stall_us: LatencyUs = 0.0
    """Delay of a request that follows a command without a reply yet: 40 000 for AirSim's client on a connection with
    Nagle's algorithm and delayed acknowledgements."""
    frames: FrameConfig = FrameConfig()
    """The game engine's frames, to which pictures and calls may have to wait."""
    faults: FaultConfig = FaultConfig()
    """Messages that come late or are lost."""
    goal_timeout_s: Annotated[float, Field(gt=0.0, le=1e6)] = 0.06
    """AirSim's api_goal_timeout: simulated time without a new goal after which position hold begins."""
    exact_pauses: bool = False
    """Whether a continue-for ends on the tick, as in the profile `native`, instead of by a wall timer."""
    scalable_clock: bool = False
    """Whether the clock is AirSim's ScalableClock: a loop of 3 ms of wall time, whose step grows with ClockSpeed."""

    def profile(self, name: str, clock_speed: float) -> Profile:
        """Return the profile of that name, modified by the keys above; `native` is not modified."""
        if name != AIRSIM.name:
            return PROFILES[name]
        step = max(clock_speed, 1.0) if self.scalable_clock else 1.0
        return airsim_variant(round(AIRSIM.tick_ns * step), seconds_to_ns(self.goal_timeout_s), self.exact_pauses)

    def executor(self) -> Executor:
        return Executor(round(self.tick_us * 1e3), self.integer_clock_speed)

    def frame_ns(self) -> int:
        """Return the period of the frames; 0 without frames."""
        return round(1e9 / self.frames.hz) if self.frames.hz else 0

    def new_frames(self, wait_ns: Callable[[], int]) -> Frames:
        """Return the frames of one game; `wait_ns` draws how long a frame is waited for."""
        return Frames(self.frame_ns(), self.frames.stale_pose, self.frames.after_continue, wait_ns)


def delays_ns(faults: FaultConfig, generator: np.random.Generator) -> Iterator[int]:
    """Yield the delays of a stream's messages; one number is drawn for each message."""
    at = np.cumsum([faults.dropped, faults.stalled, faults.late])
    delays = (RESENT_NS, STALLED_NS, round(faults.late_us * 1e3), 0)
    while True:
        for uniform in generator.random(1024):
            yield delays[int(np.searchsorted(at, uniform, side="right"))]


Channel = Literal["call", "pause", "continue", "move", "continue_for", "state", "image"]
CHANNELS: tuple[Channel, ...] = get_args(Channel)
DEFAULT: Final = "call"
DIRECTIONS = ("request_us", "reply_us")
WAITS_MS = (1, 2, 5, 10, 20)  # of a command or a continue-for, on the wall
BETWEEN_NS = [1e6 * math.sqrt(shorter * longer) for shorter, longer in pairwise(WAITS_MS)]
_BLOCK = 1024
SHIPPED = {"native": "latency.yaml", "airsim": "latency_airsim.yaml"}  # by profile
_NO_FAULTS = FaultConfig()

# Behind a validator of one's own pydantic takes no list for a tuple.
Numbers = Annotated[tuple[float, ...], BeforeValidator(lambda row: tuple(row) if isinstance(row, list) else row)]


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _quantile_row(value: object) -> object:
    if _is_number(value):
        raise ValueError("a factor needs the model that ships: leave out `quantiles` and rows of one's own")
    return tuple(value) if isinstance(value, list) else value


OfRow = BeforeValidator(_quantile_row, json_schema_input_type=tuple[float, ...] | float)
QuantileRow = Annotated[tuple[float, ...], OfRow]
Tables = dict[str, QuantileRow]  # microseconds at the quantiles, by channel


def after_wait(channel: str, wait_ns: int) -> str:
    """Return the channel's name after such a wait for a command or a continue-for, such as "pause@10ms"."""
    return f"{channel}@{WAITS_MS[bisect_left(BETWEEN_NS, wait_ns)]}ms"


KNOWN_CHANNELS = [*CHANNELS, *(f"{channel}@{wait}ms" for channel in CHANNELS for wait in WAITS_MS)]


class LatencyConfig(Config):
    """Microseconds at `quantiles`, by channel: move, pause, continue, continue_for, state, image; "call" is the rest.

    "pause@10ms" holds after a wait of about 10 ms, "pause" after any other. In a block that changes the model that
    ships, a number in place of a channel's row is a factor on that channel alone, after any wait.

    `issue_us` is what sending a command without waiting costs the client; `timer_us` how late a wall timer of the
    server ends (it matters to the `airsim` profile's continue-for alone). `platform` is what the simulator costs
    beside its messages; `name` is for the reader of a run.
    """

    name: str = ""
    """What reports call this latency model."""
    scale: Annotated[float, Field(ge=0.0, le=MOST_SCALE)] = 1.0
    """Requests and replies take so many times what their quantiles say."""
    quantiles: Numbers = QUANTILES
    """Of the shares 0 to 1, those at which the lists of latencies below have their values."""
    request_us: Tables = Field(default_factory=lambda: {DEFAULT: (0.0,) * len(QUANTILES)})
    """By channel: microseconds from the client to the server, a value for each of `quantiles`."""
    reply_us: Tables = Field(default_factory=lambda: {DEFAULT: (0.0,) * len(QUANTILES)})
    """By channel: microseconds from the server to the client, a value for each of `quantiles`."""
    issue_us: Numbers = (0.0,) * len(QUANTILES)
    """Microseconds that the client needs to send a message, a value for each of `quantiles`."""
    timer_us: Numbers = (0.0,) * len(QUANTILES)
    """Microseconds by which a timer wakes late, a value for each of `quantiles`."""
    platform: PlatformConfig = PlatformConfig()
    """What a platform like AirSim's adds: frames, and faults."""

    @field_validator("request_us", "reply_us")
    @classmethod
    def _of_known_channels(cls, tables: Tables) -> Tables:
        for name in tables:
            if name not in KNOWN_CHANNELS:
                raise ValueError(f"has an unknown channel {name!r}; {suggestion(name, KNOWN_CHANNELS)}")
        if DEFAULT not in tables:
            raise ValueError(f'needs quantiles under "{DEFAULT}"')
        return tables

    @field_validator("quantiles")
    @classmethod
    def _rise_within_0_and_1(cls, quantiles: tuple[float, ...]) -> tuple[float, ...]:
        check_quantiles(quantiles)
        return quantiles

    @field_validator("request_us", "reply_us", "issue_us", "timer_us")
    @classmethod
    def _fit_the_quantiles(cls, value: Tables, info: ValidationInfo) -> Tables:
        count = len(info.data.get("quantiles", ()))
        for table in value.values() if isinstance(value, dict) else [value]:
            check_quantile_row(table, count or len(table))
            if max(table, default=0.0) > MOST_LATENCY_US:
                raise ValueError(f"must be at most {MOST_LATENCY_US:g} us, a minute, not {max(table):g}")
        return value


ZERO_LATENCY = LatencyConfig()


@cache
def shipped_latency(profile: str = "native") -> LatencyConfig:
    """Return a profile's shipped model: measured by `uavaccel timing calibrate`, or AirSim's by tools/fit_airsim.py."""
    return read_latency(experiment(SHIPPED[profile]))


def of_the_profile(fields: Mapping[str, object]) -> LatencyConfig:
    """Return the shipped model for the key `profile` among a configuration's fields."""
    return shipped_latency(str(fields.get("profile", "native")))


def read_latency(path: Path) -> LatencyConfig:
    """Return the model under the key `latency` of a YAML file. Raises UserError that names the file and the key."""
    block = load_yaml(path)
    if "latency" not in block:
        raise UserError(f"{path}: has no key 'latency'; `uavaccel timing calibrate --out {path}` writes one")
    return validate(_LatencyFile, {"latency": block["latency"]}, str(path)).latency


class _LatencyFile(Config):
    latency: LatencyConfig


def _completed(block: Mapping[str, object], shipped: Mapping[str, object]) -> dict[str, object]:
    """Update the shipped model's block recursively by the keys of `block`; factors scale their channel's rows."""
    result = dict(shipped)
    for key, value in block.items():
        if isinstance(value, Mapping) and isinstance(below := result.get(key), Mapping):
            result[key] = _scaled(key, value, below) if key in DIRECTIONS else _completed(value, below)
        else:
            result[key] = value
    return result


def _scaled(
    direction: str, factors: Mapping[str, float], tables: Mapping[str, Sequence[float]]
) -> dict[str, Sequence[float]]:
    """Return a direction's rows with each named channel's multiplied by its factor, for all waits unless one is named.

    A channel without a row of its own gets the scaled row from which it was drawn before.
    """
    result = dict(tables)
    for channel, factor in factors.items():
        if channel not in KNOWN_CHANNELS:
            known = suggestion(channel, KNOWN_CHANNELS)
            raise ValueError(f"{direction}.{channel} is an unknown channel; {known}")
        if not 0 <= factor <= MOST_SCALE:
            raise ValueError(f"{direction}.{channel} must be 0 to {MOST_SCALE:g}, a factor, not {factor}")
        source = next(name for name in (channel, channel.partition("@")[0], DEFAULT) if name in tables)
        rows = {name: row for name, row in tables.items() if name.startswith(f"{channel}@")}
        for name, row in {**rows, channel: tables[source]}.items() if factor != 1 else ():
            result[name] = [factor * each for each in row]
    return result


def _from_block_or_file(value: object, validated: ValidatorFunctionWrapHandler, info: ValidationInfo) -> LatencyConfig:
    is_given = isinstance(value, str | Path | Mapping)
    if isinstance(value, Mapping) and "profile" in info.data and "quantiles" not in value:
        rows = [value[direction] for direction in DIRECTIONS if direction in value]
        if all(isinstance(row, Mapping) and row and all(map(_is_number, row.values())) for row in rows):
            value = _completed(value, of_the_profile(info.data).model_dump(mode="json"))  # it changes what ships
    if isinstance(value, str | Path):
        try:
            value = read_latency(file_beside(value))
        except UserError as error:
            raise UserError(f"latency: {error}") from None
    model: LatencyConfig = validated(value)
    if is_given and "platform" not in model.model_fields_set and "profile" in info.data:
        profile = info.data["profile"]
        if shipped_latency(profile).platform != model.platform:
            raise ValueError(f"quantiles of one's own replace {profile}'s whole model: add its `platform`, or another")
    return model


LatencyModel = Annotated[
    LatencyConfig,
    WrapValidator(_from_block_or_file, json_schema_input_type=LatencyConfig | str),
    Field(default_factory=of_the_profile),
]
"""Type of a configuration's field `latency`: a block or a YAML file's name; where none is given, the model that ships
for the `profile`, a field that has to stand before it. A block without `quantiles` and rows of its own, as of
`--set latency.platform.stall_us=40000` or `--set latency.reply_us.move=4`, changes the one that ships."""


class Latency:
    """Draws latencies in nanoseconds from one generator per channel, so that channels do not affect each other."""

    def __init__(self, config: LatencyConfig, seed: np.random.SeedSequence) -> None:
        self.platform, self._config, self._seed = config.platform, config, seed
        self._streams: dict[tuple[str, str], Iterator[int]] = {}
        self._wait_ns: int | None = None
        self._faults = None if config.platform.faults == _NO_FAULTS else config.platform.faults
        self.stall_ns = round(config.platform.stall_us * 1e3)

    def waited(self, wait_ns: int) -> None:
        """Note how long a command or a continue-for was waited for, while both ends may have slept."""
        self._wait_ns = wait_ns

    def request_ns(self, channel: str) -> int:
        return self._message_ns("request", channel, self._config.request_us)

    def reply_ns(self, channel: str) -> int:
        return self._message_ns("reply", channel, self._config.reply_us)

    def issue_ns(self) -> int:
        return self._draw("issue", "", {"": self._config.issue_us})

    def timer_ns(self) -> int:
        return self._draw("timer", "", {"": self._config.timer_us})

    def frame_ns(self) -> int:
        """Return how long a frame is waited for: uniform from 0 to two periods."""
        longest_us = 2 * self._config.platform.frame_ns() / 1e3
        return self._draw("frame", "", {"": tuple(longest_us * share for share in self._config.quantiles)})

    def _message_ns(self, direction: str, channel: str, tables: Tables) -> int:
        """Return how long the next message of a direction takes, faults of the connection included."""
        taken_ns = round(self._draw(direction, channel, tables) * self._config.scale)
        if self._faults is None:
            return taken_ns
        if (key := ("fault", direction)) not in self._streams:
            self._streams[key] = delays_ns(self._faults, self._generator(f"fault {direction}"))
        return taken_ns + next(self._streams[key])

    def _draw(self, kind: str, channel: str, tables: Tables) -> int:
        if self._config is ZERO_LATENCY:  # the fast path of millions of flights
            return 0
        name = channel if self._wait_ns is None else after_wait(channel, self._wait_ns)
        if name not in tables:
            name = channel if channel in tables else DEFAULT
        stream = self._streams.get((kind, name))
        if stream is None:
            stream = self._streams[kind, name] = self._stream(f"{kind} {name}", tables[name])
        return next(stream)

    def _stream(self, name: str, table: Numbers) -> Iterator[int]:
        if not any(table):
            while True:
                yield 0
        generator = self._generator(name)
        while True:
            uniform = generator.random(_BLOCK)
            yield from np.rint(1e3 * np.interp(uniform, self._config.quantiles, table)).astype(int).tolist()

    def _generator(self, name: str) -> np.random.Generator:
        key = (*self._seed.spawn_key, zlib.crc32(name.encode()))
        return np.random.default_rng(np.random.SeedSequence(self._seed.entropy, spawn_key=key))
