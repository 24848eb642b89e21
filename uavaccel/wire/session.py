"""A session, in which games are flown: with a server process in `wall`, in this process in `virtual` and `lockstep`."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Self

import numpy as np
from numpy.typing import NDArray

from uavaccel.clock import VirtualClock, positive_clock_speed
from uavaccel.errors import UserError
from uavaccel.resources import asset
from uavaccel.sim.camera.view import HEIGHT, WIDTH
from uavaccel.sim.profile import PROFILES, Profile
from uavaccel.sim.simulation import Simulation
from uavaccel.sim.vehicle.vehicle import Motion
from uavaccel.sim.world import World
from uavaccel.wire.api import Api
from uavaccel.wire.client import START_HEIGHT_M, Client
from uavaccel.wire.latency import ZERO_LATENCY, Latency, LatencyConfig
from uavaccel.wire.rpc import LOOPBACK
from uavaccel.wire.server_watch import WatchedServer
from uavaccel.wire.transport import SocketTransport, VirtualTransport, modelled_simulation

TIMINGS = ("wall", "virtual", "lockstep")


class Session(ABC):
    """Starts games and returns the client that flies them. A context manager that closes itself."""

    def start_game(
        self,
        clock_speed: float,
        seed: np.random.SeedSequence | None = None,
        lane: object = None,
        height_m: float = START_HEIGHT_M,
    ) -> Client:
        """Start a game: a settled hover, paused and recording, at NED z `height_m`.

        The latencies of a simulated wall clock are drawn from `seed`. In the lane's scene `lane` is laid out first: a
        seed or anything else that Client.set_lane takes.
        """
        positive_clock_speed(clock_speed)
        client = self._connect(clock_speed, seed or np.random.SeedSequence(0))
        if lane is not None:
            client.set_lane(lane)
        client.start_game(clock_speed, height_m)
        return client

    @abstractmethod
    def _connect(self, clock_speed: float, seed: np.random.SeedSequence) -> Client:
        """Return the client of a new game."""

    @abstractmethod
    def set_latency(self, latency: LatencyConfig) -> None:
        """Draw latencies from this model from the next game on; its platform has to be the previous model's.

        No effect in `wall`, whose latencies are real.
        """

    @abstractmethod
    def watch(self, every_ticks: int, observe: Callable[[int], None]) -> Callable[[], None]:
        """Call `observe` with the simulated time in ns once every so many ticks; the returned function ends that.

        It is called inside the simulation: no message is sent, and no wall time passes. Raises UserError in `wall`.
        """

    @abstractmethod
    def picture(self, size: tuple[int, int] = (WIDTH, HEIGHT)) -> NDArray[np.uint8]:
        """Return the front camera's gray picture of this tick: taken inside the simulation, in `wall` by a message."""

    @abstractmethod
    def motion(self) -> Motion:
        """Return how the vehicle moves at this tick, for `resume`. Raises UserError in `wall`."""

    @abstractmethod
    def resume(self, motion: Motion, share: float) -> None:
        """Let the vehicle fly on from where it is as it did then, its velocity and turn rate scaled by `share`."""

    @abstractmethod
    def close(self) -> None:
        """End the session; its client cannot be used any more."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()


class WallSession(Session):
    """A server on loopback, paced by the machine's clock, in a process and, on two cores or more, on a core of its own.

    Until it is closed, this process stays off that core: the kernel tends to put two processes that talk to each other
    on one core, where each waits for the other. Calls raise ServerGoneError within 5 s if the server hangs or ends.
    """

    def __init__(self, scene: str, profile: str) -> None:
        self._cores = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set()
        core = max(self._cores) if len(self._cores) > 1 else None
        self.server = WatchedServer({"scene": scene, "profile": profile, "core": core})
        try:
            transport = SocketTransport(LOOPBACK, self.server.port, exclusive=True, watch=self.server)
        except BaseException:
            self.server.end()
            raise
        self._client = Client(transport)
        if core is not None:
            os.sched_setaffinity(0, self._cores - {core})

    def _connect(self, clock_speed: float, seed: np.random.SeedSequence) -> Client:
        self._client.transport.stalled_ns = 0
        return self._client

    def set_latency(self, latency: LatencyConfig) -> None:
        pass

    def watch(self, every_ticks: int, observe: Callable[[int], None]) -> Callable[[], None]:
        raise UserError("timing = 'wall': nobody looks at a flight between its messages; take virtual or lockstep")

    def picture(self, size: tuple[int, int] = (WIDTH, HEIGHT)) -> NDArray[np.uint8]:
        return self._client.image("gray", size)

    def motion(self) -> Motion:
        raise UserError("timing = 'wall': nobody moves a vehicle between its messages; take virtual or lockstep")

    def resume(self, motion: Motion, share: float) -> None:
        self.motion()

    def close(self) -> None:
        if len(self._cores) > 1:
            os.sched_setaffinity(0, self._cores)
        self._client.close()
        self.server.end()


class VirtualSession(Session):
    """The simulation in this process, under a simulated wall clock; without latency it is `lockstep`."""

    def __init__(self, scene: str, profile: str, latency: LatencyConfig = ZERO_LATENCY) -> None:
        self._scene, self._profile, self._latency = scene, profile, latency
        self._simulation: Simulation | None = None
        self._worlds: dict[Profile, World] = {}
        self._world(1.0)

    def set_latency(self, latency: LatencyConfig) -> None:
        self._latency = latency

    def _world(self, clock_speed: float) -> World:
        """Return the world for a ClockSpeed: one world for all, unless the latency model's platform depends on it."""
        profile = self._latency.platform.profile(self._profile, clock_speed)
        if profile not in self._worlds:
            self._worlds[profile] = World(self._scene, profile)
        return self._worlds[profile]

    def _connect(self, clock_speed: float, seed: np.random.SeedSequence) -> Client:
        clock, latency = VirtualClock(), Latency(self._latency, seed)
        self._simulation = modelled_simulation(self._world(clock_speed), clock_speed, latency)
        return Client(VirtualTransport(Api(self._simulation), clock, latency, exclusive=True), clock_speed)

    def watch(self, every_ticks: int, observe: Callable[[int], None]) -> Callable[[], None]:
        begun = self._simulation
        world = self._world(1.0 if begun is None else float(begun.clock_speed))
        return world.watch(every_ticks, lambda tick: observe(self._present().time_of(tick)))

    def _present(self) -> Simulation:
        assert self._simulation is not None, "no game has begun"
        return self._simulation

    def picture(self, size: tuple[int, int] = (WIDTH, HEIGHT)) -> NDArray[np.uint8]:
        world = self._present().world
        return world.camera(*size).gray(world.data)

    def motion(self) -> Motion:
        return self._present().world.lead.motion()

    def resume(self, motion: Motion, share: float) -> None:
        self._present().world.resume(motion, share)

    def close(self) -> None:
        for world in self._worlds.values():
            world.close()


def open_session(
    timing: str = "wall", profile: str = "native", scene: str = "blocks", latency: LatencyConfig = ZERO_LATENCY
) -> Session:
    """Open a session with one of TIMINGS; `latency` is used in `virtual` only. Raises UserError for an unknown name."""
    for name, value, known in (("timing", timing, TIMINGS), ("profile", profile, PROFILES)):
        if value not in known:
            raise UserError(f"{name} = {value!r} is unknown; there are {', '.join(known)}")
    asset(f"mjcf/{scene}.xml")  # an unknown scene raises here, and not in the server's process
    if timing == "wall":
        return WallSession(scene, profile)
    return VirtualSession(scene, profile, latency if timing == "virtual" else ZERO_LATENCY)
