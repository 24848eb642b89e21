"""The client of this project: the commands' `MissionClient` over any transport, and our own calls for games."""

from __future__ import annotations

import numpy as np

from uavaccel.kinematics import FlightGoal, Kinematics, VelocityGoal, airsim_command
from uavaccel.sim.camera.view import HEIGHT, WIDTH, AnyImage
from uavaccel.sim.recording import Recording
from uavaccel.units import NS_PER_S
from uavaccel.wire.game_api import Collision, SpeedReport, decode_state
from uavaccel.wire.image_api import decode_image
from uavaccel.wire.rpc import Received
from uavaccel.wire.transport import PendingCall, Transport

START_HEIGHT_M = -10.0  # NED z: 10 m up
_EXACT = True  # beyond AirSim's arguments: a time that does not fit an exact profile is refused, not rounded


class Client:
    """The calls of one connection to a simulation; they raise rpc.RpcError with the server's text.

    Several clients may share a transport, to which the known state belongs (transport.KnownState).
    """

    def __init__(self, transport: Transport, clock_speed: float = 1.0) -> None:
        self.transport = transport
        self.clock_speed = float(clock_speed)

    def call(self, method: str, *params: object) -> Received:
        """Call any method of the wire, and wait for its result."""
        call = self.transport.send(method, params, blocking=True)
        self.transport.wait(call)
        return call.result()

    def now_ns(self) -> int:
        return self.transport.clock.now_ns()

    # --- MissionClient ----------------------------------------------------------------------------

    def move_async(self, goal: FlightGoal, t_move_s: float) -> PendingCall:
        method, params = airsim_command(goal, t_move_s)
        params += ("", _EXACT) if isinstance(goal, VelocityGoal) else ("",)
        stands = self.transport.known.state is not None  # sending it at once would gain nothing
        call = self.transport.send(method, params, blocking=False, coalesced=stands)
        call.expected_ns = self._wall_after(t_move_s * NS_PER_S)
        return call

    def join(self, future: PendingCall, deadline_ns: int | None = None) -> bool:
        if not self.transport.wait(future, deadline_ns):
            return False
        future.result()
        return True

    def pause(self) -> None:
        self.call("simPause", True)

    def run(self) -> None:
        self.call("simPause", False)

    def continue_for(self, duration_ns: int) -> Kinematics:
        call = self.transport.send("uavaccelContinueFor", (duration_ns,), blocking=True)
        call.expected_ns = self._wall_after(duration_ns)
        self.transport.wait(call)
        state = decode_state(call.result())
        self.transport.known.paused_at(state)
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
        self.clock_speed = float(clock_speed)
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
