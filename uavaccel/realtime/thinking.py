"""Thinking times of an agent: a constant, a distribution, a calibration file, or the time that it really takes."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from uavaccel.clock import MonotonicClock
from uavaccel.errors import UserError
from uavaccel.files import Plain, read_bounded, write_json
from uavaccel.units import NS_PER_S, QUANTILES, check_quantile_row, check_quantiles, real, seconds_to_ns, whole

MEASURED: Final = "measured"
LATENCY_S = 0.05
MOST_S = 3600.0
_MOST_NS = MOST_S * NS_PER_S
_STREAM = 0x7EA1  # of the generator of thinking times, which leaves the environment's draws as they are


def thinking_generator(seed: int) -> np.random.Generator:
    """Return the generator from which the thinking times of an environment with this seed are drawn."""
    return np.random.default_rng([_STREAM, seed])


class ThinkingTime(Protocol):
    """A source of thinking times, in nanoseconds of wall time."""

    def observed(self) -> None:
        """Note that the agent has received an observation."""
        return

    def sample_ns(self, generator: np.random.Generator) -> int:
        """Return the time from that observation to the action that has just arrived."""
        ...


@dataclass
class Drawn(ThinkingTime):
    """Nanoseconds that a function draws with a generator, so many at once, the same as one by one.

    `only` is the time where there is but one, and nothing is drawn.
    """

    draw: Callable[[np.random.Generator, int], NDArray[np.int64]]
    only: int | None = None

    def sample_ns(self, generator: np.random.Generator) -> int:
        return int(self.draw(generator, 1)[0]) if self.only is None else self.only


class Measured(ThinkingTime):
    """The time that the agent really takes, by the machine's monotonic clock. An episode with it does not repeat.

    `save` keeps what was measured as a calibration file, whose name as `latency_s` replays it as a distribution.
    """

    def __init__(self) -> None:
        self._clock = MonotonicClock()
        self._since_ns: int | None = None
        self.taken_ns: list[int] = []

    def observed(self) -> None:
        self._since_ns = self._clock.now_ns()

    def sample_ns(self, generator: np.random.Generator) -> int:
        if self._since_ns is None:
            raise UserError("latency_s = 'measured': there is no observation yet; reset the environment before a step")
        self.taken_ns.append(self._clock.now_ns() - self._since_ns)
        return self.taken_ns[-1]

    def save(self, path: str | Path, name: str = "measured thinking times", **further: Plain) -> Path:
        """Write the quantiles of all times so far as a calibration file, in JSON, which is YAML too, and further keys.

        Raises UserError before the first action, and where no file can be written.
        """
        if not self.taken_ns:
            raise UserError(f"{path}: no thinking time has been measured yet; take some steps first")
        taken_us = np.quantile(np.asarray(self.taken_ns) / 1e3, QUANTILES).tolist()
        model = {"name": name, "quantiles": QUANTILES, "request_us": {"call": taken_us}}
        return write_json(Path(path), {"latency": model, "thinking_times": len(self.taken_ns), **further})


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
    return _one_of([seconds_to_ns(seconds) for seconds in taken])


def periods(counts: object, wall_ns: Callable[[int], int]) -> ThinkingTime:
    """Return thinking times of a count of control periods, or drawn from a list of counts; `wall_ns` says how long.

    Raises UserError for anything else, and for a time that no thinking time may take.
    """
    given: Any = counts if isinstance(counts, Sequence | np.ndarray) else [counts]
    taken = [count for one in given if (count := whole(one)) is not None and count >= 0]
    if not taken or len(taken) < len(given):
        raise UserError(f"delay_steps: must be a count of control periods, or a list of them, not {counts!r}")
    if (longest_ns := wall_ns(max(taken))) > _MOST_NS:
        raise UserError(f"delay_steps: {max(taken)} are {longest_ns / NS_PER_S:g} seconds; at most {MOST_S:g} may pass")
    return _one_of([wall_ns(count) for count in taken])


def _one_of(times_ns: list[int]) -> ThinkingTime:
    if len(times_ns) == 1:
        return Drawn(lambda _, count: np.full(count, times_ns[0]), only=times_ns[0])
    listed_ns: NDArray[np.int64] = np.asarray(times_ns)

    def draw(generator: np.random.Generator, count: int) -> NDArray[np.int64]:
        drawn: NDArray[np.int64] = listed_ns[generator.integers(len(listed_ns), size=count)]
        return drawn

    return Drawn(draw)


def lognormal(median_s: float, p99_s: float) -> ThinkingTime:
    """Return log-normal thinking times with a median and a 99th percentile, in seconds.

    Raises UserError unless 0 < median_s <= p99_s.
    """
    median, p99 = real(median_s), real(p99_s)
    if median is None or p99 is None or not 0 < median <= p99 <= MOST_S:
        raise UserError(f"lognormal: needs 0 < median_s <= p99_s <= {MOST_S:g}, not {median_s!r} and {p99_s!r}")
    sigma = math.log(p99 / median) / 2.3263478740408408  # standard deviations up to the 99th percentile

    def draw(generator: np.random.Generator, count: int) -> NDArray[np.int64]:
        drawn_s = median * np.exp(sigma * generator.standard_normal(count))
        drawn_ns: NDArray[np.int64] = np.rint(np.minimum(drawn_s, MOST_S) * NS_PER_S).astype(np.int64)
        return drawn_ns

    return Drawn(draw)


def calibrated(path: str | Path) -> ThinkingTime:
    """Return the thinking times of a calibration file: a message with the action and one with the observation.

    The file, JSON or YAML, has under `latency` the `quantiles`, and in `request_us` and `reply_us` microseconds at
    these by channel: `move` on the way out and `image` on the way back, or "call" where it has neither; and a `scale`.
    Each is drawn by its quantiles, between which times are interpolated. Raises UserError that names file and key.
    """
    block = _mapping(_document(Path(path)), "latency", path)
    quantiles = _numbers(block.get("quantiles", QUANTILES), f"{path}: latency.quantiles", check_quantiles)
    check_row = partial(check_quantile_row, count=len(quantiles))
    if (scale := _number(block.get("scale", 1.0))) is None or not 0 <= scale < math.inf:
        raise UserError(f"{path}: latency.scale must be a number of 0 or more, not {block['scale']!r}")
    rows_ns = []
    for direction, channel in (("request_us", "move"), ("reply_us", "image")):
        rows = _mapping(block, direction, path) if direction in block else {}
        name = channel if channel in rows else "call"
        if name in rows:
            row = _numbers(rows[name], f"{path}: latency.{direction}.{name}", check_row)
            rows_ns.append(scale * np.array(row) * 1e3)
    longest_ns = sum(float(row[-1]) for row in rows_ns)
    if not rows_ns or longest_ns > _MOST_NS:
        raise UserError(f"{path}: latency.request_us.call: needs microseconds at the quantiles, up to {MOST_S:g} s")
    rows_ns = [row for row in rows_ns if row.any()]

    def draw(generator: np.random.Generator, count: int) -> NDArray[np.int64]:
        uniform = generator.random((count, len(rows_ns)))
        drawn = [np.rint(np.interp(uniform[:, place], quantiles, row)) for place, row in enumerate(rows_ns)]
        return np.sum(drawn, axis=0, initial=0, dtype=np.int64) if drawn else np.zeros(count, np.int64)

    return Drawn(draw)


def _document(path: Path) -> Any:
    """Return what a JSON or YAML file holds; only YAML that is no JSON needs PyYAML."""
    try:
        text = read_bounded(path).decode("utf-8")
    except OSError as error:
        raise UserError(f"{path}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise UserError(f"{path}: not UTF-8 text") from error
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        pass
    try:
        import yaml
    except ImportError:
        raise UserError(f"{path}: no JSON, and to read YAML PyYAML is needed: pip install pyyaml") from None
    try:
        return yaml.safe_load(text)
    except RecursionError:
        raise UserError(f"{path}: neither JSON nor YAML: nested too deep") from None
    except (yaml.YAMLError, ValueError) as error:
        raise UserError(f"{path}: neither JSON nor YAML: {str(error).splitlines()[0]}") from error


def _mapping(parent: object, key: str, path: str | Path) -> Mapping[str, Any]:
    found = parent.get(key) if isinstance(parent, Mapping) else None
    if not isinstance(found, Mapping):
        raise UserError(f"{path}: {key} must be a mapping; {MEASURED!r} and its save() write such a file")
    return found


def _number(value: object) -> float | None:
    """Return a number, also 1e3, which YAML 1.2 has and PyYAML takes for text; None for anything else."""
    try:
        return float(value) if isinstance(value, str) else real(value)
    except ValueError:
        return None


def _numbers(row: object, name: str, check: Callable[[Sequence[float]], None]) -> list[float]:
    """Return a list of numbers that passes a check. Raises UserError for anything else."""
    numbers = [_number(one) for one in row] if isinstance(row, list | tuple) else []
    values = [number for number in numbers if number is not None and abs(number) < math.inf]
    if not values or len(values) < len(numbers):
        raise UserError(f"{name} must be a list of numbers")
    try:
        check(values)
    except ValueError as error:
        raise UserError(f"{name}: {error}") from None
    return values


def thinking_time(latency_s: object) -> ThinkingTime:
    """Return the thinking times that a wrapper's `latency_s` names: seconds, a sample, a file, "measured", or a source.

    Raises UserError, one line, for anything else.
    """
    if (seconds := real(latency_s)) is not None:
        return samples([seconds])
    if isinstance(latency_s, str | Path):
        return Measured() if latency_s == MEASURED else calibrated(latency_s)
    if isinstance(latency_s, Sequence | np.ndarray) and not isinstance(latency_s, bytes):
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
