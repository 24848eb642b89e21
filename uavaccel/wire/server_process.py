"""The server process of a session: serves on a free loopback port until its standard input ends.

    python -m uavaccel.wire.server_process '{"scene": "blocks", "profile": "native", "core": null, "parent": 1}'

prints one line of JSON, {"port": ...}, when it listens.
"""

from __future__ import annotations

import contextlib
import gc
import json
import os
import sys

from uavaccel.clock import MonotonicClock
from uavaccel.processes.lifetime import end_with_parent
from uavaccel.sim.profile import PROFILES, Profile
from uavaccel.sim.simulation import Simulation
from uavaccel.sim.world import World
from uavaccel.wire.api import Api
from uavaccel.wire.broadcast import show_on_page
from uavaccel.wire.server import Server


def main() -> None:
    options = json.loads(sys.argv[1])
    end_with_parent(options["parent"])
    if options["core"] is not None:
        os.sched_setaffinity(0, {options["core"]})
    simulation = ready_simulation(options["scene"], PROFILES[options["profile"]])
    simulation.pause(MonotonicClock().now_ns())
    server = Server(Api(simulation), port=0, stop_at_eof=sys.stdin.buffer)
    with contextlib.suppress(BrokenPipeError):  # the session has gone: standard input has ended too
        print(json.dumps({"port": server.address[1]}), flush=True)
    server.serve()


def ready_simulation(scene: str, profile: Profile, clock_speed: float = 1.0, airsim: bool = False) -> Simulation:
    """Return a settled hover on the machine's clock, with everything compiled and loaded that could delay it later.

    `airsim` prepares the scene for AirSim's clients (uavaccel.sim.scene).
    """
    world = World(scene, profile, airsim)
    world.advance(1)  # compiles the hot loop, or loads it
    world.reset()
    gc.freeze()  # what is loaded by now stays; collecting it again would delay the clock
    simulation = Simulation(world, clock_speed, MonotonicClock().now_ns(), profile.catch_up_wall_ns)
    show_on_page(simulation, may_pause=False)
    return simulation


if __name__ == "__main__":
    main()
