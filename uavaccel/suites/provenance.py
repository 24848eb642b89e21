"""The source line of figures and reports: the clock behind the numbers, how many games, profile, seed, disturbances."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from uavaccel.metrics.speedup import timing_provenance
from uavaccel.suites.rows import Row, disturbed_games

_CLOCK = {"wall": "wall clock", "virtual": "virtual clock", "lockstep": "no latency"}


def source_line(rows: Sequence[Row]) -> str:
    """Return the source line of a figure or a report made of these games."""
    counts = Counter(row["timing"] for row in rows)
    games = [
        f"{clock_words(timing)}: {count} game{'s' if count > 1 else ''}"
        for timing, count in sorted(counts.items())
    ]
    return " · ".join([*games, *profiles_and_seeds(rows), *disturbed_words(rows)])


def clock_words(timing: str) -> str:
    """Return a timing in words, as in "measured (wall clock)"."""
    return f"{timing_provenance(timing)} ({_CLOCK[timing]})"


def profiles_and_seeds(rows: Sequence[Row]) -> list[str]:
    """Return the profiles and seeds of the games, as in "airsim profile", "seed 0"."""
    return sorted({f"{row['profile']} profile" for row in rows} | {f"seed {row['seed']}" for row in rows})


def disturbed_words(rows: Sequence[Row]) -> list[str]:
    """Return a note of how many games were disturbed; none where no game was."""
    count = disturbed_games(rows)
    return [f"{count} of {len(rows)} games disturbed"] if count else []
