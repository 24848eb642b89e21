"""A game's recording, samples and commands, as the arrays in a run directory."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uavaccel.forms import ArrayForm
from uavaccel.units import NS_PER_S

COMMAND_LOG_LENGTH = 1 << 16
RECORDED = {
    "time_s": ArrayForm("f8", ("samples",), ascends=True),
    "position_m": ArrayForm("f8", ("samples", 3)),
    "orientation_wxyz": ArrayForm("f8", ("samples", 4)),
    "linear_velocity_m_s": ArrayForm("f8", ("samples", 3)),
    "angular_velocity_rad_s": ArrayForm("f8", ("samples", 3)),
    "command_start_s": ArrayForm("f8", ("commands",), ascends=True),
    "command_end_s": ArrayForm("f8", ("commands",), ascends=True),
}
"""The forms of what `Recording.arrays` makes."""


class CommandLog:
    """First and last ticks of the commands since the last reset: the first `length` commands, and the latest.

    `dropped` counts the commands for which there was no room.
    """

    def __init__(self, length: int | None = None) -> None:
        self.origin_tick: int | None = None  # of the first command: t = 0 of a recording
        self.dropped = 0
        self._length = length or COMMAND_LOG_LENGTH
        self._ticks: list[tuple[int, int]] = []
        self._latest = (0, 0)  # the last of the list unless it was dropped

    def accept(self, tick: int, end_tick: int) -> None:
        """Add a command that begins at `tick` and ends at `end_tick` unless it is `cut_short`."""
        if self.origin_tick is None:
            self.origin_tick = tick
        self._latest = (tick, end_tick)
        if len(self._ticks) < self._length:
            self._ticks.append(self._latest)
        else:
            self.dropped += 1

    def cut_short(self, tick: int) -> None:
        """Let the latest command end at `tick`."""
        self._latest = (self._latest[0], tick)
        if not self.dropped:
            self._ticks[-1] = self._latest

    def last_goal(self, tick: int, period: int) -> int:
        """Return the last tick up to `tick` at which the latest command set its goal, which it does every `period`."""
        accepted = self._latest[0]
        return accepted + (tick - accepted) // period * period

    def __len__(self) -> int:
        return len(self._ticks)

    def __iter__(self) -> Iterator[tuple[int, int]]:
        return iter(self._ticks)

    def ticks(self) -> NDArray[np.int64]:
        """Return the first and last ticks of c commands (c, 2)."""
        return np.array(self._ticks, dtype=np.int64).reshape(-1, 2)


@dataclass(frozen=True)
class Recording:
    """A recorded game; ticks count from the start of the first command.

    `samples` (n, 14) are tick, position (m, NED), wxyz, velocity (m/s), body rate (rad/s); `commands` (c, 2) are first
    and last ticks. `dropped` and `commands_dropped` count later ones for which there was no room.
    """

    samples: NDArray[np.float64]
    commands: NDArray[np.int64]
    tick_ns: int
    dropped: int = 0
    commands_dropped: int = 0

    def arrays(self) -> dict[str, NDArray[np.float64]]:
        """Return the arrays of a run directory, in seconds and SI units."""
        return {
            "time_s": self._seconds(self.samples[:, 0]),
            "position_m": self.samples[:, 1:4],
            "orientation_wxyz": self.samples[:, 4:8],
            "linear_velocity_m_s": self.samples[:, 8:11],
            "angular_velocity_rad_s": self.samples[:, 11:14],
            "command_start_s": self._seconds(self.commands[:, 0]),
            "command_end_s": self._seconds(self.commands[:, 1]),
        }

    def _seconds(self, ticks: NDArray[np.int64] | NDArray[np.float64]) -> NDArray[np.float64]:
        """Convert ticks to the float nearest to the exact decimal: 25 ticks of 2 ms are 0.05."""
        return np.round(ticks * (self.tick_ns / NS_PER_S), 9)
