"""What `uavaccel fly` flies: a script once, twice to compare, or at several ClockSpeeds; and what is said of it."""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path

from uavaccel.config import MOST_SECONDS, MOST_SEEDS
from uavaccel.errors import UsageError, UserError
from uavaccel.fly.messages import DifferenceError
from uavaccel.fly.options import SCRATCH, FlightOptions, FlightSummary, found_settings
from uavaccel.fly.runs import FlightResult, check, fly
from uavaccel.processes.lifetime import remove_orphaned_files
from uavaccel.resources import asset
from uavaccel.units import CLOCK_SPEEDS


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
        request = _with_settings(request, Path(scratch))
        folder = request.out or Path(scratch, "flight")
        if len(request.clocks) > 1:
            with (request.page or nullcontext)():
                return _fly_clocks(request, folder)
        return _fly_one(request, folder, Path(scratch))


def _check_request(request: FlyRequest) -> None:
    flight = request.flight
    _check_numbers(flight)
    asset(f"mjcf/{flight.scene}.xml")
    if not flight.script.is_file():
        raise UserError(f"{flight.script}: no such file")
    if request.check and (flight.timing == "wall" or len(request.clocks) > 1):
        raise UsageError("--check flies one ClockSpeed twice, in virtual or lockstep; wall is never the same twice")
    if request.out is not None and request.out.exists() and any(request.out.iterdir()):
        raise UserError(f"{request.out}: is there already; choose another --out")
    if flight.timing == "wall" and (flight.film or flight.think_s is not None):
        raise UsageError(
            "--film and --think need --timing virtual or lockstep: in wall time they would cost flight time"
        )
    if flight.film and request.out is None:
        raise UsageError("--film needs --out, a folder for it")
    if flight.film:
        from uavaccel.draw.style import check_films  # with what draws

        check_films()


def _check_numbers(flight: FlightOptions) -> None:
    for option, seconds in (("think", flight.think_s), ("until", flight.until_s)):
        if seconds is not None and not 0.0 <= seconds <= MOST_SECONDS:
            raise UsageError(f"--{option} {seconds:g}: must be 0 to {MOST_SECONDS:g} s")
    if flight.seed is not None and not 0 <= flight.seed < MOST_SEEDS:
        raise UsageError(f"--seed {flight.seed}: must be 0 to {MOST_SEEDS - 1}")


def _with_settings(request: FlyRequest, scratch: Path) -> FlyRequest:
    """The request with settings that were found, if none were named and looking for them is allowed; prints which."""
    flight = replace(request.flight, scratch=scratch)
    if flight.settings is None and request.find_settings and (found := found_settings(flight.script)):
        print(f"settings: {found} (--no-settings flies without, --settings with others)", flush=True)
        flight = replace(flight, settings=found, settings_found=True)
    return replace(request, flight=flight)


def _fly_one(request: FlyRequest, folder: Path, scratch: Path) -> int:
    clock_speed = request.clocks[0] if request.clocks else None
    options = replace(request.flight, folder=folder, clock_speed=clock_speed)
    with (request.page or nullcontext)():
        flown = fly(options)
    if request.check and flown.summary is not None and not flown.summary["calls"] and not flown.interrupted:
        print(f"not checked: the script {flown.ending} before any call", flush=True)
        return flown.status
    _print_result(flown, request.page is not None)
    if not request.check or flown.summary is None or flown.interrupted:
        return flown.status
    again = check(replace(options, folder=scratch / "again", film=False), folder)
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


def _fly_clocks(request: FlyRequest, folder: Path) -> int:
    """Fly at each ClockSpeed and print a line for it; the other flights are compared with the first."""
    clocks = request.clocks
    first = folder / f"clock-{clocks[0]:g}"
    statuses, slept, connected = [], False, False
    for clock in clocks:
        options = replace(request.flight, folder=folder / f"clock-{clock:g}", clock_speed=clock)
        flown = fly(options, quiet=clock != clocks[0])
        statuses.append(flown.status)
        if flown.summary is None or flown.interrupted:
            break
        slept |= flown.summary["slept_s"] > 0
        compared = connected and flown.summary["position_m"] is not None
        difference = _difference_text(options.folder, first, clocks[0]) if compared else ""
        if clock == clocks[0]:
            connected = flown.summary["position_m"] is not None
        text = _speed_text(flown.summary, request.page is not None)
        print(f"clock {clock:g}: {text}{difference}", flush=True)
    if slept:
        print(
            "the script sleeps while the clock runs: its sleeps are wall time, so at ClockSpeed k they let k times as "
            "much be flown, and its flights part by that"
        )
    return max(statuses)


def _difference_text(folder: Path, first: Path, clock_speed: float) -> str:
    from uavaccel.fly.trajectory import largest_difference_m

    metres = largest_difference_m(folder, first)
    return f", at most {metres:.3f} m from {clock_speed:g}x at equal times"


def _print_result(flown: FlightResult, watched: bool) -> None:
    if flown.summary is None:
        return
    summary = flown.summary
    stopped = "" if summary["finished"] else "interrupted; " if flown.status else "stopped by --until; "
    if summary["position_m"] is None:
        print(f"{stopped}{_speed_text(summary, watched)}", flush=True)
        return
    place = "".join(f" {metres:.2f}" for metres in summary["position_m"])
    thinking = f", {1000 * summary['think_s']:g} ms of thinking before each" if summary["think_s"] else ""
    print(f"{stopped}{_speed_text(summary, watched)}; {summary['calls']} calls{thinking}; at{place} m", flush=True)


def _speed_text(summary: FlightSummary, watched: bool) -> str:
    """How much was flown in what time, which says nothing of a flight that kept a spectator's pace."""
    if summary["position_m"] is None:
        return "no client connected, nothing was flown"
    simulated_s, wall_s = summary["simulated_s"], summary["wall_s"]
    if watched:
        return f"{simulated_s:.2f} simulated s, watched"
    return f"{simulated_s:.2f} simulated s in {wall_s:.2f} s, {simulated_s / wall_s:.0f} per wall second"
