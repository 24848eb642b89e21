"""What a drone's front camera and an event camera beside it see, drawn for the spectator from the drone's pose."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from uavaccel.draw.film import dvs_picture
from uavaccel.sim.camera.view import HEIGHT, WIDTH
from uavaccel.sim.world import World
from uavaccel.units import ned_to_mujoco, quaternion_ned_to_mujoco
from uavaccel.vision.dvs import DvsState, init_state, luma, step
from uavaccel.vision.dvs_sensor import DvsParameters, make_sensor

LONGEST_S = 0.25  # simulated; beyond it the spectator has jumped, and the events begin anew


class Eyes:
    """The pictures of one drone in `world`, which nothing flies in. Raises UserError without OpenGL."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._camera = world.camera(WIDTH, HEIGHT)
        self._sensor = make_sensor(DvsParameters(), (HEIGHT, WIDTH), seed=0)
        self._state: DvsState | None = None
        self._began_s, self._seen_s = 0.0, 0.0
        self._events = np.full((HEIGHT, WIDTH, 3), 246, np.uint8)

    def look(
        self, position_m: NDArray[np.float64], orientation_wxyz: NDArray[np.float64], time_s: float
    ) -> NDArray[np.uint8]:
        """Camera above, events since the last look below; red, green, blue."""
        lead, data = self._world.lead, self._world.data
        lead.qpos[:3], lead.qpos[3:] = ned_to_mujoco(position_m), quaternion_ned_to_mujoco(orientation_wxyz)
        picture = self._camera.colour(data)
        self._see(luma(picture), time_s)
        return np.vstack([picture, self._events])

    def _see(self, frame: NDArray[np.uint8], time_s: float) -> None:
        passed_s = time_s - self._seen_s
        if self._state is not None and passed_s == 0.0:
            return  # the clock stands: nothing changes, and nothing is seen
        if self._state is not None and 0.0 < passed_s < LONGEST_S:
            self._state, on, off = step(self._sensor, self._state, frame, time_s - self._began_s)
            self._events = np.ascontiguousarray(dvs_picture(on, off, (WIDTH, HEIGHT))[..., ::-1])
        else:
            self._state, self._began_s = init_state(self._sensor, frame), time_s
        self._seen_s = time_s
