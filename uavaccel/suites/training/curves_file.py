"""Learning curves in TensorBoard's format: a file of events, written by whoever draws them, without a thread."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

from tensorboard.compat.proto.event_pb2 import Event
from tensorboard.compat.proto.summary_pb2 import Summary
from tensorboard.summary.writer.record_writer import RecordWriter

from uavaccel.clock import epoch_s

VERSION = "brain.Event:2"  # the first record of each such file


class CurvesFile:
    """A file of this process in `folder`, which is made where there is none."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / f"events.out.tfevents.{epoch_s():.0f}.{os.getpid()}"
        self._file = RecordWriter(path.open("ab"))
        self._write(Event(wall_time=epoch_s(), file_version=VERSION))

    def add(self, step: int, values: Mapping[str, float]) -> None:
        """Points of curves, by their names, at one `step`."""
        points = [Summary.Value(tag=name, simple_value=value) for name, value in values.items()]
        self._write(Event(wall_time=epoch_s(), step=step, summary=Summary(value=points)))

    def close(self) -> None:
        """Nothing can be added any more."""
        self._file.close()

    def _write(self, event: Event) -> None:
        self._file.write(event.SerializeToString())
        self._file.flush()
