"""AirSim's recorder on the wire: startRecording, stopRecording, and the airsim_rec.txt between them.

Source of the format: AirSim v1.8.1, RecordingFile.cpp and PawnSimApi.cpp (tab separated; simulated time in whole
milliseconds; ground truth in the vehicle's NED frame). No images are recorded, so the last column stays empty.
"""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from uavaccel.clock import calendar_time
from uavaccel.sim.simulation import Simulation

COLUMNS = ("VehicleName", "TimeStamp", "POS_X", "POS_Y", "POS_Z", "Q_W", "Q_X", "Q_Y", "Q_Z", "ImageFile")
FILE_NAME = "airsim_rec.txt"


class Recorder:
    """Starts and stops a simulation's recorder.

    With a `folder` the samples go to a file in a dated folder below it; without one they stay in the simulation's
    bounded buffer. What writes raises OSError, and closes the file.
    """

    def __init__(self, simulation: Simulation, vehicle: str, folder: Path | None = None) -> None:
        self._simulation = simulation
        self._vehicle = vehicle
        self._folder = folder
        self._file: IO[str] | None = None

    def start(self) -> None:
        """Begin a recording, and a file of its own; one that runs is stopped."""
        self.stop()
        self._simulation.record()
        if self._folder is not None:
            self._file = (_new_folder(self._folder) / FILE_NAME).open("w", encoding="utf-8", newline="\n")
            self._file.write("\t".join(COLUMNS) + "\n")

    def stop(self) -> None:
        self._simulation.world.stop_recording()
        self.keep()
        if self._file is not None:
            self._file.close()
            self._file = None

    def keep(self) -> None:
        """Move the samples to the file, before the buffer is full or a reset empties it."""
        if self._file is None:
            return
        rows = self._simulation.world.take_samples()
        try:
            self._file.writelines(self._line(row) for row in rows)
            self._file.flush()
        except OSError:
            self._file = None  # what is lost is lost; the flight goes on
            raise

    def _line(self, row: NDArray[np.float64]) -> str:
        """One sample: columns 0 to 7 of `row` are tick, position in metres and wxyz orientation."""
        time_ms = self._simulation.time_of(int(row[0])) // 1_000_000
        pose = (f"{value:.9g}" for value in row[1:8])
        return "\t".join((self._vehicle, str(time_ms), *pose, "")) + "\n"


def _new_folder(parent: Path) -> Path:
    """A folder named by date and time, as AirSim's; numbered if one was made in the same second."""
    stamp = calendar_time()[:19].replace("T", "-").replace(":", "-")
    for number in itertools.count(1):
        folder = parent / (stamp if number == 1 else f"{stamp}-{number}")
        try:
            folder.mkdir(parents=True)
        except FileExistsError:
            continue
        return folder
    raise AssertionError  # a count does not end
