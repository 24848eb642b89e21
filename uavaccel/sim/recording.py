"""What the recorder saw of one game, as the arrays that a run directory keeps."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavaccel.sim.saved import State, number_or_none, optional
from uavaccel.units import NS_PER_S

COMMAND_LOG_LENGTH = 1 << 16


class CommandLog:
    """First and last tick of the commands since the last reset: the latest `length` of them."""

    def __init__(self, length: int | None = None) -> None:
        self.origin_tick: int | None = None  # at which the first was accepted: a recording's t = 0
        self._ticks: deque[tuple[int, int]] = deque(maxlen=length or COMMAND_LOG_LENGTH)

    def accept(self, tick: int, end_tick: int) -> None:
        """A command begins, and ends at `end_tick` unless `cut_short`."""
        if self.origin_tick is None:
            self.origin_tick = tick
        self._ticks.append((tick, end_tick))

    def cut_short(self, tick: int) -> None:
        """The latest ended at `tick`."""
        self._ticks[-1] = (self._ticks[-1][0], tick)

    def last_goal(self, tick: int, period: int) -> int:
        """When the latest's loop has last set its goal by `tick`: as it began, and every `period` ticks from there."""
        accepted = self._ticks[-1][0]
        return accepted + (tick - accepted) // period * period

    def __len__(self) -> int:
        return len(self._ticks)

    def __iter__(self) -> Iterator[tuple[int, int]]:
        return iter(self._ticks)

    def ticks(self) -> NDArray[np.int64]:
        """First and last ticks (c, 2)."""
        return np.array(self._ticks, dtype=np.int64).reshape(-1, 2)

    def get_state(self) -> State:
        return {"origin_tick": optional(self.origin_tick), "ticks": self.ticks()}

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Back to what `get_state` gave."""
        self.origin_tick = number_or_none(state["origin_tick"])
        self._ticks.clear()
        self._ticks.extend((int(first), int(last)) for first, last in state["ticks"])


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
