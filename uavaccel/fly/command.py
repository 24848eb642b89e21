"""What `uavaccel fly` flies: a script once, twice to compare, or at several ClockSpeeds; and what is said of it."""

from __future__ import annotations

import contextlib
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path

from uavaccel.config import MOST_SECONDS, MOST_SEEDS
from uavaccel.errors import UsageError, UserError
from uavaccel.fly.log import TRAJECTORY, DifferenceError, equal, largest_difference_m
from uavaccel.fly.options import (
    ANSWERS,
    DIFFERENCE,
    INTERRUPT_SEEN,
    SCRATCH,
    SUMMARY,
    FlightOptions,
    FlightSummary,
    found_settings,
)
from uavaccel.fly.script import INTERRUPTED
from uavaccel.processes.lifetime import POLL_S, Patience, describe_end, remove_orphaned_files, start_python
from uavaccel.resources import scene_file
from uavaccel.units import CLOCK_SPEEDS

HEED_S, END_S = 0.5, 5.0  # after an interruption: until the script has received it, and until it has ended


@dataclass(frozen=True)
class FlyRequest:
    """The request on the command line; without `clocks` the settings' ClockSpeed is used."""

    flight: FlightOptions
    clocks: tuple[float, ...] = ()
    check: bool = False
    find_settings: bool = True
    out: Path | None = None
    page: Callable[[], AbstractContextManager[None]] | None = None
    """Opens the page beside the flights, if any."""


def parse_clocks(text: str | None) -> tuple[float, ...]:
    """The ClockSpeeds in a text such as "1,10,100". Raises UsageError."""
    try:
        clocks = tuple(float(part) for part in text.split(",")) if text else ()
    except ValueError:
        raise UsageError(f"--clock {text}: should be numbers with commas between, for example 1,10,100") from None
    if any(not CLOCK_SPEEDS[0] <= clock <= CLOCK_SPEEDS[1] for clock in clocks):
        least, most = CLOCK_SPEEDS
        raise UsageError(f"--clock {text}: every ClockSpeed must be above 0, from {least:g} to {most:g}")
    names = [f"{clock:g}" for clock in clocks]  # of the flights' folders
    if twice := [name for name in names if names.count(name) > 1]:
        raise UsageError(f"--clock {text}: has {twice[0]} twice")
    return clocks


def fly_script(request: FlyRequest) -> int:
    """Fly, compare and report; return the script's exit status. Raises UserError with one line."""
    _check_request(request)
    remove_orphaned_files(Path(tempfile.gettempdir()), re.compile(rf"{SCRATCH}(\d+)-"))
    with tempfile.TemporaryDirectory(prefix=f"{SCRATCH}{os.getpid()}-", ignore_cleanup_errors=True) as scratch:
        flight, folder = replace(request.flight, scratch=Path(scratch)), request.out or Path(scratch, "flight")
        if flight.settings is None and request.find_settings and (found := found_settings(flight.script)):
            print(f"settings: {found} (--no-settings flies without, --settings with others)", flush=True)
            flight = replace(flight, settings=found, settings_found=True)
        if len(request.clocks) > 1:
            with (request.page or nullcontext)():
                return _fly_clocks(request, flight, folder)
        clock_speed = request.clocks[0] if request.clocks else None
        return _fly_one(request, replace(flight, folder=folder, clock_speed=clock_speed), Path(scratch, "again"))


def _check_request(request: FlyRequest) -> None:
    flight = request.flight
    for option, seconds in (("think", flight.think_s), ("until", flight.until_s)):
        if seconds is not None and not 0.0 <= seconds <= MOST_SECONDS:
            raise UsageError(f"--{option} {seconds:g}: must be 0 to {MOST_SECONDS:g} s")
    if flight.seed is not None and not 0 <= flight.seed < MOST_SEEDS:
        raise UsageError(f"--seed {flight.seed}: must be 0 to {MOST_SEEDS - 1}")
    scene_file(flight.scene, "--scene ")
    if not flight.script.is_file():
        raise UserError(f"{flight.script}: no such file")
    wall, out = flight.timing == "wall", request.out
    if request.check and (wall or len(request.clocks) > 1):
        raise UsageError("--check flies one ClockSpeed twice, in virtual or lockstep; wall is never the same twice")
    if out is not None and out.exists() and any(out.iterdir()):
        raise UserError(f"{out}: is there already; choose another --out")
    if wall and (flight.film or flight.think_s is not None):
        needed = "--film and --think need --timing virtual or lockstep"
        raise UsageError(f"{needed}: in wall time they would cost flight time")
    if flight.film:
        from uavaccel.draw.style import check_films  # with what draws

        if out is None:
            raise UsageError("--film needs --out, a folder for it")
        check_films()


