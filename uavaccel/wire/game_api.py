"""Calls about the simulator: AirSim's on versions, settings, reset, clock, recording and drawing, and ours for games.

Ours start a game in a lane, fly it for simulated time, and read its results. A state on the wire is a flat list of
numbers (`encode_state`), smaller and packed faster than AirSim's maps. Source of AirSim's names, parameter orders and
error texts: AirSim v1.8.1, RpcLibServerBase.cpp.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, TypedDict

from uavaccel.kinematics import Kinematics
from uavaccel.sim.simulation import DeferredReply
from uavaccel.sim.world import START_M
from uavaccel.units import CLOCK_SPEEDS
from uavaccel.wire.calls import Calls, call, without_effect
from uavaccel.wire.flight_api import LONGEST_S
from uavaccel.wire.image_api import clutter_layout, lane_layout
from uavaccel.wire.rpc import Received
from uavaccel.wire.types import Coordinate, number

_, FASTEST = CLOCK_SPEEDS


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
        simulation.pause(wall_ns)
        place = (START_M[0], START_M[1], height_m)
        self.scenery.recorder.go_through(lambda _: simulation.reset(wall_ns, place, recording=True))
        simulation.records_game = not self.scenery.recorder.writes
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


SERVER_VERSION = 4  # satisfies AirSim's client (1) and Cosys-AirSim's (4)
MIN_CLIENT_VERSION = 1
FRAMES_PER_S, MOST_FRAMES = 60, 1e9


def wall_seconds(value: object, name: str) -> float:
    """A duration in seconds, 0 or more, at most LONGEST_S."""
    if (seconds := number(value, name)) < 0:
        raise ValueError(f"{name} must not be negative, not {seconds:g}")
    return min(seconds, LONGEST_S)


def frame_count(value: object, name: str) -> float:
    count = number(value, name)
    if count != int(count) or not 0 <= count <= MOST_FRAMES:
        raise ValueError(f"{name} must be a whole number from 0 to {MOST_FRAMES:g}, not {value}")
    return count


class SimulatorApi(Calls, title="Connection and time"):
    @call("ping", leaves_state=True)
    def ping(self) -> bool:
        return True

    @call("getServerVersion")
    def server_version(self) -> int:
        return SERVER_VERSION

    @call("getMinRequiredClientVersion")
    def min_client_version(self) -> int:
        return MIN_CLIENT_VERSION

    @call("getSettingsString")
    def settings(self) -> str:
        return self.scenery.settings.as_json(float(self.simulation.clock_speed))

    @call("reset")
    def reset(self) -> None:
        """Reset every vehicle; a recording continues, as in AirSim."""
        self.scenery.recorder.go_through(lambda recording: self.simulation.reset(self.wall_ns, recording=recording))

    @call("simPause", lambda params: "pause" if params and params[0] else "continue")
    def pause(self, is_paused: bool) -> None:
        (self.simulation.pause if is_paused else self.simulation.run)(self.wall_ns)

    @call("simIsPaused")
    def is_paused(self) -> bool:
        return self.simulation.paused

    @call("simContinueForTime")
    def continue_for_time(self, seconds: Annotated[float, wall_seconds]) -> DeferredReply:
        reply = self.simulation.continue_for_wall(seconds, self.wall_ns)
        reply.encode = lambda _: None
        return reply

    @call("simContinueForFrames")
    def continue_for_frames(self, frames: Annotated[float, frame_count]) -> DeferredReply:
        """Run for the wall time in which Unreal draws these frames, 60 per second, then pause."""
        return self.continue_for_time(frames / FRAMES_PER_S)


class RecordingApi(Calls, title="Recording, drawing, messages"):
    @call("startRecording")
    def start(self) -> None:
        self.scenery.recorder.start(self.wall_ns)

    @call("stopRecording")
    def stop(self) -> None:
        self.scenery.recorder.stop()

    @call("isRecording")
    def is_recording(self) -> bool:
        return self.simulation.world.recorder.active

    ignored = (
        *without_effect(
            *("simPrintLogMessage", "simSetTraceLine", "simFlushPersistentMarkers", "simPlotPoints"),
            *("simPlotLineStrip", "simPlotLineList", "simPlotArrows", "simPlotStrings"),
            *("simPlotTransforms", "simPlotTransformsWithNames"),
        ),
    )
