"""AirSim's recorder: what startRecording and stopRecording write to files.

Source of the format: AirSim v1.8.1, RecordingFile.cpp and PawnSimApi.cpp (tab separated; time in whole milliseconds;
ground truth in the vehicle's NED frame; images in a folder beside, named in the last column).
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable
from pathlib import Path
from typing import IO, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from uavaccel.clock import calendar_time
from uavaccel.errors import UserError
from uavaccel.sim.camera.pixels import png
from uavaccel.units import NS_PER_S
from uavaccel.wire import types
from uavaccel.wire.pictures import known_type, pfm, ppm

if TYPE_CHECKING:
    from uavaccel.wire.calls import Scenery

COLUMNS = ("VehicleName", "TimeStamp", "POS_X", "POS_Y", "POS_Z", "Q_W", "Q_X", "Q_Y", "Q_Z", "ImageFile")
FILE_NAME = "airsim_rec.txt"
IMAGES = "images"
FOLDERS_AT_ONCE = 20


class Recorder:
    """Starts and stops a simulation's recorder.

    With a `folder`, the samples and the images that the settings list are written to a dated folder in it, which `say`
    names; without one the samples stay in the simulation's bounded buffer. Methods that write raise OSError, after
    which the file is closed. Raises UserError, naming the key, for an image in the settings that cannot be taken.
    """

    def __init__(self, scenery: Scenery, folder: Path | None, say: Callable[[str], None]) -> None:
        self._scenery, self._simulation, self._folder, self._say = scenery, scenery.simulation, folder, say
        self._settings, self._vehicle = scenery.settings.recording, scenery.settings.vehicle
        for number, wanted in enumerate(self._settings.cameras):
            try:
                scenery.cameras().named(wanted.camera_name)
                known_type(wanted.image_type)
            except ValueError as error:
                raise UserError(f"Recording.Cameras.{number}: {error}") from None
        self._file: IO[str] | None = None
        self._images: dict[int, str] = {}  # names of the files by tick
        self._last_pose: list[float] | None = None
        self._stop_watching: Callable[[], None] = lambda: None
        self._folders, self._counted_ns = 0, 0

    def start(self, wall_ns: int = 0) -> None:
        """Start a recording with a file of its own; stops a running one.

        Raises ValueError for more than FOLDERS_AT_ONCE recordings in quick succession: one per wall second is allowed
        in the long run.
        """
        if self._folder is not None:  # a client could fill the disk with a hundred folders per second
            passed = (wall_ns - self._counted_ns) // NS_PER_S
            self._folders, self._counted_ns = max(self._folders - passed, 0), self._counted_ns + passed * NS_PER_S
            if self._folders >= FOLDERS_AT_ONCE:
                raise ValueError("recordings are begun too often: each has a folder of its own; wait for a second")
            self._folders += 1
        self.stop()
        if self._folder is not None:
            here = _new_folder(self._folder)
            self._file = (here / FILE_NAME).open("w", encoding="utf-8", newline="\n")
            self._file.write("\t".join(COLUMNS) + "\n")
            self._say(f"recording to {here / FILE_NAME}")
        self._simulation.records_game = False
        self._simulation.world.start_recording()
        try:
            self._watch()
        except Exception:
            self.stop()
            raise

    def stop(self) -> None:
        """Stop the recording, and write all samples to the file."""
        self._simulation.world.recorder.stop()
        self._stop_watching()
        self._stop_watching = lambda: None
        self.keep()
        if self._file is not None:
            self._file.close()
            self._file = None

    def keep(self) -> None:
        """Write the samples to the file; to be called before the buffer is full or a reset empties it."""
        if self._file is None:
            return
        lines, moved_only = [], self._settings.record_on_move
        for row in self._simulation.world.recorder.take():
            pose, before = row[1:8].tolist(), self._last_pose
            self._last_pose = pose
            if not (moved_only and pose == before):
                lines.append(self._line(row))
        try:
            self._file.writelines(lines)
            self._file.flush()
        except OSError:
            self._file = None  # the flight continues without a recording
            raise

    def go_through(self, reset: Callable[[bool], None]) -> None:
        """Call `reset` with whether there is a recording; a recording continues with a new grid of sampling times."""
        self.keep()
        reset(self._simulation.world.recorder.active)
        if self._simulation.world.recorder.active:
            self._watch()

    def _watch(self) -> None:
        """Take the images that the settings list, at each sample from now on."""
        world = self._simulation.world
        self._stop_watching()
        if self._file is None or not self._settings.cameras or not self._scenery.render:
            return
        self._images.clear()
        self._take_images(world.tick)

        def take_or_end(tick: int) -> None:
            try:
                self._take_images(tick)
            except (OSError, ValueError, UserError) as error:  # of the images, not of the flight
                self._say(f"warning: the recording of images ends here: {error}")
                self._stop_watching()
                self._stop_watching = lambda: None

        self._stop_watching = world.watch(self._simulation.profile.recorder_ticks, take_or_end, world.tick)

    def _take_images(self, tick: int) -> None:
        if self._file is None:
            return
        folder = Path(self._file.name).parent / IMAGES
        folder.mkdir(exist_ok=True)
        stamp = types.stamp(self._simulation.time_of(tick))
        names = []
        for wanted in self._settings.cameras:
            camera, pictures = self._scenery.cameras().named(wanted.camera_name), self._scenery.pictures
            suffix = ".pfm" if wanted.pixels_as_float else ".png" if wanted.compress else ".ppm"
            if wanted.pixels_as_float:
                content = pfm(pictures.floats(camera, wanted.image_type))
            else:
                content = (png if wanted.compress else ppm)(pictures.rgb(camera, wanted.image_type))
            parts = (self._vehicle, camera.name, str(wanted.image_type), str(stamp))
            name = "_".join(["img", *(re.sub(r"[^\w-]", "_", part) for part in parts)]) + suffix
            (folder / name).write_bytes(content)
            names.append(name)
        self._images[tick] = ";".join(names)

    def _line(self, row: NDArray[np.float64]) -> str:
        """Return the line of one sample: columns 0 to 7 of `row` are tick, position in metres and wxyz orientation."""
        tick = int(row[0])
        time_ms = types.stamp(self._simulation.time_of(tick)) // 1_000_000
        pose = (f"{value:.9g}" for value in row[1:8])
        return "\t".join((self._vehicle, str(time_ms), *pose, self._images.pop(tick, ""))) + "\n"


def _new_folder(parent: Path) -> Path:
    """Make a folder named by date and time, as AirSim does; numbered if there is one of the same second."""
    stamp = calendar_time()[:19].replace("T", "-").replace(":", "-")
    for number in itertools.count(1):
        folder = parent / (stamp if number == 1 else f"{stamp}-{number}")
        try:
            folder.mkdir(parents=True)
        except FileExistsError:
            continue
        return folder
    raise AssertionError  # a count does not end
