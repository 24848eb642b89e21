"""AirSim's calls that record what happens, and those that would write or draw into Unreal's picture."""

# ruff: noqa: N815  the names are AirSim's

from __future__ import annotations

from uavaccel.wire.calls import Calls, WithoutEffect, call


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

    simPrintLogMessage = WithoutEffect()
    simSetTraceLine = WithoutEffect()
    simFlushPersistentMarkers = WithoutEffect()
    simPlotPoints = WithoutEffect()
    simPlotLineStrip = WithoutEffect()
    simPlotLineList = WithoutEffect()
    simPlotArrows = WithoutEffect()
    simPlotStrings = WithoutEffect()
    simPlotTransforms = WithoutEffect()
    simPlotTransformsWithNames = WithoutEffect()
