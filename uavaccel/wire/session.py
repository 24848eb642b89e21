"""Sessions, in which games are flown, and the client that flies them, the commands' `MissionClient` over any transport.

A session has a server process in `wall`, and the simulation in this process in `virtual` and `lockstep`.
"""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Self

import numpy as np
from numpy.typing import NDArray

from uavaccel.clock import VirtualClock, positive_clock_speed
from uavaccel.errors import UserError
from uavaccel.kinematics import FlightGoal, Kinematics, VelocityGoal, airsim_command
from uavaccel.resources import scene_file
from uavaccel.sim.camera.view import HEIGHT, WIDTH, AnyImage
from uavaccel.sim.profile import PROFILES, Profile
from uavaccel.sim.recording import Recording
from uavaccel.sim.simulation import Simulation
from uavaccel.sim.vehicle.vehicle import Motion
from uavaccel.sim.world import World
from uavaccel.units import NS_PER_S
from uavaccel.wire.api import Api
from uavaccel.wire.game_api import Collision, SpeedReport, decode_state
from uavaccel.wire.image_api import decode_image
from uavaccel.wire.latency import ZERO_LATENCY, Latency, LatencyConfig
from uavaccel.wire.rpc import Received
from uavaccel.wire.transport import (
    PendingCall,
    SocketTransport,
    Transport,
    VirtualTransport,
    WatchedServer,
    modelled_simulation,
)

TIMINGS = ("wall", "virtual", "lockstep")
START_HEIGHT_M = -10.0  # NED z: 10 m up
_EXACT = True  # beyond AirSim's arguments: a time that does not fit an exact profile is refused, not rounded


