"""The line below a figure: which clock the games' numbers come from, how many games, profile and seed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from uavaccel.metrics.speedup import timing_provenance
from uavaccel.suites.disturbed import disturbed_words
from uavaccel.suites.report import Row

_CLOCK = {"wall": "wall clock", "virtual": "virtual clock", "lockstep": "no latency"}


def source_line(rows: Sequence[Row]) -> str:
    """Of the games of a figure."""
    counts = Counter(row["timing"] for row in rows)
    games = [
        f"{clock_words(timing)}: {count} game{'s' if count > 1 else ''}"
        for timing, count in sorted(counts.items())
    ]
    return " · ".join([*games, *conditions(rows), *disturbed_words(rows)])


def clock_words(timing: str) -> str:
    """measured (wall clock)"""
    return f"{timing_provenance(timing)} ({_CLOCK[timing]})"


def conditions(rows: Sequence[Row]) -> list[str]:
    """Profiles and seeds."""
    return sorted({f"{row['profile']} profile" for row in rows} | {f"seed {row['seed']}" for row in rows})
