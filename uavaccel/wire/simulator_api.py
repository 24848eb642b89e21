"""AirSim's calls about the simulator itself: versions, settings, reset, clock, recording, and drawing in its window.

Source of names, parameter orders and error texts: AirSim v1.8.1, RpcLibServerBase.cpp.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

from uavaccel.sim.flight.pilot import DeferredReply
from uavaccel.wire.arguments import number
from uavaccel.wire.calls import Calls, call, without_effect
from uavaccel.wire.flight_api import LONGEST_S
from uavaccel.wire.latency import Channel

SERVER_VERSION = 4  # satisfies AirSim's client (1) and Cosys-AirSim's (4)
MIN_CLIENT_VERSION = 1
FRAMES_PER_S, MOST_FRAMES = 60, 1e9


def wall_seconds(value: object, name: str) -> float:
    """A duration in seconds, 0 or more, at most LONGEST_S."""
    seconds = number(value, name)
    if seconds < 0:
        raise ValueError(f"{name} must not be negative, not {seconds:g}")
    return min(seconds, LONGEST_S)


def frame_count(value: object, name: str) -> float:
    """A whole number of frames."""
    count = number(value, name)
    if count != int(count) or not 0 <= count <= MOST_FRAMES:
        raise ValueError(f"{name} must be a whole number from 0 to {MOST_FRAMES:g}, not {value}")
    return count


def pause_channel(params: Sequence[object]) -> Channel:
    """simPause's kind of latency: to pause or to continue."""
    return "pause" if params and params[0] else "continue"


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
        self.context.recorder.go_through(lambda recording: self.simulation.reset(self.wall_ns, recording=recording))

    @call("simPause", pause_channel)
    def pause(self, is_paused: bool) -> None:
        if is_paused:
            self.simulation.pause(self.wall_ns)
        else:
            self.simulation.run(self.wall_ns)

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
        self.context.recorder.start(self.wall_ns)

    @call("stopRecording")
    def stop(self) -> None:
        self.context.recorder.stop()

    @call("isRecording")
    def is_recording(self) -> bool:
        return self.simulation.world.recording

    ignored = (
        *without_effect(
            *("simPrintLogMessage", "simSetTraceLine", "simFlushPersistentMarkers", "simPlotPoints"),
            *("simPlotLineStrip", "simPlotLineList", "simPlotArrows", "simPlotStrings"),
            *("simPlotTransforms", "simPlotTransformsWithNames"),
        ),
    )
