"""What a simulation counts and notes: how fast it was, and, while asked to, what it did when."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

TRACE_LENGTH = 1 << 16


@dataclass
class Speed:
    """Simulated and wall time passed while the clock ran, and the wall time given up as lost."""

    simulated_ns: int = 0
    wall_ns: int = 0
    lost_wall_ns: int = 0

    @property
    def real_time_factor(self) -> float:
        """Achieved simulated seconds per wall second; 0 before the clock ran."""
        return self.simulated_ns / self.wall_ns if self.wall_ns else 0.0


@dataclass
class Trace:
    """What the simulation did and when: (event, wall ns, simulated ns), the latest; kept only while switched on."""

    events: deque[tuple[str, int, int]] = field(default_factory=lambda: deque(maxlen=TRACE_LENGTH))
    enabled: bool = False
