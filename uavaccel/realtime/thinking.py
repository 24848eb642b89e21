"""Thinking times of an agent: a constant, a distribution, a calibration file, or the time that it really takes."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Protocol

import numpy as np

from uavaccel.clock import MonotonicClock
from uavaccel.config import dump_yaml
from uavaccel.errors import UserError
from uavaccel.units import NS_PER_S, real, seconds_to_ns
from uavaccel.wire.latency import DEFAULT, QUANTILES, LatencyConfig, read_latency

MEASURED: Final = "measured"
MOST_S = 3600.0
_MOST_NS = MOST_S * NS_PER_S


class ThinkingTime(Protocol):
    """A source of thinking times, in nanoseconds of wall time."""

    def observed(self) -> None:
        """Note that the agent has received an observation."""
        return

    def sample_ns(self, generator: np.random.Generator) -> int:
        """Return the time from that observation to the action that has just arrived."""
        ...


@dataclass
class _Drawn(ThinkingTime):
    """Nanoseconds that a function draws with a generator."""

    draw: Callable[[np.random.Generator], int]

    def sample_ns(self, generator: np.random.Generator) -> int:
        return self.draw(generator)


class Measured(ThinkingTime):
    """The time that the agent really takes, by the machine's monotonic clock. A flight with it does not repeat.

    `save` keeps what was measured as a calibration file, whose name as `latency_s` replays it as a distribution.
    """

    def __init__(self) -> None:
        self._clock = MonotonicClock()
        self._since_ns: int | None = None
        self.taken_ns: list[int] = []

    def observed(self) -> None:
        self._since_ns = self._clock.now_ns()

    def sample_ns(self, generator: np.random.Generator) -> int:
        assert self._since_ns is not None
        self.taken_ns.append(self._clock.now_ns() - self._since_ns)
        return self.taken_ns[-1]

    def save(self, path: str | Path, name: str = "measured thinking times") -> Path:
        """Write the quantiles of all times so far as a calibration file. Raises UserError before the first action."""
        if not self.taken_ns:
            raise UserError(f"{path}: no thinking time has been measured yet; take some steps first")
        taken_us = np.quantile(np.asarray(self.taken_ns) / 1e3, QUANTILES).tolist()
        model = LatencyConfig(name=name, request_us={DEFAULT: tuple(taken_us)})
        block = model.model_dump(mode="json", include={"name", "quantiles", "request_us", "reply_us"})
        written = Path(path)
        written.write_text(f"# {len(self.taken_ns)} thinking times\n{dump_yaml({'latency': block})}")
        return written


def samples(times_s: Iterable[float]) -> ThinkingTime:
    """Return thinking times that are drawn from a list of seconds, each as likely as the others.

    Raises UserError for anything else than numbers of seconds that a thinking time may take.
    """
    found = list(times_s) if isinstance(times_s, Iterable) else []
    taken = [seconds for one in found if (seconds := real(one)) is not None]
    if not taken or len(taken) < len(found):
        raise UserError(f"latency_s: a sample is a list of seconds, not {times_s!r}")
    for seconds in taken:
        if not 0 <= seconds <= MOST_S:
            raise UserError(f"latency_s: must be 0 to {MOST_S:g} seconds, not {seconds:g}")
    times_ns = [seconds_to_ns(seconds) for seconds in taken]
    if len(times_ns) == 1:  # nothing is drawn
        return _Drawn(lambda _: times_ns[0])
    return _Drawn(lambda generator: times_ns[int(generator.integers(len(times_ns)))])


def lognormal(median_s: float, p99_s: float) -> ThinkingTime:
    """Return log-normal thinking times with a median and a 99th percentile, in seconds.

    Raises UserError unless 0 < median_s <= p99_s.
    """
    median, p99 = real(median_s), real(p99_s)
    if median is None or p99 is None or not 0 < median <= p99 <= MOST_S:
        raise UserError(f"lognormal: needs 0 < median_s <= p99_s <= {MOST_S:g}, not {median_s!r} and {p99_s!r}")
    sigma = math.log(p99 / median) / 2.3263478740408408  # standard deviations up to the 99th percentile
    return _Drawn(lambda generator: seconds_to_ns(min(median * math.exp(sigma * generator.standard_normal()), MOST_S)))


def calibrated(path: str | Path) -> ThinkingTime:
    """Return the thinking times of a calibration file: a message with the action and one with the observation.

    Each is drawn by its quantiles, between which times are interpolated. The channels are `move` on the way out and
    `image` on the way back, or "call" where the file has neither. Raises UserError that names the file and the key.
    """
    model = read_latency(Path(path))
    tables_us = (
        tables.get(channel, tables[DEFAULT])
        for tables, channel in ((model.request_us, "move"), (model.reply_us, "image"))
    )
    scaled_s = [[model.scale * us / 1e6 for us in table] for table in tables_us]
    tables_ns = [np.asarray(table) * NS_PER_S for table in scaled_s if any(table)]
    return _Drawn(
        lambda generator: sum(round(np.interp(generator.random(), model.quantiles, table)) for table in tables_ns)
    )


def thinking_time(latency_s: object) -> ThinkingTime:
    """Return the thinking times that a wrapper's `latency_s` names: seconds, a sample, a file, "measured", or a source.

    Raises UserError, one line, for anything else.
    """
    if (seconds := real(latency_s)) is not None:
        return samples([seconds])
    if isinstance(latency_s, str | Path):
        return Measured() if latency_s == MEASURED else calibrated(latency_s)
    if isinstance(latency_s, Sequence | np.ndarray):
        return samples(latency_s)
    if hasattr(latency_s, "sample_ns") and hasattr(latency_s, "observed"):
        return latency_s
    meant = 'must be seconds, a list of them, a calibration file, "measured", or a ThinkingTime'
    raise UserError(f"latency_s: {meant}, not {latency_s!r}")


def sampled_ns(source: ThinkingTime, generator: np.random.Generator) -> int:
    """Return a thinking time in ns. Raises UserError where anybody's source draws what is none: -1 s, or NaN."""
    drawn = source.sample_ns(generator)
    taken_ns = drawn if type(drawn) is int else real(drawn)
    if taken_ns is not None and 0 <= taken_ns <= _MOST_NS:
        return round(taken_ns)
    raise UserError(f"{type(source).__name__}.sample_ns: must be 0 to {_MOST_NS:g} nanoseconds, not {drawn!r}")
