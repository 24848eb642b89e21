"""A drone on the page: its body, its path so far, the arrow of its command, and what is written above it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import mujoco
import numpy as np
from numpy.typing import NDArray

from uavaccel.units import ned_to_mujoco, quaternion_ned_to_mujoco
from uavaccel.watch.scene import show_drone
from uavaccel.watch.track import Track

if TYPE_CHECKING:
    from viser import ViserServer

COMMANDED, THINKING, IDEAL, ARROW = (0, 84, 160), (205, 50, 0), (245, 245, 245), (240, 180, 0)
ARROW_M, LABEL_M = 0.7, 0.55
PATH_WIDTH, IDEAL_WIDTH = 5.0, 2.0  # pixels


class Drone:
    """One track, shown at `offset_m` (NED) from where it was flown; `ideal_m` (p, 3) is drawn below it, thin."""

    def __init__(
        self,
        server: ViserServer,
        track: Track,
        model: mujoco.MjModel,
        offset_m: NDArray[np.float64],
        ideal_m: NDArray[np.float64] | None = None,
    ) -> None:
        self.track, self._offset_m = track, offset_m
        self._name = f"/{track.name}"
        self._scene = server.scene
        self._frame = server.scene.add_frame(self._name, show_axes=False)
        show_drone(server, self._name, model)
        self._label = server.scene.add_label(f"{self._name}/name", track.name, position=(0.0, 0.0, LABEL_M))
        self._arrow = server.scene.add_arrows(
            f"{self._name} command",
            np.zeros((1, 2, 3)),
            ARROW,
            shaft_radius=0.025,
            head_radius=0.07,
            head_length=0.16,
            visible=False,
        )
        places = self._shown(track.position_m)
        self._path = np.stack([places[:-1], places[1:]], axis=1)
        # a line between two samples shows what was flown in its middle: a command may end at either
        between = track.between_commands((track.time_s[:-1] + track.time_s[1:]) / 2)
        colours = np.where(between[:, None], THINKING, COMMANDED).astype(np.uint8)
        self._colours = np.repeat(colours[:, None], 2, axis=1)
        self._line = server.scene.add_line_segments(
            f"{self._name} path",
            self._path[:1],
            self._colours[:1],
            thickness=PATH_WIDTH,
            thickness_units="screen",
        )
        if ideal_m is not None:
            ideal = self._shown(ideal_m)
            server.scene.add_line_segments(
                f"{self._name} ideal",
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
        self._frame.position, self._frame.wxyz = shown, quaternion_ned_to_mujoco(attitude)
        flown = max(int(np.searchsorted(self.track.time_s, time_s, side="right")) - 1, 0)
        here = self.track.time_s[min(flown, len(self._path) - 1)]
        path, colours = np.asarray(self._path[:flown]), np.asarray(self._colours[:flown])
        if time_s > here and flown < len(self._path):  # up to the drone itself, between two samples
            path = np.concatenate([path, [[self._path[flown, 0], shown]]])
            colours = np.concatenate([colours, self._colours[flown : flown + 1]])
        if len(path):
            self._line.points, self._line.colors = path.astype(np.float32), colours
        self._line.visible = bool(len(path))
        self._show_command(time_s, shown)
        self._label.text = f"{self.track.name}: {self.state(wall_s)}"

    def state(self, wall_s: float) -> str:
        """In words, what drone and client do."""
        if wall_s >= self.track.wall_s:
            return "done"
        time_s = self.track.simulated_s(wall_s)
        if self.track.command(time_s) is not None:
            return "flies its command"
        stands = self.track.simulated_s(wall_s + 1e-6) == time_s
        return "client thinks, clock stands" if stands else "client thinks, drone flies on"

    def _show_command(self, time_s: float, at: NDArray[np.float64]) -> None:
        number = self.track.command(time_s)
        self._arrow.visible = number is not None and bool(self.track.velocities)
        if number is not None and self.track.velocities:
            velocity = ned_to_mujoco(self.track.velocities[number])
            tip = at + ARROW_M * velocity / max(float(np.linalg.norm(velocity)), 1e-9)
            self._arrow.points = np.array([[at, tip]])

    def _shown(self, place_m: NDArray[np.float64]) -> NDArray[np.float64]:
        return ned_to_mujoco(place_m + self._offset_m)
