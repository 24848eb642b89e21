"""Flights of a script, each in a process of its own, and what two of them have in common."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path

from uavaccel.fly.messages import DifferenceError
from uavaccel.fly.options import DIFFERENCE, HEEDED, SUMMARY, FlightOptions, FlightSummary
from uavaccel.fly.script import INTERRUPTED
from uavaccel.fly.watch import LOOK_S, Patience, ended_how

HEED_S, END_S = 0.5, 5.0  # of an interruption: until the script has got it, and until it has ended


class StoppedError(Exception):
    """A script's process has been stopped for too long."""


@dataclass(frozen=True)
class Flown:
    """A flight that has ended: exit status of the script, and the summary that `process` wrote, if it came so far."""

    status: int
    summary: FlightSummary | None
    differs: bool = False

    @property
    def interrupted(self) -> bool:
        return self.status == INTERRUPTED and not (self.summary or {}).get("finished")


def fly(options: FlightOptions, quiet: bool = False) -> Flown:
    """Fly once. What the script prints appears at once, unless `quiet`; Ctrl-C and SIGTERM end the script."""
    options.folder.mkdir(parents=True, exist_ok=True)
    for name in (SUMMARY, DIFFERENCE):
        (options.folder / name).unlink(missing_ok=True)
    heeded = None if options.scratch is None else options.scratch / HEEDED
    if heeded is not None:
        heeded.unlink(missing_ok=True)
    with subprocess.Popen(
        [sys.executable, "-m", "uavaccel.fly.process", options.to_json(), str(os.getpid())],
        env={**os.environ, "PYTHONHASHSEED": "0"},  # else the order of sets differs from run to run
        stdout=subprocess.DEVNULL if quiet else None,
    ) as process:
        try:
            status = _wait(process, heeded)
        finally:
            process.kill()  # whatever else has happened here
    summary = options.folder / SUMMARY
    done = json.loads(summary.read_text(encoding="utf-8")) if summary.exists() else None
    if status == 0 and done is None:
        _say("the script ended its process by itself; its flight was not kept")
    return Flown(status, done, (options.folder / DIFFERENCE).exists())


def _wait(process: subprocess.Popen[bytes], heeded: Path | None) -> int:
    """The script's status. Says what ended its process, if that was none of its own doing."""
    try:
        status = _status_of(process)
        how = ended_how(status)
    except KeyboardInterrupt:
        return _interrupt(process, heeded)
    except StoppedError:
        process.kill()
        process.wait()
        status, how = -signal.SIGKILL, "was stopped, and killed since it did not go on"
    if status < 0:
        _say(f"error: the script's process {how}")
        return 128 - status
    return status


def _status_of(process: subprocess.Popen[bytes]) -> int:
    patience = Patience(process)
    while True:
        with contextlib.suppress(subprocess.TimeoutExpired):
            return process.wait(LOOK_S)
        if patience.is_over():
            raise StoppedError


def _interrupt(process: subprocess.Popen[bytes], heeded: Path | None) -> int:
    """A terminal sends Ctrl-C to the script too, which ends, and keeps what it flew; another sender does not.

    A script that does not end, or a second Ctrl-C, ends its process.
    """
    try:
        with contextlib.suppress(subprocess.TimeoutExpired):
            return process.wait(HEED_S)
        if heeded is None or not heeded.exists():
            process.send_signal(signal.SIGINT)
        with contextlib.suppress(subprocess.TimeoutExpired):
            return process.wait(END_S - 1.0)
        _say("the script was interrupted, and did not end; its process was killed")
    except KeyboardInterrupt:
        _say("interrupted twice; the script's process was killed")
    process.kill()
    process.wait()
    return INTERRUPTED


def _say(line: str) -> None:
    print(f"uavaccel: {line}", file=sys.stderr, flush=True)


def check(options: FlightOptions, first: Path) -> Flown:
    """Fly again, and compare with the flight in the folder `first`: every message, and the trajectory to the byte.

    The flight stops at the first message that differs. Raises DifferenceError where only the trajectories do.
    """
    from uavaccel.fly.trajectory import equal

    flown = fly(replace(options, reference=first), quiet=True)
    if flown.summary is not None and not flown.interrupted and not equal(options.folder, first):
        raise DifferenceError("the messages of both flights are equal, but the trajectories are not")
    return flown
