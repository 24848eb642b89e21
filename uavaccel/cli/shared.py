"""What the commands that make runs share: options, the time in a run's name, how an interruption is told."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from uavaccel.clock import calendar_time
from uavaccel.errors import UsageError, UserError


def given(options: Mapping[str, Any]) -> dict[str, Any]:
    """The options about which something was said."""
    return {key: value for key, value in options.items() if value is not None}


def check_jobs(jobs: int, timing: str) -> None:
    """Raises UsageError for a number of processes that cannot be."""
    if jobs < 1 or (jobs > 1 and timing == "wall"):
        raise UsageError(
            "--jobs must be 1 with timing wall, since neighbours would spoil the measurement, or above 0"
        )


def time_stamp() -> str:
    """Now, as it stands in a run directory's name."""
    return calendar_time()[:19].replace(":", "")


@contextmanager
def resumable(out: Path) -> Iterator[None]:
    """Turns Ctrl-C into a UserError that says how to go on."""
    try:
        yield
    except KeyboardInterrupt:
        raise UserError(
            f"interrupted; go on with --out {out} --resume, the other options as they were"
        ) from None
