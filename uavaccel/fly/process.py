"""The process in which a script flies; it writes the flight to a folder.

    python -m uavaccel.fly.process OPTIONS PARENT

OPTIONS is the result of `FlightOptions.to_json`; PARENT is the number of the starting process, with which it ends. The
exit status is the script's. A flight that differs from its reference writes the file DIFFERENCE.
"""

from __future__ import annotations

import os
import random
import shutil
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from types import FrameType, ModuleType
from typing import TYPE_CHECKING

from uavaccel.errors import UserError, mistake_of
from uavaccel.fly.messages import DifferenceError, MessageLog
from uavaccel.fly.modules import Patches
from uavaccel.fly.options import DIFFERENCE, INTERRUPT_SEEN, SUMMARY, FlightOptions
from uavaccel.fly.script import INTERRUPTED, checked_output, compiled, flush_output, unraisable
from uavaccel.processes.lifetime import end_with_parent

if TYPE_CHECKING:
    from uavaccel.fly.simulated import SimulatedFlight
    from uavaccel.fly.wall import WallFlight
    from uavaccel.wire.settings import Settings


def main() -> None:
    options = FlightOptions.from_json(sys.argv[1])
    end_with_parent(int(sys.argv[2]), lambda: _clear_away(options))
    for kind in (signal.SIGINT, signal.SIGTERM):
        signal.signal(kind, lambda number, frame: _interrupt(options, frame))
    sys.unraisablehook = unraisable
    try:
        with checked_output():
            status = _fly_or_differ(options)
    except Exception as error:
        if (mistake := mistake_of(error)) is None:
            raise
        status = _complain(f"error: {mistake}", mistake.exit_status)
    except KeyboardInterrupt:
        status = _complain("interrupted", INTERRUPTED)
    flush_output()
    sys.exit(status)


def _fly_or_differ(options: FlightOptions) -> int:
    try:
        return fly(options)
    except DifferenceError as error:
        _write(options.folder / DIFFERENCE, f"{error}\n")
        return _complain(str(error), 1)


def _interrupt(options: FlightOptions, frame: FrameType | None) -> None:
    """Interrupt the script at SIGTERM and at Ctrl-C; the file INTERRUPT_SEEN tells the starting process that it did."""
    if options.scratch is not None:
        (options.scratch / INTERRUPT_SEEN).touch()
    signal.default_int_handler(signal.SIGINT, frame)


def _clear_away(options: FlightOptions) -> None:
    """Remove the temporary folder when the starting process, which would do so, was killed."""
    os.write(2, b"uavaccel: error: the process that started this flight was killed; the script ends too\n")
    if options.scratch is not None:
        shutil.rmtree(options.scratch, ignore_errors=True)


def _complain(text: str, status: int) -> int:
    flush_output()
    print(f"uavaccel: {text}", file=sys.stderr)
    return status


def fly(options: FlightOptions) -> int:
    """Fly a script, and write messages, trajectory and summary; returns its exit status. Raises UserError."""
    compiled(options.script)  # a syntax error is reported before anything is built
    settings = settings_of(options)
    given = 1.0 if settings is None else settings.clock_speed
    clock_speed = given if options.clock_speed is None else options.clock_speed
    log = MessageLog(options.folder, options.reference)
    flight = _flight(options, settings, clock_speed, log)
    with Patches() as patches:
        if options.seed is not None:
            _seed(options.seed, patches)
        outcome = flight.run()
    for kind in (signal.SIGINT, signal.SIGTERM):  # nothing interrupts writing what was flown
        signal.signal(kind, signal.SIG_IGN)
    flush_output()
    flight.end()
    if outcome.status == INTERRUPTED and not outcome.finished:
        log.close_file()  # it was not flown to the end of any reference
    else:
        log.close()
    chosen = {"clock_speed": clock_speed, "scene": options.scene}
    summary = {**chosen, "calls": log.calls, **outcome._asdict(), **flight.summary()}
    from uavaccel.files import to_json

    _write(options.folder / SUMMARY, to_json(summary, indent=2) + "\n")
    return outcome.status


def _seed(seed: int, patches: Patches) -> None:
    """Seed the global generators, and every generator that is made without a seed."""
    random.seed(seed)
    seeds = random.Random(seed)

    def seed_numpy(numpy: ModuleType) -> None:
        numpy.random.seed(seed)  # which scripts use
        seed_made(numpy.random, "default_rng")

    def seed_made(module: ModuleType, name: str) -> None:
        make: Callable[..., object] = getattr(module, name)
        patches.set(module, name, lambda seed=None, *rest: make(seeds.getrandbits(63) if seed is None else seed, *rest))

    patches.when_imported("numpy", seed_numpy)
    patches.when_imported("torch", lambda torch: torch.manual_seed(seed))
    patches.when_imported("gymnasium.utils.seeding", lambda module: seed_made(module, "np_random"))


def _write(path: Path, text: str) -> None:
    """Write the whole file or none: the starting process reads it."""
    from uavaccel.files import replacing

    with replacing(path) as file:
        file.write(text.encode())


def settings_of(options: FlightOptions) -> Settings | None:
    """Return the settings of the options' file, if any. Raises UserError if a file that was named is invalid."""
    if options.settings is None:
        return None
    from uavaccel.wire.settings import read_settings

    try:
        return read_settings(options.settings)
    except UserError as error:
        if not options.settings_found:
            raise
        print(f"uavaccel: warning: {error}; flown without", file=sys.stderr, flush=True)
        return None


def _flight(
    options: FlightOptions, settings: Settings | None, clock_speed: float, log: MessageLog
) -> SimulatedFlight | WallFlight:
    if options.timing == "wall":
        from uavaccel.fly.wall import WallFlight

        return WallFlight(options, settings, clock_speed, log)
    from uavaccel.fly.simulated import SimulatedFlight

    return SimulatedFlight(options, settings, clock_speed, log)


if __name__ == "__main__":
    main()
