"""Flights of a script, each in a process of its own, and what two of them have in common."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from uavaccel.fly.messages import DifferenceError
from uavaccel.fly.options import FlightOptions
from uavaccel.fly.process import SUMMARY
from uavaccel.fly.trajectory import equal


@dataclass(frozen=True)
class Flown:
    """A finished flight: exit status of the script, and the summary that `process` wrote, if it came so far."""

    status: int
    summary: dict[str, Any] | None


def fly(options: FlightOptions, quiet: bool = False) -> Flown:
    """Fly once. What the script prints appears at once, unless `quiet`; Ctrl-C ends the script."""
    options.folder.mkdir(parents=True, exist_ok=True)
    summary = options.folder / SUMMARY
    summary.unlink(missing_ok=True)
    with subprocess.Popen(
        [sys.executable, "-m", "uavaccel.fly.process", options.to_json()],
        env={**os.environ, "PYTHONHASHSEED": "0"},  # else the order of sets differs from run to run
        stdout=subprocess.DEVNULL if quiet else None,
    ) as process:
        status = _wait(process)
    done = json.loads(summary.read_text(encoding="utf-8")) if summary.exists() else None
    return Flown(status, done)


def _wait(process: subprocess.Popen[bytes]) -> int:
    """A terminal sends Ctrl-C to the script too, which ends, and keeps what it flew; a second one ends it at once."""
    try:
        return process.wait()
    except KeyboardInterrupt:
        try:
            return process.wait()
        except KeyboardInterrupt:
            process.kill()
            return process.wait()


def check(options: FlightOptions, first: Path) -> Flown:
    """Fly again, and compare with the flight in the folder `first`: every message, and the trajectory to the byte.

    The flight stops at the first message that differs. Raises DifferenceError where only the trajectories do.
    """
    flown = fly(replace(options, reference=first), quiet=True)
    if flown.summary is not None and not equal(options.folder, first):
        raise DifferenceError("the messages of both flights are equal, but the trajectories are not")
    return flown
