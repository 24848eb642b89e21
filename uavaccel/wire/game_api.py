"""Our own calls for games: start one, fly it for simulated time, and read state, speed, recording and trace.

A state on the wire is a flat list of numbers (`encode_state`), smaller and packed faster than AirSim's maps.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from uavaccel.kinematics import Kinematics
from uavaccel.sim.deferred_reply import DeferredReply
from uavaccel.sim.simulation import Simulation
from uavaccel.sim.world import START_M
from uavaccel.wire import types
from uavaccel.wire.recorder import Recorder

FASTEST = 1e4  # ClockSpeed; ten times what one core can fly


class GameApi:
    """The calls of our client on one simulation; `wall_ns` is when a call is handled."""

    def __init__(self, simulation: Simulation, recorder: Recorder) -> None:
        self.simulation = simulation
        self._recorder = recorder

    def state(self) -> list[float | int]:
        """The present state (`encode_state`)."""
        return encode_state(self.simulation.kinematics())

    def continue_for(self, duration_ns: Any, wall_ns: int) -> DeferredReply:
        """Run for simulated nanoseconds, pause, reply the state (`encode_state`)."""
        if isinstance(duration_ns, bool) or not isinstance(duration_ns, int) or duration_ns < 0:
            raise ValueError(
                f"duration_ns must be a whole number of nanoseconds, 0 or more, not {duration_ns!r}"
            )
        reply = self.simulation.continue_for(duration_ns, wall_ns)
        reply.encode = encode_state
        return reply

    def start(self, wall_ns: int, clock_speed: Any, height_m: Any = START_M[2]) -> list[float | int]:
        """A settled hover at a NED z over the origin, paused, API control on, recording; replies the state."""
        simulation = self.simulation
        start_m = (START_M[0], START_M[1], types.coordinate(height_m, "height_m"))
        self.set_clock_speed(clock_speed, wall_ns)
        self._recorder.keep()
        simulation.records_game = True
        simulation.pause(wall_ns)
        simulation.reset(wall_ns, start_m, recording=True)
        simulation.lead.api_control = True
        return encode_state(simulation.kinematics())

    def set_clock_speed(self, clock_speed: Any, wall_ns: int) -> None:
        speed = types.number(clock_speed, "clock_speed")
        if speed > FASTEST:
            raise ValueError(f"clock_speed must be at most {FASTEST:g}, not {speed:g}")
        self.simulation.set_clock_speed(speed, wall_ns)

    def speed(self) -> dict[str, Any]:
        """Requested and achieved speed since the last reset, and what ended the flight, if anything did."""
        speed = self.simulation.speed
        return {
            "clock_speed": float(self.simulation.clock_speed),
            "real_time_factor": speed.real_time_factor,
            "simulated_ns": speed.simulated_ns,
            "wall_ns": speed.wall_ns,
            "lost_wall_ns": speed.lost_wall_ns,
            "failure": self.simulation.failure,
        }

    def recording(self) -> dict[str, Any]:
        """The game's samples and command log since the last reset, as raw little-endian arrays."""
        recording = self.simulation.recording()
        return {
            "samples": recording.samples.astype("<f8").tobytes(),
            "commands": recording.commands.astype("<i8").tobytes(),
            "tick_ns": recording.tick_ns,
            "dropped": recording.dropped,
            "commands_dropped": recording.commands_dropped,
        }

    def trace(self, enabled: Any) -> list[list[Any]]:
        """Switch the trace on or off; replies, and forgets, the events so far: [event, wall ns, simulated ns]."""
        trace = self.simulation.trace
        trace.enabled = types.flag(enabled, "enabled")
        events = [list(event) for event in trace.events]
        trace.events.clear()
        return events


def encode_state(kinematics: Kinematics) -> list[float | int]:
    """Time in ns, position, wxyz, velocity, body rate and both accelerations: 20 numbers."""
    return [
        kinematics.time_ns,
        *kinematics.position_m,
        *kinematics.orientation_wxyz,
        *kinematics.linear_velocity_m_s,
        *kinematics.angular_velocity_rad_s,
        *kinematics.linear_acceleration_m_s2,
        *kinematics.angular_acceleration_rad_s2,
    ]


def decode_state(numbers: Sequence[Any]) -> Kinematics:
    """The inverse of `encode_state`."""
    n = tuple(numbers)
    return Kinematics(n[0], n[1:4], n[4:8], n[8:11], n[11:14], n[14:17], n[17:20])
