"""The process in which a script flies on a simulated clock; it leaves its flight in a folder.

    python -m uavaccel.fly.process OPTIONS

OPTIONS are those of `FlightOptions.to_json`. Exit status: the script's; DIFFERS where a flight is not as its reference.
"""

from __future__ import annotations

import random
import sys

import numpy as np

from uavaccel.airsim.connection import connect_with
from uavaccel.clock import MonotonicClock, datetime_module, time_module
from uavaccel.errors import UserError
from uavaccel.files import to_json
from uavaccel.fly import shims
from uavaccel.fly.flight import Enough, Flight, running_api
from uavaccel.fly.messages import DifferenceError, MessageLog
from uavaccel.fly.modules import client_modules, importing
from uavaccel.fly.options import FlightOptions
from uavaccel.fly.script import compiled, flush_output, run_script
from uavaccel.fly.trajectory import INTERVAL_NS, Trajectory
from uavaccel.units import NS_PER_S
from uavaccel.wire.latency import ZERO_LATENCY, shipped_latency
from uavaccel.wire.settings import Settings, read_settings

DIFFERS = 3
SUMMARY = "flight.json"


def main() -> None:
    options = FlightOptions.from_json(sys.argv[1])
    try:
        status = fly(options)
    except DifferenceError as error:
        status = _complain(str(error), DIFFERS)
    except UserError as error:
        status = _complain(str(error), error.exit_status)
    except KeyboardInterrupt:
        status = _complain("interrupted", 130)
    flush_output()
    sys.exit(status)


def _complain(text: str, status: int) -> int:
    flush_output()
    print(f"uavaccel: {text}", file=sys.stderr)
    return status


def fly(options: FlightOptions) -> int:
    """Fly a script, and write messages, trajectory and summary. Raises UserError."""
    compiled(options.script)  # what is no Python is said before anything is built
    settings = read_settings(options.settings) if options.settings else Settings()
    clock_speed = settings.clock_speed if options.clock_speed is None else options.clock_speed
    latency = ZERO_LATENCY if options.timing == "lockstep" else shipped_latency(options.profile)
    api = running_api(settings, clock_speed, options.profile, options.scene, latency)
    api.refusals.tell = lambda line: print(f"uavaccel: warning: {line}", file=sys.stderr, flush=True)
    log = MessageLog(options.folder, options.reference)
    flight = Flight(api, latency, log, options.think_s, options.until_s)
    trajectory = watched(flight)
    clock, finished = MonotonicClock(), False
    begun_ns = clock.now_ns()
    try:
        status = in_its_world(flight, options)
        finished = True
    except Enough:
        status = 0
    wall_s = (clock.now_ns() - begun_ns) / NS_PER_S
    flight.end()
    trajectory.write(options.folder)
    if refused := api.refusals.lines():
        print("uavaccel: refused calls:", *refused, sep="\n  ", file=sys.stderr)
    summary = flight.summary() | {"status": status, "finished": finished, "wall_s": wall_s}
    (options.folder / SUMMARY).write_text(to_json(summary, indent=2) + "\n", encoding="utf-8")
    return status


def watched(flight: Flight) -> Trajectory:
    """A trajectory that grows with the flight, and begins where it begins."""
    trajectory, simulation = Trajectory(), flight.simulation
    every = max(1, INTERVAL_NS // simulation.profile.tick_ns)
    trajectory.add(simulation.kinematics())
    simulation.world.watch(every, lambda _: trajectory.add(simulation.kinematics()))
    return trajectory


def in_its_world(flight: Flight, options: FlightOptions) -> int:
    """Run the script with our client, its clock and what its Python lacks; returns its exit status."""
    if options.seed is not None:
        random.seed(options.seed)
        np.random.seed(options.seed)  # noqa: NPY002  the generator that scripts use
    shims.supply(flight.sleep)
    clocks = {
        "time": time_module(flight.epoch_now_ns, flight.sleep),
        "datetime": datetime_module(flight.epoch_now_ns),
    }
    with connect_with(lambda host, port, timeout_s: flight), importing(client_modules(), clocks):
        return run_script(options.script, options.arguments)


if __name__ == "__main__":
    main()
