"""The recorder inside the hot loop: a bounded buffer of samples on exact ticks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from uavaccel.sim.saved import SavedState, State, into_record, of_record
from uavaccel.sim.vehicle import hotloop
from uavaccel.sim.vehicle.quadrotor import NEVER

SAMPLE_CAPACITY = 1 << 16


class Samples:
    """Rows (n, 14): tick, position, wxyz, velocity, body rate; the hot loop writes them."""

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
        """Samples that found the buffer full."""
        return int(self.record["dropped"][0])

    def start(self, tick: int) -> None:
        """Empty the buffer; the next sample is due at `tick`."""
        self.record["count"] = self.record["dropped"] = 0
        self.record["next_tick"] = tick

    def stop(self) -> None:
        self.record["next_tick"] = NEVER

    def rows(self) -> NDArray[np.float64]:
        """Copy of what was recorded."""
        return self.buffer[: int(self.record["count"][0])].copy()

    def take(self) -> NDArray[np.float64]:
        """The rows, and room for as many anew; the grid goes on."""
        rows = self.rows()
        self.record["count"] = 0
        return rows

    def get_state(self) -> State:
        return of_record(self.record) | {"rows": self.rows()}

    def set_state(self, state: SavedState) -> None:
        """Back to what `get_state` gave."""
        into_record(self.record, state)
        rows = np.asarray(state["rows"], float).reshape(-1, hotloop.SAMPLE_COLUMNS)
        self.buffer[: len(rows)] = rows
