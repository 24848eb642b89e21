"""A MODEL of a game engine's auto-exposure, which the paper switched off: a gain that slowly follows the brightness.

Unreal changes the exposure by a limited number of stops per second of running time (by default 3 up, 1 down), and not
while the game is paused. That is wall time: at ClockSpeed k only 1/k of it passes in the same flight, so that images of
the same place differ in brightness.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from uavaccel.units import NS_PER_S
from uavaccel.vision.guard import mean_brightness

UP_STOPS_PER_S, DOWN_STOPS_PER_S = 3.0, 1.0
LARGEST_STOPS = 2.0  # either way; this project's choice

Image = NDArray[np.uint8]


class AutoExposure:
    """Adapts each image's mean brightness towards that of the first, which stays unchanged."""

    def __init__(self) -> None:
        self.stops = 0.0
        self._target: float | None = None
        self._last_ns = 0

    def expose(self, image: Image, ran_ns: int) -> Image:
        """Return a copy of a gray or colour image, exposed after a total running wall time of `ran_ns`."""
        brightness = max(mean_brightness(image), 1.0)
        if self._target is None:
            self._target, self._last_ns = brightness, ran_ns
        wanted = float(np.clip(np.log2(self._target / brightness), -LARGEST_STOPS, LARGEST_STOPS))
        passed_s = (ran_ns - self._last_ns) / NS_PER_S
        step = np.clip(wanted - self.stops, -DOWN_STOPS_PER_S * passed_s, UP_STOPS_PER_S * passed_s)
        self.stops, self._last_ns = self.stops + float(step), ran_ns
        exposed: NDArray[np.float64] = np.clip(np.round(image * 2.0**self.stops), 0, 255)
        return exposed.astype(np.uint8)