def _fly_one(request: FlyRequest, options: FlightOptions, again_in: Path) -> int:
    """Fly once, and again in another folder if that is to be compared."""
    with (request.page or nullcontext)():
        flown = fly(options)
    if request.check and flown.summary is not None and not flown.summary["calls"] and not flown.interrupted:
        print(f"not checked: the script {flown.ending} before any call", flush=True)
        return flown.status
    _print_result(flown, request.page is not None)
    if not request.check or flown.summary is None or flown.interrupted:
        return flown.status
    again = check(replace(options, folder=again_in, film=False), options.folder)
    if again.differs:
        return 1
    if again.summary is None or again.interrupted:
        print("not checked: the second flight did not come to its end", flush=True)
        return again.status
    if again.ending.partition(":")[0] != flown.ending.partition(":")[0]:  # an error's text may hold an address
        raise DifferenceError(f"the first flight's script {flown.ending}, the second's {again.ending}")
    same = f"; both times the script {flown.ending}" if flown.status else ""
    print(f"checked: flown twice, {flown.summary['calls']} calls and the trajectory are equal to the byte{same}")
    return flown.status


def _fly_clocks(request: FlyRequest, flight: FlightOptions, folder: Path) -> int:
    """Fly at each ClockSpeed and print a line for it; the other flights are compared with the first."""
    first, statuses, slept = request.clocks[0], [], False
    reference: Path | None = None
    for clock in request.clocks:
        options = replace(flight, folder=folder / f"clock-{clock:g}", clock_speed=clock)
        flown = fly(options, quiet=clock != first)
        statuses.append(flown.status)
        if flown.summary is None or flown.interrupted:
            break
        slept |= flown.summary["slept_s"] > 0
        connected, difference = flown.summary["position_m"] is not None, ""
        if connected and reference is not None:
            metres = largest_difference_m(options.folder, reference)
            difference = f", at most {metres:.3f} m from {first:g}x at equal times"
        if connected and clock == first:
            reference = options.folder
        print(f"clock {clock:g}: {_speed_text(flown.summary, request.page is not None)}{difference}", flush=True)
    if slept:
        print(
            "the script sleeps while the clock runs: its sleeps are wall time, so at ClockSpeed k they let k times as "
            "much be flown, and its flights part by that"
        )
    return max(statuses)


def _print_result(flown: FlightResult, watched: bool) -> None:
    if (summary := flown.summary) is None:
        return
    stopped = "" if summary["finished"] else "interrupted; " if flown.status else "stopped by --until; "
    told = f"{stopped}{_speed_text(summary, watched)}"
    if summary["position_m"] is not None:
        place = "".join(f" {metres:.2f}" for metres in summary["position_m"])
        thinking = f", {1000 * summary['think_s']:g} ms of thinking before each" if summary["think_s"] else ""
        told += f"; {summary['calls']} calls{thinking}; at{place} m"
    print(told, flush=True)


def _speed_text(summary: FlightSummary, watched: bool) -> str:
    """How much was flown in what time, which says nothing of a flight that kept a spectator's pace."""
    if summary["position_m"] is None:
        return "no client connected, nothing was flown"
    simulated_s, wall_s = summary["simulated_s"], summary["wall_s"]
    if watched:
        return f"{simulated_s:.2f} simulated s, watched"
    return f"{simulated_s:.2f} simulated s in {wall_s:.2f} s, {simulated_s / wall_s:.0f} per wall second"


# --- one flight, in a process of its own ----------------------------------------------------------------------------


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
    summary, difference = options.folder / SUMMARY, options.folder / DIFFERENCE
    seen, read = (options.scratch and options.scratch / name for name in (INTERRUPT_SEEN, ANSWERS))
    for file in (summary, difference, seen):
        if file is not None:
            file.unlink(missing_ok=True)
    with (
        # what the script of a first flight has read, or this process's own input
        read.open("rb") if read is not None and read.exists() else nullcontext() as answers,
        start_python(
            *("-m", "uavaccel.fly.process", options.to_json(), str(os.getpid())),
            environment={"PYTHONHASHSEED": "0"},  # otherwise the order of sets differs from run to run
            stdin=None if answers is None else answers.fileno(),
            stdout=subprocess.DEVNULL if quiet else None,
            own_session=False,  # a script may handle the terminal's Ctrl-C
        ) as process,
    ):
        try:
            status = _wait(process, seen)
        finally:
            process.kill()  # whatever else has happened here
    done = json.loads(summary.read_text(encoding="utf-8")) if summary.exists() else None
    if status == 0 and done is None:
        _say("the script ended its process by itself; its flight was not kept")
    return FlightResult(status, done, difference.exists())


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
    result = fly(replace(options, reference=first), quiet=True)
    has_flown = (first / TRAJECTORY).exists() and result.summary is not None and not result.interrupted
    if has_flown and not equal(options.folder, first):
        raise DifferenceError("the messages of both flights are equal, but the trajectories are not")
    return result
