"""The process that a session starts: one server on a free loopback port, until standard input ends.

    python -m uavaccel.wire.host '{"scene": "blocks", "profile": "native", "core": null}'

prints one line of JSON, {"port": ...}, when it listens.
"""

from __future__ import annotations

import gc
import json
import os
import sys

from uavaccel.clock import MonotonicClock
from uavaccel.sim.profile import PROFILES
from uavaccel.sim.simulation import Simulation
from uavaccel.sim.world import World
from uavaccel.wire.api import Api
from uavaccel.wire.server import Server


def main() -> None:
    options = json.loads(sys.argv[1])
    if options["core"] is not None:
        os.sched_setaffinity(0, {options["core"]})
    profile = PROFILES[options["profile"]]
    world = World(options["scene"], profile)
    world.advance(1)  # compile, or load, the hot loop before anything is timed
    world.reset()
    simulation = Simulation(world, 1.0, MonotonicClock().now_ns(), profile.catch_up_wall_ns)
    simulation.pause(MonotonicClock().now_ns())
    server = Server(Api(simulation, {"SimMode": "Multirotor"}), port=0, stop_at_eof=sys.stdin.buffer)
    gc.freeze()  # what is loaded by now stays; collecting it again and again would hold the clock up
    print(json.dumps({"port": server.address[1]}), flush=True)
    server.serve()


if __name__ == "__main__":
    main()
