"""The process in which a script flies; it leaves its flight in a folder.

    python -m uavaccel.fly.process OPTIONS

OPTIONS are those of `FlightOptions.to_json`. Exit status: the script's; DIFFERS where a flight is not as its reference.
"""

from __future__ import annotations

import random
import sys
from typing import Any

import numpy as np

from uavaccel.errors import UserError
from uavaccel.files import to_json
from uavaccel.fly.messages import DifferenceError, MessageLog
from uavaccel.fly.options import FlightOptions
from uavaccel.fly.script import compiled, flush_output, unraisable
from uavaccel.fly.simulated import SimulatedFlight
from uavaccel.fly.wall import WallFlight
from uavaccel.wire.settings import Settings, read_settings

DIFFERS = 3
SUMMARY = "flight.json"


def main() -> None:
    options = FlightOptions.from_json(sys.argv[1])
    sys.unraisablehook = unraisable
    try:
        status = fly(options)
    except DifferenceError as error:
        status = _complain(str(error), DIFFERS)
    except UserError as error:
        status = _complain(f"error: {error}", error.exit_status)
    except KeyboardInterrupt:
        status = _complain("interrupted", 130)
    flush_output()
    sys.exit(status)


def _complain(text: str, status: int) -> int:
    flush_output()
    print(f"uavaccel: {text}", file=sys.stderr)
    return status


def fly(options: FlightOptions) -> int:
    """Fly a script, and write messages, trajectory and summary; returns its exit status. Raises UserError."""
    compiled(options.script)  # what is no Python is said before anything is built
    settings = read_settings(options.settings) if options.settings else Settings()
    clock_speed = settings.clock_speed if options.clock_speed is None else options.clock_speed
    log = MessageLog(options.folder, options.reference)
    kind: type[WallFlight | SimulatedFlight] = WallFlight if options.timing == "wall" else SimulatedFlight
    flight: Any = kind(options, settings, clock_speed, log)
    if options.seed is not None:
        random.seed(options.seed)
        np.random.seed(options.seed)  # noqa: NPY002  the generator that scripts use
    outcome = flight.run()
    flush_output()
    flight.end()
    log.close()
    summary = {"clock_speed": clock_speed, "calls": log.calls, **outcome._asdict(), **flight.summary()}
    (options.folder / SUMMARY).write_text(to_json(summary, indent=2) + "\n", encoding="utf-8")
    return outcome.status


if __name__ == "__main__":
    main()
