"""The recorder of the hot loop: a bounded buffer of samples at exact ticks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from uavaccel.sim.vehicle import hotloop
from uavaccel.sim.vehicle.quadrotor import NEVER

SAMPLE_CAPACITY = 1 << 16


class Samples:
    """Rows (n, 14) that the hot loop writes: tick, position, wxyz, velocity, body rate."""

    def __init__(self, period_ticks: int, capacity: int | None = None) -> None:
        self.record = np.zeros(1, hotloop.RECORDER_DTYPE)
        self.buffer = np.empty((SAMPLE_CAPACITY if capacity is None else capacity, hotloop.SAMPLE_COLUMNS))
        self.record["period"] = period_ticks
        self.stop()

    @property
    def active(self) -> bool:
        return int(self.record["next_tick"][0]) != NEVER

    @property
    def dropped(self) -> int:
        """Number of samples for which the buffer had no room."""
        return int(self.record["dropped"][0])

    def start(self, tick: int) -> None:
        """Empty the buffer; the next sample is due at `tick`."""
        self.record["count"] = self.record["dropped"] = 0
        self.record["next_tick"] = tick

    def stop(self) -> None:
        """Stop recording; the rows stay."""
        self.record["next_tick"] = NEVER

    def rows(self) -> NDArray[np.float64]:
        """Return a copy of the recorded rows."""
        return self.buffer[: int(self.record["count"][0])].copy()

    def take(self) -> NDArray[np.float64]:
        """Return the rows and empty the buffer; recording continues."""
        rows = self.rows()
        self.record["count"] = 0
        return rows
