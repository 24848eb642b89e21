"""What the recorder saw of one game, as the arrays that a run directory keeps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavaccel.units import NS_PER_S


@dataclass(frozen=True)
class Recording:
    """A game as the recorder saw it; ticks count from the acceptance of the first command.

    `samples` (n, 14): tick, position (m, NED), wxyz, velocity (m/s), body rate (rad/s). `commands` (c, 2): first
    and last tick. `dropped`: samples for which the buffer had no room.
    """

    samples: NDArray[np.float64]
    commands: NDArray[np.int64]
    tick_ns: int
    dropped: int = 0

    def arrays(self) -> dict[str, NDArray[np.float64]]:
        """The raw samples of a run directory, in seconds and SI units."""
        return {
            "time_s": self._seconds(self.samples[:, 0]),
            "position_m": self.samples[:, 1:4],
            "orientation_wxyz": self.samples[:, 4:8],
            "linear_velocity_m_s": self.samples[:, 8:11],
            "angular_velocity_rad_s": self.samples[:, 11:14],
            "command_start_s": self._seconds(self.commands[:, 0]),
            "command_end_s": self._seconds(self.commands[:, 1]),
        }

    def _seconds(self, ticks: NDArray[Any]) -> NDArray[np.float64]:
        """Ticks as the float nearest to the exact decimal, so that 25 ticks of 2 ms are 0.05."""
        return np.round(ticks * (self.tick_ns / NS_PER_S), 9)
