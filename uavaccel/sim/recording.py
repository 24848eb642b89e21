"""What the recorder saw of one game, as the arrays that a run directory keeps."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uavaccel.sim.saved import SavedState, State, number_or_none, optional
from uavaccel.units import NS_PER_S

COMMAND_LOG_LENGTH = 1 << 16


class CommandLog:
    """First and last tick of the commands since the last reset: the first `length` of them, and the latest.

    As the recorder's samples they begin with the first command; `dropped` counts those for which there was no room.
    """

    def __init__(self, length: int | None = None) -> None:
        self.origin_tick: int | None = None  # at which the first was accepted: a recording's t = 0
        self.dropped = 0
        self._length = length or COMMAND_LOG_LENGTH
        self._ticks: list[tuple[int, int]] = []
        self._latest = (0, 0)  # the last of the list unless it was dropped

    def accept(self, tick: int, end_tick: int) -> None:
        """A command begins, and ends at `end_tick` unless `cut_short`."""
        if self.origin_tick is None:
            self.origin_tick = tick
        self._latest = (tick, end_tick)
        if len(self._ticks) < self._length:
            self._ticks.append(self._latest)
        else:
            self.dropped += 1

    def cut_short(self, tick: int) -> None:
        """The latest ended at `tick`."""
        self._latest = (self._latest[0], tick)
        if not self.dropped:
            self._ticks[-1] = self._latest

    def last_goal(self, tick: int, period: int) -> int:
        """When the latest's loop has last set its goal by `tick`: as it began, and every `period` ticks from there."""
        accepted = self._latest[0]
        return accepted + (tick - accepted) // period * period

    def __len__(self) -> int:
        return len(self._ticks)

    def __iter__(self) -> Iterator[tuple[int, int]]:
        return iter(self._ticks)

    def ticks(self) -> NDArray[np.int64]:
        """First and last ticks (c, 2)."""
        return np.array(self._ticks, dtype=np.int64).reshape(-1, 2)

    def get_state(self) -> State:
        state: State = {"origin_tick": optional(self.origin_tick), "ticks": self.ticks()}
        return state | {"latest": np.array(self._latest), "dropped": self.dropped}

    def set_state(self, state: SavedState) -> None:
        """Back to what `get_state` gave."""
        self.origin_tick = number_or_none(state["origin_tick"])
        self._ticks = [(int(first), int(last)) for first, last in state["ticks"]]
        first, last = state.get("latest", self._ticks[-1] if self._ticks else (0, 0))
        self._latest, self.dropped = (int(first), int(last)), int(state.get("dropped", 0))


@dataclass(frozen=True)
class Recording:
    """A game as the recorder saw it; ticks count from the acceptance of the first command.

    `samples` (n, 14): tick, position (m, NED), wxyz, velocity (m/s), body rate (rad/s). `commands` (c, 2): first
    and last tick. `dropped` and `commands_dropped`: those of either for which there was no room; the first are kept.
    """

    samples: NDArray[np.float64]
    commands: NDArray[np.int64]
    tick_ns: int
    dropped: int = 0
    commands_dropped: int = 0

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

    def _seconds(self, ticks: NDArray[np.int64] | NDArray[np.float64]) -> NDArray[np.float64]:
        """Ticks as the float nearest to the exact decimal, so that 25 ticks of 2 ms are 0.05."""
        return np.round(ticks * (self.tick_ns / NS_PER_S), 9)
