"""Thinking times of an agent: a constant, a distribution, a calibration file, or the time that it really takes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Final, Protocol

import numpy as np

from uavaccel.clock import MonotonicClock
from uavaccel.errors import UserError
from uavaccel.units import NS_PER_S, seconds_to_ns
from uavaccel.wire.latency import DEFAULT, QUANTILES, LatencyConfig, Numbers, read_latency
from uavaccel.yaml_io import dump_yaml

MEASURED: Final = "measured"
MOST_S = 3600.0


class ThinkingTime(Protocol):
    """A source of thinking times, in nanoseconds of wall time."""

    def observed(self) -> None:
        """Note that the agent has received an observation."""
        ...

    def draw_ns(self, generator: np.random.Generator) -> int:
        """Return the time from that observation to the action that has just arrived."""
        ...


class _Drawn:
    """The inverse of a distribution's cumulative function, interpolated between tables of quantiles that add up."""

    def __init__(self, quantiles: Sequence[float], *tables_s: Sequence[float]) -> None:
        self._quantiles = np.asarray(quantiles, float)
        self._tables_ns = [np.asarray(table, float) * NS_PER_S for table in tables_s if any(table)]

    def observed(self) -> None:
        pass

    def draw_ns(self, generator: np.random.Generator) -> int:
        return sum(round(np.interp(generator.random(), self._quantiles, table)) for table in self._tables_ns)


class _Constant:
    def __init__(self, seconds: float) -> None:
        self._taken_ns = seconds_to_ns(seconds)

    def observed(self) -> None:
        pass

    def draw_ns(self, generator: np.random.Generator) -> int:
        return self._taken_ns


class _Lognormal:
    def __init__(self, median_s: float, sigma: float) -> None:
        self._median_s, self._sigma = median_s, sigma

    def observed(self) -> None:
        pass

    def draw_ns(self, generator: np.random.Generator) -> int:
        drawn_s = self._median_s * math.exp(self._sigma * generator.standard_normal())
        return seconds_to_ns(min(drawn_s, MOST_S))


class Measured:
    """The time that the agent really takes, by the machine's monotonic clock. A flight with it does not repeat.

    `save` keeps what was measured as a calibration file, whose name as `latency_s` replays it as a distribution.
    """

    def __init__(self) -> None:
        self._clock = MonotonicClock()
        self._since_ns: int | None = None
        self.taken_ns: list[int] = []

    def observed(self) -> None:
        self._since_ns = self._clock.now_ns()

    def draw_ns(self, generator: np.random.Generator) -> int:
        assert self._since_ns is not None
        self.add_ns(self._clock.now_ns() - self._since_ns)
        return self.taken_ns[-1]

    def add_ns(self, taken_ns: int) -> None:
        """Record a thinking time."""
        self.taken_ns.append(taken_ns)

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


def samples(times_s: Sequence[float]) -> ThinkingTime:
    """Return thinking times distributed as a sample, in seconds. Raises UserError if one is negative or not finite."""
    try:
        taken = np.sort(np.asarray(times_s, float))
    except (TypeError, ValueError):
        taken = np.array(())
    if taken.ndim != 1 or not len(taken):
        raise UserError(f"latency_s: a sample is a list of seconds, not {times_s!r}")
    for each in (taken[0], taken[-1]):
        _checked(float(each))
    return _Drawn(np.linspace(0.0, 1.0, len(taken)).tolist(), taken.tolist())


def lognormal(median_s: float, p99_s: float) -> ThinkingTime:
    """Return log-normal thinking times with a median and a 99th percentile, in seconds.

    Raises UserError unless 0 < median_s <= p99_s.
    """
    if not 0 < median_s <= p99_s <= MOST_S:
        raise UserError(f"lognormal: needs 0 < median_s <= p99_s <= {MOST_S:g}, not {median_s} and {p99_s}")
    ninety_nine = 2.3263478740408408  # standard deviations
    return _Lognormal(median_s, math.log(p99_s / median_s) / ninety_nine)


def calibrated(path: str | Path) -> ThinkingTime:
    """Return the thinking times of a calibration file: a message with the action and one with the observation.

    The channels are `move` on the way out and `image` on the way back, or "call" where the file has neither. Raises
    UserError that names the file and the key.
    """
    model = read_latency(Path(path))

    def table_s(tables: dict[str, Numbers], channel: str) -> list[float]:
        return [model.scale * each / 1e6 for each in tables.get(channel, tables[DEFAULT])]

    return _Drawn(model.quantiles, table_s(model.request_us, "move"), table_s(model.reply_us, "image"))


def thinking_time(latency_s: object) -> ThinkingTime:
    """Return the thinking times that a wrapper's `latency_s` names: seconds, a sample, a file, "measured", or a source.

    Raises UserError, one line, for anything else.
    """
    if isinstance(latency_s, bool):
        raise UserError(f"latency_s: {_MEANT}, not {latency_s}")
    if isinstance(latency_s, int | float):
        return _Constant(_checked(float(latency_s)))
    if isinstance(latency_s, str | Path):
        return Measured() if latency_s == MEASURED else calibrated(latency_s)
    if isinstance(latency_s, Sequence | np.ndarray):
        return samples(list(latency_s))
    if hasattr(latency_s, "draw_ns") and hasattr(latency_s, "observed"):
        return latency_s
    raise UserError(f"latency_s: {_MEANT}, not {latency_s!r}")


_MEANT = 'must be seconds, a list of them, a calibration file, "measured", or a ThinkingTime'


def _checked(seconds: float) -> float:
    if not 0 <= seconds <= MOST_S:
        raise UserError(f"latency_s: must be 0 to {MOST_S:g} seconds, not {seconds:g}")
    return seconds
