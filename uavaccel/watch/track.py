"""A flight as it is watched: where the drone was, and how simulated time passed over the client's wall clock."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uavaccel.kinematics import Vector

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Track:
    """n samples and c commands of one flight; times in seconds, places in metres NED, attitudes wxyz.

    `marks` (m, 2) pairs seconds of the client's wall clock with simulated seconds; between two of them simulated time
    passes evenly. `velocities` are the commands', in m/s; None, or fewer, where nobody kept them.
    """

    name: str
    clock_speed: float
    time_s: Floats
    position_m: Floats
    orientation_wxyz: Floats
    command_start_s: Floats
    command_end_s: Floats
    marks: Floats
    velocities: Sequence[Vector | None] = ()

    @property
    def wall_s(self) -> float:
        """How long the flight took the client."""
        return float(self.marks[-1, 0])

    def simulated_s(self, wall_s: float) -> float:
        """Simulated time at this moment of the client's clock; the first and the last beyond the flight."""
        return float(np.interp(wall_s, self.marks[:, 0], self.marks[:, 1]))

    def pose(self, time_s: float) -> tuple[Floats, Floats]:
        """Place (3,) and attitude (4,) at a simulated time, between samples on the straight line."""
        place = [np.interp(time_s, self.time_s, column) for column in self.position_m.T]
        after = int(np.clip(np.searchsorted(self.time_s, time_s), 1, len(self.time_s) - 1))
        earlier, later = self.orientation_wxyz[after - 1], self.orientation_wxyz[after]
        span = self.time_s[after] - self.time_s[after - 1]
        share = float(np.clip((time_s - self.time_s[after - 1]) / span, 0.0, 1.0))
        # q and -q are one attitude: the nearer of them
        turned = (1.0 - share) * earlier + share * (later if earlier @ later >= 0.0 else -later)
        return np.array(place), turned / np.linalg.norm(turned)

    def farthest_from(self, other: Track) -> float:
        """The longest way, in metres, from a place of this flight to the nearest one of another's."""
        apart = self.position_m[:, None] - other.position_m[None]
        return float(np.sqrt((apart**2).sum(axis=2).min(axis=1).max()))

    def command(self, time_s: float) -> int | None:
        """The command that is flown at a simulated time; None between commands, while the client thinks."""
        begun = int(np.searchsorted(self.command_start_s, time_s, side="right")) - 1
        return begun if begun >= 0 and time_s < self.command_end_s[begun] else None

    def between_commands(self, time_s: Floats) -> NDArray[np.bool_]:
        """Of each simulated time (k,), whether no command was flown."""
        begun = np.searchsorted(self.command_start_s, time_s, side="right") - 1
        ends = np.concatenate([[-np.inf], self.command_end_s])[begun + 1]
        return np.asarray(time_s >= ends)


def track_of(
    name: str,
    clock_speed: float,
    arrays: Mapping[str, Floats],
    velocities: Sequence[Vector] = (),
    marks: Floats | None = None,
) -> Track:
    """The track of a game, of the arrays that its run keeps.

    They hold simulated time alone: without `marks` the client's clock is taken to have run with it.
    """
    time_s = arrays["time_s"]
    if marks is None:
        marks = np.array([[0.0, time_s[0]], [(time_s[-1] - time_s[0]) / clock_speed, time_s[-1]]])
    fields = ("position_m", "orientation_wxyz", "command_start_s", "command_end_s")
    position_m, attitude, start_s, end_s = (arrays[field] for field in fields)
    return Track(name, clock_speed, time_s, position_m, attitude, start_s, end_s, marks, velocities)
