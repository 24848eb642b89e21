"""What a drone's front camera and an event camera beside it see, drawn for the spectator from the drone's pose."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from uavaccel.draw.film import dvs_picture
from uavaccel.sim.camera.camera import FrontCamera, make_camera
from uavaccel.sim.camera.view import HEIGHT, WIDTH
from uavaccel.vision.dvs import DvsState, init_state, luma, step
from uavaccel.vision.dvs_sensor import DvsParameters, make_sensor

LONGEST_S = 0.25  # simulated; beyond it the spectator has jumped, and the events begin anew
PAPER = 246  # gray of a picture without events
BLANK = np.full((2 * HEIGHT, WIDTH, 3), PAPER, np.uint8)


class Eyes:
    """The pictures of the vehicle whose pose is `data.qpos[pose]`, in a scene in which nothing flies."""

    def __init__(self, camera: FrontCamera, data: mujoco.MjData, pose: slice) -> None:
        self._camera, self._data, self._pose = camera, data, pose
        self._sensor = make_sensor(DvsParameters(), (HEIGHT, WIDTH), seed=0)
        self._state: DvsState | None = None
        self._began_s, self._seen_s = 0.0, 0.0
        self._events = BLANK[:HEIGHT]

    def render(self, place: NDArray[np.float64], attitude: NDArray[np.float64], time_s: float) -> NDArray[np.uint8]:
        """Camera above, events since the last image below; red, green, blue. The pose is in MuJoCo's frame."""
        self._data.qpos[self._pose] = [*place, *attitude]
        picture = self._camera.colour(self._data)
        self._process_frame(luma(picture), time_s)
        return np.vstack([picture, self._events])

    def _process_frame(self, frame: NDArray[np.uint8], time_s: float) -> None:
        passed_s = time_s - self._seen_s
        if self._state is not None and passed_s == 0.0:
            return  # the clock is paused: nothing changes, and nothing is seen
        if self._state is not None and 0.0 < passed_s < LONGEST_S:
            self._state, on, off = step(self._sensor, self._state, frame, time_s - self._began_s)
            self._events = np.ascontiguousarray(dvs_picture(on, off, (WIDTH, HEIGHT))[..., ::-1])
        else:
            self._state, self._began_s = init_state(self._sensor, frame), time_s
        self._seen_s = time_s


def camera_of(model: mujoco.MjModel) -> FrontCamera:
    """Make the first vehicle's front camera, 256 x 144 pixels. Raises UserError without OpenGL."""
    return make_camera(model, WIDTH, HEIGHT)
