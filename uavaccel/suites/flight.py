"""A flight of a run, whichever suite flew it: what the page in the browser, films and exports show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavaccel.draw.panels import Decisions
from uavaccel.sim.lane.layout import LaneLayout

Times = NDArray[np.int64]
Floats = NDArray[np.float64]
Counts = NDArray[np.integer]


class Commands(NamedTuple):
    """The c commands of a flight: when each began and ended, and its velocity (c, 3) NED in m/s."""

    start_ns: Times
    end_ns: Times
    velocity_m_s: Floats


class Window(NamedTuple):
    """Events up to `time_ns`, since the window before: rows (n, 4), t in s, x, y, p = 1 or -1.

    `counts`, ON and OFF per pixel (H, W), stands in where a run kept counts alone.
    """

    time_ns: int
    rows: NDArray[np.floating] | None
    counts: tuple[Counts, Counts] | None = None

    def per_pixel(self, shape: tuple[int, int]) -> tuple[Counts, Counts]:
        """Return ON and OFF events of each pixel of a camera of this shape."""
        if self.counts is not None:
            return self.counts
        on, off = np.zeros((2, *shape), np.int32)
        if self.rows is not None:
            x, y, positive = self.rows[:, 1].astype(int), self.rows[:, 2].astype(int), self.rows[:, 3] > 0
            np.add.at(on, (y[positive], x[positive]), 1)
            np.add.at(off, (y[~positive], x[~positive]), 1)
        return on, off


@dataclass(frozen=True)
class Flight:
    """One flight: n samples, NED metres, attitudes body FRD to NED; times in integer ns of simulated time."""

    title: str
    """Who flew, how fast, and how it ended."""
    clock_speed: float
    time_ns: Times
    position_m: Floats
    """(n, 3)"""
    orientation_wxyz: Floats
    """(n, 4)"""
    commands: Commands
    velocity_m_s: Floats | None = None
    """(n, 3), where it was recorded."""
    scene: str = "blocks"
    lane: LaneLayout | None = None
    image_ns: Times = field(default_factory=lambda: np.zeros(0, np.int64))
    images: NDArray[np.uint8] = field(default_factory=lambda: np.zeros((0, 0, 0), np.uint8))
    """(m, H, W) gray, or (m, H, W, 3) RGB."""
    windows: Sequence[Window] = ()
    """What an event camera saw."""
    collision: tuple[int, str] | None = None
    """When it hit something, and what."""
    decisions: Decisions | None = None
    """What a policy saw and how it rated the actions."""