class Client:
    """The calls of one connection to a simulation; they raise rpc.RpcError with the server's text.

    Several clients may share a transport, to which the known state belongs (transport.KnownState).
    """

    def __init__(self, transport: Transport, clock_speed: float = 1.0) -> None:
        self.transport = transport
        self.clock_speed = float(clock_speed)
        self._moving: PendingCall | None = None

    def call(self, method: str, *params: object) -> Received:
        """Call any method of the wire, and wait for its result."""
        call = self.transport.send(method, params, blocking=True)
        self.transport.wait(call)
        return call.outcome()

    def now_ns(self) -> int:
        return self.transport.clock.now_ns()

    # --- MissionClient ----------------------------------------------------------------------------

    def move_async(self, goal: FlightGoal, t_move_s: float) -> PendingCall:
        method, params = airsim_command(goal, t_move_s)
        params += ("", _EXACT) if isinstance(goal, VelocityGoal) else ("",)
        stands = self.transport.known.state is not None  # sending it at once would gain nothing
        call = self.transport.send(method, params, blocking=False, coalesced=stands)
        call.expected_ns = self._wall_after(t_move_s * NS_PER_S)
        self._moving = call
        return call

    def join(self, future: PendingCall, deadline_ns: int | None = None) -> bool:
        if not self.transport.wait(future, deadline_ns):
            return False
        future.outcome()
        return True

    def pause(self) -> None:
        self.call("simPause", True)

    def run(self) -> None:
        self.call("simPause", False)

    def continue_for(self, duration_ns: int) -> Kinematics:
        call = self.transport.send("uavaccelContinueFor", (duration_ns,), blocking=True)
        call.expected_ns = self._wall_after(duration_ns)
        self.transport.wait(call)
        state = decode_state(call.outcome())
        moving, self._moving = self._moving, None
        if moving is not None:
            moving.outcome()  # nobody joins TCSC's command; one that was refused has been answered by now
        self.transport.known.state = state
        return state

    def _wall_after(self, simulated_ns: float) -> int:
        return self.now_ns() + round(simulated_ns / self.clock_speed)

    def kinematics(self) -> Kinematics:
        return self.transport.known.state or decode_state(self.call("uavaccelState"))

    def read_sample(self, state: Kinematics) -> Kinematics:
        return state

    # --- games ------------------------------------------------------------------------------------

    def start_game(self, clock_speed: float, height_m: float = START_HEIGHT_M) -> Kinematics:
        """Start a game: a settled hover at NED z `height_m`, paused, with API control and recording on."""
        self.clock_speed, self._moving = float(clock_speed), None
        return decode_state(self.call("uavaccelStartGame", clock_speed, height_m))

    def set_lane(self, lane: object) -> None:
        """Lay out a lane: a seed, {"seed": n, "difficulty": {...}}, or a mapping of obstacles."""
        self.call("uavaccelSetLane", lane)

    def image(self, kind: str, size: tuple[int, int] = (WIDTH, HEIGHT)) -> AnyImage:
        """Return the front camera's present picture: gray, colour, depth or segmentation, of columns x rows.

        The known state stays known.
        """
        return decode_image(self.call("uavaccelImage", kind, *(() if size == (WIDTH, HEIGHT) else size)))

    def collision(self) -> Collision | None:
        """Return the vehicle's first collision since the start of the game, if any. The known state stays known."""
        collision: Collision | None = self.call("uavaccelCollision") or None
        return collision

    def speed(self) -> SpeedReport:
        """Return the requested and the achieved speed since the start of the game."""
        speed: SpeedReport = self.call("uavaccelSpeed")
        return speed

    def recording(self) -> Recording:
        """Return the game's samples and command log so far."""
        reply = self.call("uavaccelRecording")
        samples = np.frombuffer(reply["samples"], "<f8").reshape(-1, 14)
        commands = np.frombuffer(reply["commands"], "<i8").reshape(-1, 2)
        return Recording(samples, commands, reply["tick_ns"], reply["dropped"], reply["commands_dropped"])

    def trace(self, enabled: bool) -> list[tuple[str, int, int]]:
        """Switch the server's trace on or off, and return its events so far: (event, wall ns, simulated ns)."""
        return [tuple(event) for event in self.call("uavaccelTrace", enabled)]

    def close(self) -> None:
        self.transport.close()


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
    def picture(self, size: tuple[int, int] = (WIDTH, HEIGHT)) -> NDArray[np.uint8]:
        """Return the front camera's gray picture of this tick: taken inside the simulation, in `wall` by a message."""

    @abstractmethod
    def close(self) -> None:
        """End the session; its client cannot be used any more."""

    def set_latency(self, latency: LatencyConfig) -> None:  # noqa: B027  nothing to draw in `wall`
        """Draw latencies from this model from the next game on; its platform has to be the previous model's.

        No effect in `wall`, whose latencies are real.
        """

    def watch(self, every_ticks: int, observe: Callable[[int], None]) -> Callable[[], None]:
        """Call `observe` with the simulated time in ns once every so many ticks; the returned function ends that.

        It is called inside the simulation: no message is sent, and no wall time passes. Raises UserError in `wall`.
        """
        raise UserError("timing = 'wall': nobody looks at a flight between its messages; take virtual or lockstep")

    def motion(self) -> Motion:
        """Return how the vehicle moves at this tick, for `resume`. Raises UserError in `wall`."""
        raise UserError("timing = 'wall': nobody moves a vehicle between its messages; take virtual or lockstep")

    def resume(self, motion: Motion, share: float) -> None:
        """Let the vehicle fly on from where it is as it did then, its velocity and turn rate scaled by `share`."""
        self.motion()

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
            transport = SocketTransport(self.server)
        except BaseException:
            self.server.end()
            raise
        self._client = Client(transport)
        if core is not None:
            os.sched_setaffinity(0, self._cores - {core})

    def _connect(self, clock_speed: float, seed: np.random.SeedSequence) -> Client:
        self._client.transport.stalled_ns = 0
        return self._client

    def picture(self, size: tuple[int, int] = (WIDTH, HEIGHT)) -> NDArray[np.uint8]:
        return self._client.image("gray", size)

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
        return Client(VirtualTransport(Api(self._simulation), clock, latency), clock_speed)

    def watch(self, every_ticks: int, observe: Callable[[int], None]) -> Callable[[], None]:
        world = self._world(1.0 if self._simulation is None else float(self._simulation.clock_speed))
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
    scene_file(scene)  # an unknown scene raises here, and not in the server's process
    if timing == "wall":
        return WallSession(scene, profile)
    return VirtualSession(scene, profile, latency if timing == "virtual" else ZERO_LATENCY)
