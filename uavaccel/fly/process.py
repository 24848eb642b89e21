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
import threading
from functools import partial
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

from uavaccel.errors import UserError, mistake_of
from uavaccel.files import replacing, to_json
from uavaccel.fly.log import DifferenceError, MessageLog
from uavaccel.fly.modules import Patches
from uavaccel.fly.options import DIFFERENCE, INTERRUPT_SEEN, SUMMARY, FlightOptions
from uavaccel.fly.script import (
    INTERRUPTED,
    FlightOver,
    ScriptResult,
    checked_output,
    compiled,
    flush_output,
    unraisable,
)
from uavaccel.processes.lifetime import end_with_parent, lost_interrupts_repeated

if TYPE_CHECKING:
    from uavaccel.fly.simulated import SimulatedFlight
    from uavaccel.fly.wall import WallFlight
    from uavaccel.wire.settings import Settings

HINT = "\n  a script that draws random numbers flies the same with --seed 0"  # where there was none


def main() -> None:
    options = FlightOptions.from_json(sys.argv[1])

    def clear_away() -> None:
        """Remove the temporary folder when the starting process, which would do so, was killed."""
        os.write(2, b"uavaccel: error: the process that started this flight was killed; the script ends too\n")
        if options.scratch is not None:
            shutil.rmtree(options.scratch, ignore_errors=True)

    def interrupt(number: int, frame: FrameType | None) -> None:
        """Interrupt the script at SIGTERM and Ctrl-C; the file INTERRUPT_SEEN tells the starting process of it."""
        if options.scratch is not None:
            (options.scratch / INTERRUPT_SEEN).touch()
        signal.default_int_handler(signal.SIGINT, frame)

    end_with_parent(int(sys.argv[2]), clear_away)
    for kind in (signal.SIGINT, signal.SIGTERM):
        signal.signal(kind, interrupt)
    sys.unraisablehook = unraisable
    try:
        with lost_interrupts_repeated(), checked_output():
            status = fly(options)
    except DifferenceError as error:
        said = f"{error}{'' if options.seed is not None else HINT}"
        _write(options.folder / DIFFERENCE, f"{said}\n")
        status = _complain(said, 1)
    except Exception as error:
        if (mistake := mistake_of(error)) is None:
            raise
        status = _complain(f"error: {mistake}", mistake.exit_status)
    except KeyboardInterrupt:
        status = _complain("interrupted", INTERRUPTED)
    flush_output()
    sys.exit(status)


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
    flight: SimulatedFlight | WallFlight
    if options.timing == "wall":
        from uavaccel.fly.wall import WallFlight

        flight = WallFlight(options, settings, clock_speed, log)
    else:
        from uavaccel.fly.simulated import SimulatedFlight

        flight = SimulatedFlight(options, settings, clock_speed, log)

    def finish(outcome: ScriptResult) -> int:
        """Write what was flown, which nothing interrupts."""
        for kind in (signal.SIGINT, signal.SIGTERM):
            signal.signal(kind, signal.SIG_IGN)
        flush_output()
        flight.end()
        log.close(ended=outcome.finished or outcome.status != INTERRUPTED)
        chosen = {"clock_speed": clock_speed, "scene": options.scene}
        summary = {**chosen, "calls": log.calls, **outcome._asdict(), **flight.summary()}
        _write(options.folder / SUMMARY, to_json(summary, indent=2) + "\n")
        return outcome.status

    def end_within(wall_s: float) -> None:
        """End this process from within a script that does not let it end."""
        status = 1
        try:
            if threading.current_thread() is threading.main_thread():
                status = finish(ScriptResult(0, False, wall_s - flight.unflown_s))
        except UserError as error:
            _complain(f"error: {error}", 1)
        finally:
            os._exit(status)

    with Patches() as patches:
        patches.set(FlightOver, "end", staticmethod(end_within))
        if options.seed is not None:
            _seed(options.seed, patches)
        outcome = flight.run()
    return finish(outcome)


def _seed(seed: int, patches: Patches) -> None:
    """Seed the global generators, and every generator that is made without a seed."""
    random.seed(seed)
    seeds, given = random.Random(seed), random.Random.seed

    def seeded(self: random.Random, a: Any = None, version: int = 2) -> None:
        given(self, seeds.getrandbits(63) if a is None else a, version)

    patches.set(random.Random, "seed", seeded)
    patches.set(random, "seed", partial(seeded, random._inst))  # the module's own, bound before
    patches.when_imported("numpy", lambda numpy: numpy.random.seed(seed))  # which scripts use
    entropy = "numpy.random.bit_generator"  # of NumPy's and Gymnasium's generators
    patches.when_imported(entropy, lambda module: patches.set(module, "randbits", seeds.getrandbits))
    patches.when_imported("torch", lambda torch: torch.manual_seed(seed))


def _write(path: Path, text: str) -> None:
    """Write the whole file or none: the starting process reads it."""
    with replacing(path) as file:
        file.write(text.encode())


def settings_of(options: FlightOptions) -> Settings | None:
    """Return the settings of the options' file, if any. Raises UserError if a file that was named is invalid."""
    if options.settings is None:
        return None
    from uavaccel.wire.settings import read_settings

    settings = None
    try:
        settings = read_settings(options.settings)
        warning = settings.warning(options.settings)
    except UserError as error:
        if not options.settings_found:
            raise
        warning = f"{error}; flown without"
    if warning and options.reference is None:
        print(f"uavaccel: warning: {warning}", file=sys.stderr, flush=True)
    return settings


if __name__ == "__main__":
    main()
