"""AirSim's recorder: what startRecording and stopRecording write to files.

Source of the format: AirSim v1.8.1, RecordingFile.cpp and PawnSimApi.cpp (tab separated; time in whole milliseconds;
ground truth in the vehicle's NED frame; images in a folder beside, named in the last column).
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import IO, TYPE_CHECKING

from uavaccel.clock import calendar_time
from uavaccel.errors import UserError, naming
from uavaccel.sim.camera.pixels import png
from uavaccel.units import NS_PER_S
from uavaccel.wire import types
from uavaccel.wire.pictures import known_type, pfm, ppm

if TYPE_CHECKING:
    from uavaccel.sim.vehicle.vehicle import Vehicle
    from uavaccel.wire.calls import Scenery

COLUMNS = ("VehicleName", "TimeStamp", "POS_X", "POS_Y", "POS_Z", "Q_W", "Q_X", "Q_Y", "Q_Z", "ImageFile")
FILE_NAME = "airsim_rec.txt"
IMAGES = "images"
FOLDERS_AT_ONCE = 20


class Recorder:
    """Starts and stops a simulation's recorder.

    With a `folder`, the samples and the images that the settings list are written to a dated folder in it, which `say`
    names; without one the samples stay in the simulation's bounded buffer. What cannot be written ends the recording:
    `say` is told, and the flight goes on. Raises UserError, naming the key, for an image in the settings that cannot
    be taken.
    """

    def __init__(self, scenery: Scenery, folder: Path | None, say: Callable[[str], None]) -> None:
        self._scenery, self._simulation, self._folder, self._say = scenery, scenery.simulation, folder, say
        self._settings = scenery.settings.recording
        later = {name for name, vehicle in scenery.settings.vehicles.items() if not vehicle.auto_create}
        for number, wanted in enumerate(self._settings.cameras):
            try:
                known_type(wanted.image_type)
                if wanted.vehicle_name not in later:
                    scenery.cameras(wanted.vehicle_name).named(wanted.camera_name)
            except ValueError as error:
                raise UserError(f"Recording.Cameras.{number}: {error}") from None
        self._file: IO[str] | None = None
        self._images: dict[tuple[int, str], list[str]] = {}  # names of the files by tick and vehicle
        self._others: dict[int, list[tuple[Vehicle, list[float]]]] = {}  # poses by tick of vehicles beside the first
        self._last_pose: dict[str, list[float]] = {}
        self._takes_images, self._further, self._looked_at = False, self._simulation.world.vehicles[:0], -1
        self._stop_watching: Callable[[], None] = lambda: None
        self._folders, self._counted_ns = 0, 0

    def start(self, wall_ns: int = 0) -> None:
        """Start a recording with a file of its own; stops a running one.

        Raises UserError, naming the file, where it cannot be written, and ValueError for more than FOLDERS_AT_ONCE
        recordings in quick succession: one per wall second is allowed in the long run.
        """
        if self._folder is not None:  # a client could fill the disk with a hundred folders per second
            passed = (wall_ns - self._counted_ns) // NS_PER_S
            self._folders, self._counted_ns = max(self._folders - passed, 0), self._counted_ns + passed * NS_PER_S
            if self._folders >= FOLDERS_AT_ONCE:
                raise ValueError("recordings are begun too often: each has a folder of its own; wait for a second")
            self._folders += 1
        self.stop()
        self._last_pose.clear()
        if self._folder is not None:
            with naming(self._folder):
                here = _new_folder(self._folder)
                self._file = (here / FILE_NAME).open("w", encoding="utf-8", newline="\n")
            self._file.write("\t".join(COLUMNS) + "\n")
            self._say(f"recording to {here / FILE_NAME}")
        self._simulation.records_game = False
        self._simulation.world.start_recording()
        try:
            with naming(self._folder or Path()):
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
        lines, moved_only, lead = [], self._settings.record_on_move, self._simulation.world.lead
        for row in self._simulation.world.recorder.take():
            tick = int(row[0])
            self._look(tick)  # at the present tick, unless it was called before this
            for vehicle, pose in [(lead, row[1:8].tolist()), *self._others.pop(tick, [])]:
                before = self._last_pose.get(vehicle.name)
                self._last_pose[vehicle.name] = pose
                if not (moved_only and pose == before):
                    lines.append(self._line(tick, vehicle, pose))
        try:
            self._file.writelines(lines)
            self._file.flush()
        except OSError as error:
            self._say(f"warning: the recording ends here: {error.strerror}")
            file, self._file = self._file, None
            with suppress(OSError):
                file.close()

    @property
    def writes(self) -> bool:
        """Whether a recording is being written to a file."""
        return self._file is not None

    def go_through(self, reset: Callable[[bool], None]) -> None:
        """Call `reset` with whether there is a recording; a recording continues with a new grid of sampling times."""
        self.keep()
        reset(self._simulation.world.recorder.active)
        if self._simulation.world.recorder.active:
            self._watch()

    def _watch(self) -> None:
        """Take the images that the settings list and the poses of further vehicles, at each sample from now on."""
        self._stop_watching()
        self._stop_watching = lambda: None
        if self._file is None:
            return
        self._images.clear()
        self._others.clear()
        world = self._simulation.world
        self._takes_images, self._further = bool(self._settings.cameras) and self._scenery.render, world.vehicles[1:]
        self._take(world.tick)
        self._stop_watching = world.watch(self._simulation.profile.recorder_ticks, self._look, world.tick)

    def _look(self, tick: int) -> None:
        """Take what belongs to the sample of the present tick, once."""
        if self._file is None or tick <= self._looked_at:
            return
        try:
            self._take(tick)
        except (OSError, ValueError, UserError) as error:  # of the images, not of the flight
            self._say(f"warning: the recording of images ends here: {error}")
            self._takes_images = False

    def _take(self, tick: int) -> None:
        self._looked_at = tick
        states = [(vehicle, vehicle.kinematics(in_world=True)) for vehicle in self._further]
        self._others[tick] = [(each, [*state.position_m, *state.orientation_wxyz]) for each, state in states]
        if self._takes_images:
            self._take_images(tick)

    def _take_images(self, tick: int) -> None:
        assert self._file is not None
        folder = Path(self._file.name).parent / IMAGES
        folder.mkdir(exist_ok=True)
        stamp = types.stamp(self._simulation.time_of(tick))
        there = {"", *(vehicle.name for vehicle in self._simulation.world.vehicles)}
        for wanted in (each for each in self._settings.cameras if each.vehicle_name in there):
            vehicle = self._scenery.vehicle(wanted.vehicle_name).name
            camera, pictures = self._scenery.cameras(vehicle).named(wanted.camera_name), self._scenery.pictures
            suffix = ".pfm" if wanted.pixels_as_float else ".png" if wanted.compress else ".ppm"
            if wanted.pixels_as_float:
                content = pfm(pictures.floats(camera, wanted.image_type))
            else:
                content = (png if wanted.compress else ppm)(pictures.rgb(camera, wanted.image_type))
            parts = (vehicle, camera.name, str(wanted.image_type), str(stamp))
            name = "_".join(["img", *(re.sub(r"[^\w-]", "_", part) for part in parts)]) + suffix
            (folder / name).write_bytes(content)
            self._images.setdefault((tick, vehicle), []).append(name)

    def _line(self, tick: int, vehicle: Vehicle, pose: list[float]) -> str:
        """Return the line of one sample of a vehicle: `pose` is its position in the world in metres and wxyz."""
        time_ms = types.stamp(self._simulation.time_of(tick)) // 1_000_000
        x, y, z = vehicle.local((pose[0], pose[1], pose[2]))
        images = ";".join(self._images.pop((tick, vehicle.name), []))
        values = (f"{value:.9g}" for value in (x, y, z, *pose[3:]))
        return "\t".join((vehicle.name, str(time_ms), *values, images)) + "\n"


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
