"""Our own calls for games: they start a game in a lane, fly it for simulated time, and read its results.

A state on the wire is a flat list of numbers (`encode_state`), smaller and packed faster than AirSim's maps.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, TypedDict

from uavaccel.kinematics import Kinematics
from uavaccel.sim.flight.pilot import DeferredReply
from uavaccel.sim.world import START_M
from uavaccel.wire.arguments import Coordinate, number
from uavaccel.wire.calls import Calls, call
from uavaccel.wire.image_api import clutter_layout, lane_layout
from uavaccel.wire.rpc import Received

FASTEST = 1e4  # ClockSpeed; ten times what one core can fly


def nanoseconds(value: object, name: str) -> int:
    """A duration in whole nanoseconds, of any length."""
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise ValueError(f"{name} must be a whole number of nanoseconds, 0 or more, not {value!r}")
    return value


def clock_speed(value: object, name: str) -> float:
    """A ClockSpeed of at most FASTEST; the simulation refuses 0 and below."""
    speed = number(value, name)
    if speed > FASTEST:
        raise ValueError(f"{name} must be at most {FASTEST:g}, not {speed:g}")
    return speed


ClockSpeed = Annotated[float, clock_speed]


class Collision(TypedDict):
    """The first collision of a game: simulated ns and NED."""

    time_ns: int
    object: str
    position_m: list[float]


class SpeedReport(TypedDict):
    """The requested and the achieved speed since the last reset, and the failure that ended the flight, if any."""

    clock_speed: float
    real_time_factor: float
    simulated_ns: int
    wall_ns: int
    lost_wall_ns: int
    failure: str | None


class GameApi(Calls, title="Games"):
    @call("uavaccelState", "state")
    def state(self) -> list[float]:
        """Return the present state (`encode_state`)."""
        return encode_state(self.simulation.kinematics())

    @call("uavaccelContinueFor", "continue_for")
    def continue_for(self, duration_ns: Annotated[int, nanoseconds]) -> DeferredReply:
        """Run for simulated nanoseconds, pause, and return the state (`encode_state`)."""
        reply = self.simulation.continue_for(duration_ns, self.wall_ns)
        reply.encode = encode_state
        return reply

    @call("uavaccelStartGame")
    def start(self, clock_speed: ClockSpeed, height_m: Coordinate = START_M[2]) -> list[float]:
        """Start a game in a settled hover at a NED z, paused, recording, with API control; returns the state."""
        simulation, wall_ns = self.simulation, self.wall_ns
        simulation.set_clock_speed(clock_speed, wall_ns)
        self.context.recorder.keep()
        simulation.records_game = True
        simulation.pause(wall_ns)
        simulation.reset(wall_ns, (START_M[0], START_M[1], height_m), recording=True)
        simulation.lead.api_control = True
        return encode_state(simulation.kinematics())

    @call("uavaccelSetClockSpeed")
    def set_clock_speed(self, clock_speed: ClockSpeed) -> None:
        self.simulation.set_clock_speed(clock_speed, self.wall_ns)

    @call("uavaccelSetLane")
    def set_lane(self, lane: object) -> None:
        """Lay out a lane: a seed, {"seed": n, "difficulty": {...}}, or obstacles; or {"clutter", "seed", "goal_m"}."""
        if isinstance(lane, Mapping) and "clutter" in lane:
            self.simulation.world.set_clutter(clutter_layout(lane))
            return
        layout, world = lane_layout(lane), self.simulation.world
        moves = layout.scenery != world.scenery
        world.set_lane(layout)
        if moves:  # the scene has a new model
            self.simulation.frames.forget()
            self.scenery.forget()

    @call("uavaccelCollision", leaves_state=True)
    def collision(self) -> Collision | dict[str, object]:
        """Return time, object and position of the first collision, in simulated ns and NED; empty without one."""
        world = self.simulation.world
        touch = world.lead.contact_log.first
        if touch is None:
            return {}
        return {
            "time_ns": self.simulation.time_of(touch.tick),
            "object": touch.object,
            "position_m": list(world.lead.local(touch.position_m)),
        }

    @call("uavaccelSpeed", leaves_state=True)
    def speed(self) -> SpeedReport:
        """Return the requested and the achieved speed since the last reset, and the failure, if any."""
        speed = self.simulation.speed
        return {
            "clock_speed": float(self.simulation.clock_speed),
            "real_time_factor": speed.real_time_factor,
            "simulated_ns": speed.simulated_ns,
            "wall_ns": speed.wall_ns,
            "lost_wall_ns": speed.lost_wall_ns,
            "failure": self.simulation.failure,
        }

    @call("uavaccelRecording", leaves_state=True)
    def recording(self) -> dict[str, object]:
        """Return the game's samples and command log since the last reset, as raw little-endian arrays."""
        recording = self.simulation.recording()
        return {
            "samples": recording.samples.astype("<f8").tobytes(),
            "commands": recording.commands.astype("<i8").tobytes(),
            "tick_ns": recording.tick_ns,
            "dropped": recording.dropped,
            "commands_dropped": recording.commands_dropped,
        }

    @call("uavaccelTrace", leaves_state=True)
    def trace(self, enabled: bool) -> list[list[object]]:
        """Switch the trace on or off; returns and clears the events so far: [event, wall ns, simulated ns]."""
        trace = self.simulation.trace
        trace.enabled = enabled
        events = [list(event) for event in trace.events]
        trace.events.clear()
        return events


def encode_state(kinematics: Kinematics) -> list[float]:
    """Return a state as 20 numbers: time in ns, position, wxyz, velocity, body rate and both accelerations."""
    return [
        kinematics.time_ns,
        *kinematics.position_m,
        *kinematics.orientation_wxyz,
        *kinematics.linear_velocity_m_s,
        *kinematics.angular_velocity_rad_s,
        *kinematics.linear_acceleration_m_s2,
        *kinematics.angular_acceleration_rad_s2,
    ]


def decode_state(numbers: Received) -> Kinematics:
    """Invert `encode_state`."""
    n = tuple(numbers)
    return Kinematics(n[0], n[1:4], n[4:8], n[8:11], n[11:14], n[14:17], n[17:20])
