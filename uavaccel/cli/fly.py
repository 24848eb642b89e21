"""`uavaccel fly`: an unmodified AirSim script, against a simulation in its own process."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import typer

from uavaccel.errors import UsageError, UserError
from uavaccel.fly.options import FlightOptions
from uavaccel.fly.process import DIFFERS
from uavaccel.fly.runs import Flown, check, fly
from uavaccel.fly.trajectory import largest_difference_m
from uavaccel.limits import CLOCK_SPEEDS, MOST_SECONDS, MOST_SEEDS
from uavaccel.resources import asset
from uavaccel.sim.profile import PROFILES
from uavaccel.wire.session import TIMINGS
from uavaccel.wire.settings import Settings, read_settings


@dataclass(frozen=True)
class FlyRequest:
    """What was asked for on the command line; `clocks` empty leaves it to the settings."""

    flight: FlightOptions
    clocks: tuple[float, ...] = ()
    check: bool = False
    out: Path | None = None


def parse_clocks(text: str | None) -> tuple[float, ...]:
    """The ClockSpeeds of "1,10,100". Raises UsageError."""
    try:
        clocks = tuple(float(part) for part in text.split(",")) if text else ()
    except ValueError:
        raise UsageError(
            f"--clock {text}: should be numbers with commas between, for example 1,10,100"
        ) from None
    if any(not CLOCK_SPEEDS[0] <= clock <= CLOCK_SPEEDS[1] for clock in clocks):
        least, most = CLOCK_SPEEDS
        raise UsageError(f"--clock {text}: every ClockSpeed must be above 0, from {least:g} to {most:g}")
    return clocks


def fly_script(request: FlyRequest) -> None:
    """Fly, compare and report. Raises typer.Exit with the script's exit status, UserError with one line."""
    _refuse_what_cannot_be(request)
    with tempfile.TemporaryDirectory(prefix="uavaccel-fly-") as scratch:
        folder = request.out or Path(scratch)
        several = len(request.clocks) > 1
        status = _fly_clocks(request, folder) if several else _fly_one(request, folder, Path(scratch))
    raise typer.Exit(status)


def _refuse_what_cannot_be(request: FlyRequest) -> None:
    flight = request.flight
    for option, value, known in (("timing", flight.timing, TIMINGS), ("profile", flight.profile, PROFILES)):
        if value not in known:
            raise UsageError(f"--{option} {value}: there are {', '.join(known)}")
    _refuse_numbers(flight)
    asset(f"mjcf/{flight.scene}.xml")
    if not flight.script.is_file():
        raise UserError(f"{flight.script}: no such file")
    if request.check and (flight.timing == "wall" or len(request.clocks) > 1):
        raise UsageError(
            "--check flies one ClockSpeed twice, in virtual or lockstep; wall is never the same twice"
        )
    if request.out is not None and request.out.exists() and any(request.out.iterdir()):
        raise UserError(f"{request.out}: is there already; choose another --out")
    if flight.timing == "wall" and (flight.film or flight.think_s):
        raise UsageError(
            "--film and --think need --timing virtual or lockstep: in wall time they would cost flight time"
        )
    if flight.film and request.out is None:
        raise UsageError("--film needs --out, a folder for it")


def _refuse_numbers(flight: FlightOptions) -> None:
    for option, seconds in (("think", flight.think_s), ("until", flight.until_s)):
        if seconds is not None and not 0.0 <= seconds <= MOST_SECONDS:
            raise UsageError(f"--{option} {seconds:g}: must be 0 to {MOST_SECONDS:g} s")
    if flight.seed is not None and not 0 <= flight.seed < MOST_SEEDS:
        raise UsageError(f"--seed {flight.seed}: must be 0 to {MOST_SEEDS - 1}")


def _fly_one(request: FlyRequest, folder: Path, scratch: Path) -> int:
    options = replace(request.flight, folder=folder, clock_speed=_clocks_of(request)[0])
    flown = fly(options)
    _say_how_it_went(flown)
    if request.check and flown.summary is not None:
        again = check(replace(options, folder=scratch / "again", film=False), folder)
        if again.status == DIFFERS:
            return 1
        print(
            f"checked: flown twice, {flown.summary['calls']} calls and the trajectory are equal to the byte"
        )
    return flown.status


def _fly_clocks(request: FlyRequest, folder: Path) -> int:
    """One line per ClockSpeed; the first one's flight is what the others are compared with."""
    clocks = _clocks_of(request)
    first = folder / f"clock-{clocks[0]:g}"
    statuses = []
    for clock in clocks:
        options = replace(request.flight, folder=folder / f"clock-{clock:g}", clock_speed=clock)
        flown = fly(options, quiet=clock != clocks[0])
        statuses.append(flown.status)
        if flown.summary is None:
            break
        difference = (
            ""
            if clock == clocks[0]
            else (
                f", at most {largest_difference_m(options.folder, first):.3f} m from {clocks[0]:g}x at equal times"
            )
        )
        print(f"clock {clock:g}: {_speed_text(flown.summary)}{difference}", flush=True)
    return max(statuses)


def _clocks_of(request: FlyRequest) -> Sequence[float]:
    if request.clocks:
        return request.clocks
    flight = request.flight
    return ((read_settings(flight.settings) if flight.settings else Settings()).clock_speed,)


def _say_how_it_went(flown: Flown) -> None:
    if flown.summary is None:
        return
    summary = flown.summary
    stopped = "" if summary["finished"] else "interrupted; " if flown.status else "stopped by --until; "
    place = "".join(f" {metres:.2f}" for metres in summary["position_m"] or ())
    print(f"{stopped}{_speed_text(summary)}; {summary['calls']} calls; at{place} m", flush=True)


def _speed_text(summary: dict[str, Any]) -> str:
    simulated_s, wall_s = summary["simulated_s"], summary["wall_s"]
    return f"{simulated_s:.2f} simulated s in {wall_s:.2f} s, {simulated_s / wall_s:.0f} per wall second"
