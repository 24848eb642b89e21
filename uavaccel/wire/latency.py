"""The latency model of a simulated wall clock: how long messages take, drawn from measured quantiles.

A call costs a request (from the client being ready to send it to the server handling it) and a reply (from the call
being handled, or due, to the client being ready again). A channel is a kind of call with its own quantiles. How fast
either end responds depends on how long it slept before, so a channel may have quantiles for several waits.
"""

from __future__ import annotations

import math
import zlib
from bisect import bisect_left
from collections.abc import Iterator, Mapping, Sequence
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
)

from uavaccel.config import MOST_LATENCY_US, MOST_SCALE, Config, load_yaml, validate
from uavaccel.errors import UserError, suggestion
from uavaccel.resources import experiment
from uavaccel.units import QUANTILES as QUANTILES
from uavaccel.units import check_quantile_row, check_quantiles
from uavaccel.wire.platform import FaultConfig, PlatformConfig, delays_ns

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


QuantileRow = Annotated[
    tuple[float, ...], BeforeValidator(_quantile_row, json_schema_input_type=tuple[float, ...] | float)
]
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
    return read_latency(experiment(SHIPPED[profile]), shipped=True)


def of_the_profile(fields: Mapping[str, object]) -> LatencyConfig:
    """Return the shipped model for the key `profile` among a configuration's fields."""
    return shipped_latency(str(fields.get("profile", "native")))


def read_latency(path: Path, shipped: bool = False) -> LatencyConfig:
    """Return the model under the key `latency` of a YAML file. Raises UserError that names the file and the key."""
    block = load_yaml(path, shipped)
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


def _changes_what_ships(block: Mapping[str, object]) -> bool:
    """Return whether a block only changes the shipped model: it has neither quantiles nor rows."""
    rows = [block[direction] for direction in DIRECTIONS if direction in block]
    return "quantiles" not in block and all(
        isinstance(row, Mapping) and row and all(map(_is_number, row.values())) for row in rows
    )


def _from_block_or_file(value: object, validated: ValidatorFunctionWrapHandler, info: ValidationInfo) -> LatencyConfig:
    is_given = isinstance(value, str | Path | Mapping)
    if isinstance(value, Mapping) and "profile" in info.data and _changes_what_ships(value):
        value = _completed(value, of_the_profile(info.data).model_dump(mode="json"))
    if isinstance(value, str | Path):
        try:
            value = read_latency(Path(value))
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
        self.platform = config.platform
        self._config = config
        self._seed = seed
        self._streams: dict[tuple[str, str], Iterator[int]] = {}
        self._wait_ns: int | None = None
        self._faults = None if config.platform.faults == _NO_FAULTS else config.platform.faults
        self.stall_ns = round(config.platform.stall_us * 1e3)

    def waited(self, wait_ns: int) -> None:
        """Note how long a command or a continue-for was waited for, while both ends may have slept."""
        self._wait_ns = wait_ns

    def request_ns(self, channel: str) -> int:
        sampled_ns = self._draw("request", channel, self._config.request_us)
        return round(sampled_ns * self._config.scale) + self._fault_ns("request")

    def reply_ns(self, channel: str) -> int:
        sampled_ns = self._draw("reply", channel, self._config.reply_us)
        return round(sampled_ns * self._config.scale) + self._fault_ns("reply")

    def issue_ns(self) -> int:
        return self._draw("issue", "", {"": self._config.issue_us})

    def timer_ns(self) -> int:
        return self._draw("timer", "", {"": self._config.timer_us})

    def frame_ns(self) -> int:
        """Return how long a frame is waited for: uniform from 0 to two periods."""
        longest_us = 2 * self._config.platform.frame_ns() / 1e3
        return self._draw("frame", "", {"": tuple(longest_us * share for share in self._config.quantiles)})

    def _fault_ns(self, direction: str) -> int:
        """Return how long a fault of the connection delays the next message of a direction."""
        faults, key = self._faults, ("fault", direction)
        if faults is None:
            return 0
        if key not in self._streams:
            self._streams[key] = delays_ns(faults, self._generator(f"fault {direction}"))
        return next(self._streams[key])

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
        """Yield one channel's latencies."""
        if not any(table):
            while True:
                yield 0
        generator = self._generator(name)
        while True:
            uniform = generator.random(_BLOCK)
            yield from np.rint(1e3 * np.interp(uniform, self._config.quantiles, table)).astype(int).tolist()

    def _generator(self, name: str) -> np.random.Generator:
        """Return the generator of this name."""
        key = (*self._seed.spawn_key, zlib.crc32(name.encode()))
        return np.random.default_rng(np.random.SeedSequence(self._seed.entropy, spawn_key=key))
