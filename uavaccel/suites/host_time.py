"""How long a run took on this machine, from its timing.jsonl; no summary has it, since it is never reproduced."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from itertools import accumulate, pairwise
from typing import Any, TypeAlias, TypeVar

from uavaccel.clock import MonotonicClock
from uavaccel.draw.page import in_words as in_words
from uavaccel.units import NS_PER_S

Result = TypeVar("Result")
Timings: TypeAlias = Sequence[Mapping[str, Any]]
"""The entries of timing.jsonl; `wall_s` is the wall time since the first command of a start of the run."""


def timed(work: Callable[[], Result]) -> tuple[Result, dict[str, float]]:
    """Return the result of some work, and the entries of timing.jsonl for its duration and the machine's load."""
    clock = MonotonicClock()
    start_ns = clock.now_ns()
    result = work()
    return result, {"host_wall_s": (clock.now_ns() - start_ns) / NS_PER_S, "load": os.getloadavg()[0]}


def cumulative_wall_s(timings: Timings) -> list[float]:
    """Return the wall time in seconds from the first command up to each entry that has it, over all starts."""
    readings = [entry["wall_s"] for entry in timings if "wall_s" in entry]
    steps = [after - before if after >= before else after for before, after in pairwise([0.0, *readings])]
    return list(accumulate(steps))


def over_all_starts(readings: Sequence[Mapping[str, float]]) -> Counter[str]:
    """Return the sums of stopwatches that restart whenever a run is resumed."""
    total = Counter[str](readings[-1] if readings else {})
    for before, after in pairwise(readings):
        if sum(after.values()) < sum(before.values()):
            total.update(before)
    return total


def pace_of(timings: Timings, simulated_s: float) -> str:
    """Return in words how long games of so many simulated seconds took; empty where it was not measured."""
    took_s = (cumulative_wall_s(timings) or [0.0])[-1]
    if not took_s:
        return ""
    what = "flying and learning" if "learner_s" in timings[-1] else "flying"
    return f"{what} took {in_words(took_s)} of wall clock, {simulated_s / took_s:.0f} simulated s per wall s"
