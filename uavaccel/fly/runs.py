"""Flights of a script, each in a process of its own, and what two of them have in common."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from uavaccel.fly.messages import DifferenceError
from uavaccel.fly.options import ANSWERS, DIFFERENCE, INTERRUPT_SEEN, SUMMARY, FlightOptions, FlightSummary
from uavaccel.fly.script import INTERRUPTED
from uavaccel.processes.lifetime import POLL_S, Patience, describe_end, start_python

HEED_S, END_S = 0.5, 5.0  # after an interruption: until the script has received it, and until it has ended


@dataclass(frozen=True)
class FlightResult:
    """A flight that has ended: the script's exit status, and the summary of its process if that was written.

    `differs` says whether its messages are not those of its reference.
    """

    status: int
    summary: FlightSummary | None
    differs: bool = False

    @property
    def interrupted(self) -> bool:
        return self.status == INTERRUPTED and not (self.summary or {}).get("finished")

    @property
    def ending(self) -> str:
        """How the script ended, in words."""
        summary = self.summary or {}
        if not summary.get("finished"):
            return "was stopped by --until"
        return f"ended with {summary.get('error') or f'exit status {self.status}'}"


def fly(options: FlightOptions, quiet: bool = False) -> FlightResult:
    """Fly a script once. Its output is shown as it comes, unless `quiet`; Ctrl-C and SIGTERM end the script."""
    options.folder.mkdir(parents=True, exist_ok=True)
    for name in (SUMMARY, DIFFERENCE):
        (options.folder / name).unlink(missing_ok=True)
    seen = None if options.scratch is None else options.scratch / INTERRUPT_SEEN
    if seen is not None:
        seen.unlink(missing_ok=True)
    with (
        _answers(options) as answers,
        start_python(
            *("-m", "uavaccel.fly.process", options.to_json(), str(os.getpid())),
            environment={"PYTHONHASHSEED": "0"},  # otherwise the order of sets differs from run to run
            stdin=answers,
            stdout=subprocess.DEVNULL if quiet else None,
            own_session=False,  # a script may handle the terminal's Ctrl-C
        ) as process,
    ):
        try:
            status = _wait(process, seen)
        finally:
            process.kill()  # whatever else has happened here
    summary = options.folder / SUMMARY
    done = json.loads(summary.read_text(encoding="utf-8")) if summary.exists() else None
    if status == 0 and done is None:
        _say("the script ended its process by itself; its flight was not kept")
    return FlightResult(status, done, (options.folder / DIFFERENCE).exists())


@contextlib.contextmanager
def _answers(options: FlightOptions) -> Iterator[int | None]:
    """Open what the script of a first flight has read; None, which is this process's own input, before."""
    path = None if options.scratch is None else options.scratch / ANSWERS
    if path is None or not path.exists():
        yield None
        return
    with path.open("rb") as file:
        yield file.fileno()


def _wait(process: subprocess.Popen[bytes], seen: Path | None) -> int:
    """Return the script's exit status. Says what ended its process, if the script did not."""
    patience, stopped = Patience(process), False
    try:
        while (status := process.poll()) is None:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(POLL_S)
            if patience.is_over() and not stopped:
                stopped = True
                process.kill()
    except KeyboardInterrupt:
        return _interrupt(process, seen)
    if status < 0:
        how = "was stopped, and killed since it did not go on" if stopped else describe_end(status)
        _say(f"error: the script's process {how}")
        return 128 - status
    return status


def _interrupt(process: subprocess.Popen[bytes], seen: Path | None) -> int:
    """Let an interrupted script end, which keeps what was flown; kill it if it does not, or at a second Ctrl-C.

    A terminal sends Ctrl-C to the script too; another sender does not, and then it is passed on.
    """
    try:
        with contextlib.suppress(subprocess.TimeoutExpired):
            return process.wait(HEED_S)
        if seen is None or not seen.exists():
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


def check(options: FlightOptions, first: Path) -> FlightResult:
    """Fly again, and compare with the flight in the folder `first`: every message, and the trajectory to the byte.

    The flight stops at the first message that differs. Raises DifferenceError where only the trajectories do.
    """
    from uavaccel.fly.trajectory import FILE_NAME as TRAJECTORY
    from uavaccel.fly.trajectory import equal

    result = fly(replace(options, reference=first), quiet=True)
    has_flown = (first / TRAJECTORY).exists() and result.summary is not None and not result.interrupted
    if has_flown and not equal(options.folder, first):
        raise DifferenceError("the messages of both flights are equal, but the trajectories are not")
    return result
