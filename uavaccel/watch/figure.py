"""A drone on the page: its body, the arrow of its command, what is written above it, and its shadow on the ground."""

from __future__ import annotations

from typing import TYPE_CHECKING

import mujoco
import numpy as np
from numpy.typing import NDArray

from uavaccel.kinematics import Vector
from uavaccel.units import ned_to_mujoco
from uavaccel.watch.scene import ground_below, show_drone

if TYPE_CHECKING:
    from viser import ViserServer

COMMANDED, THINKING, ARROW, PLUMB = (0, 84, 160), (205, 50, 0), (240, 180, 0), (25, 30, 25)
ARROW_M, LABEL_M = 0.7, 0.55
PATH_WIDTH, PLUMB_WIDTH = 5.0, 1.5  # pixels
SHADOW_M, LIFT_M, SHADOW = 0.32, 0.02, (48, 54, 46)
STANDING_M = 0.15  # nearer to the ground there is no plumb line


class Figure:
    """A vehicle of `model`, by its `body`; places are MuJoCo's, in m, attitudes wxyz."""

    def __init__(self, server: ViserServer, name: str, model: mujoco.MjModel, data: mujoco.MjData, body: int) -> None:
        self._model, self._data, self._body = model, data, body
        scene, self._name = server.scene, f"/{name}"
        self._frame = scene.add_frame(self._name, show_axes=False)
        show_drone(server, self._name, model, body)
        self._label = scene.add_label(f"{self._name}/name", name, position=(0.0, 0.0, LABEL_M))
        self._arrow = scene.add_arrows(
            f"{self._name} command",
            np.zeros((1, 2, 3)),
            ARROW,
            shaft_radius=0.025,
            head_radius=0.07,
            head_length=0.16,
            visible=False,
        )
        self._plumb = scene.add_line_segments(
            f"{self._name} plumb line",
            np.zeros((1, 2, 3), np.float32),
            PLUMB,
            thickness=PLUMB_WIDTH,
            thickness_units="screen",
        )
        self._shadow = scene.add_cylinder(
            f"{self._name} shadow",
            SHADOW_M,
            LIFT_M / 2,
            SHADOW,  # opaque: what shines through would be the sky, not the ground's picture
            material="toon3",  # without the sun's highlight
            cast_shadow=False,
            receive_shadow=False,
        )

    def show(
        self, place: NDArray[np.float64], attitude: NDArray[np.float64], towards_ned: Vector | None, text: str
    ) -> float | None:
        """Move it, with an arrow along `towards_ned`; returns the metres to what is below it."""
        self._frame.position, self._frame.wxyz = place, attitude
        self._label.text = text
        length = 0.0 if towards_ned is None else float(np.linalg.norm(towards_ned))
        self._arrow.visible = length > 0.0
        if towards_ned is not None and length > 0.0:
            self._arrow.points = np.array([[place, place + ARROW_M * ned_to_mujoco(towards_ned) / length]])
        return self._show_height(place)

    def _show_height(self, place: NDArray[np.float64]) -> float | None:
        ground = ground_below(self._model, self._data, place, self._body)
        self._shadow.visible = ground is not None
        self._plumb.visible = ground is not None and place[2] - ground > STANDING_M
        if ground is None:
            return None
        foot = np.array([place[0], place[1], ground + LIFT_M])
        self._shadow.position = foot
        self._plumb.points = np.array([[place, foot]], np.float32)
        return float(place[2] - ground)
