"""A recorded drone on the page: its figure, and its path so far."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from uavaccel.kinematics import Vector
from uavaccel.units import ned_to_mujoco, quaternion_ned_to_mujoco
from uavaccel.watch.figure import COMMANDED, PATH_WIDTH, THINKING, Figure
from uavaccel.watch.track import Track

if TYPE_CHECKING:
    from viser import ViserServer

IDEAL, IDEAL_WIDTH = (245, 245, 245), 2.0
SHORT_S, STANDS = (
    1e-6,
    0.1,
)  # wall seconds in which the clock counts as paused if it runs at less than this share of ClockSpeed


class Drone:
    """One track, shown at `offset_m` (NED) from where it was flown; `ideal_m` (p, 3) is drawn below it, thin."""

    def __init__(
        self,
        server: ViserServer,
        track: Track,
        figure: Figure,
        offset_m: NDArray[np.float64],
        ideal_m: NDArray[np.float64] | None = None,
    ) -> None:
        self.track, self._figure, self._offset_m = track, figure, offset_m
        self.height_m: float | None = None
        name = f"/{track.name}"
        places = self._shown(track.position_m)
        self._path = np.stack([places[:-1], places[1:]], axis=1)
        # a line between two samples shows what was flown in its middle: a command may end at either
        between = track.between_commands((track.time_s[:-1] + track.time_s[1:]) / 2)
        colours = np.where(between[:, None], THINKING, COMMANDED).astype(np.uint8)
        self._colours = np.repeat(colours[:, None], 2, axis=1)
        self._line = server.scene.add_line_segments(
            f"{name} path", self._path[:1], self._colours[:1], thickness=PATH_WIDTH, thickness_units="screen"
        )
        if ideal_m is not None:
            ideal = self._shown(ideal_m)
            server.scene.add_line_segments(
                f"{name} ideal",
                np.stack([ideal[:-1], ideal[1:]], axis=1),
                IDEAL,
                thickness=IDEAL_WIDTH,
                thickness_units="screen",
            )

    def show(self, wall_s: float) -> None:
        """Where it was at this moment of its client's clock."""
        time_s = self.track.simulated_s(wall_s)
        place, attitude = self.track.pose(time_s)
        shown = self._shown(place)
        flown = max(int(np.searchsorted(self.track.time_s, time_s, side="right")) - 1, 0)
        here = self.track.time_s[min(flown, len(self._path) - 1)]
        path, colours = np.asarray(self._path[:flown]), np.asarray(self._colours[:flown])
        if time_s > here and flown < len(self._path):  # up to the drone itself, between two samples
            path = np.concatenate([path, [[self._path[flown, 0], shown]]])
            colours = np.concatenate([colours, self._colours[flown : flown + 1]])
        if len(path):
            self._line.points, self._line.colors = path.astype(np.float32), colours
        self._line.visible = bool(len(path))
        text = f"{self.track.name}: {self.state(wall_s)}"
        turned = quaternion_ned_to_mujoco(attitude)
        self.height_m = self._figure.show(shown, turned, self._velocity(time_s), text)

    def state(self, wall_s: float) -> str:
        """In words, what drone and client do."""
        if wall_s >= self.track.wall_s:
            return "done"
        if not len(self.track.command_start_s):
            return "flies"
        time_s = self.track.simulated_s(wall_s)
        if self.track.command(time_s) is not None:
            return "flies its command"
        passes_s = self.track.simulated_s(wall_s + SHORT_S) - time_s
        # a script's messages tell the times of its calls, so that a pause seems to begin a little before its end
        stands = passes_s < STANDS * SHORT_S * self.track.clock_speed
        return "client thinks, clock paused" if stands else "client thinks, drone flies on"

    def _velocity(self, time_s: float) -> Vector | None:
        number = self.track.command(time_s)
        known = number is not None and number < len(self.track.velocities)
        return self.track.velocities[number] if known and number is not None else None

    def _shown(self, place_m: NDArray[np.float64]) -> NDArray[np.float64]:
        return ned_to_mujoco(place_m + self._offset_m)
