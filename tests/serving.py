"""A real server in a thread, and clients for tests that speak to it over a socket."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from uavaccel.airsim import MultirotorClient
from uavaccel.sim.profile import PROFILES
from uavaccel.wire.api import Api
from uavaccel.wire.server import Server
from uavaccel.wire.service import ready_simulation


@contextmanager
def running_server(clock_speed: float = 1.0, profile: str = "native", **api: Any) -> Iterator[Server]:
    """Free-running, like AirSim: not paused, API control off. An error in the server's thread fails the test."""
    simulation = ready_simulation("blocks", PROFILES[profile], clock_speed)
    server = Server(Api(simulation, **api), port=0)
    thread = threading.Thread(target=server.serve)
    thread.start()
    try:
        yield server
    finally:
        assert thread.is_alive(), "the server has died"
        server.stop()
        thread.join()


@contextmanager
def client_of(port: int) -> Iterator[MultirotorClient]:
    """A client that leaves at the end."""
    client = MultirotorClient(port=port)
    try:
        yield client
    finally:
        client.client.close()
