"""The deterministic paths of the experiments, as lists of velocities (paper, sections III-A and III-C2)."""

from __future__ import annotations

from collections.abc import Sequence

from uavaccel.kinematics import Vector

SQUARE: tuple[Vector, ...] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0))
TWO_FORWARD_ONE_BACK: tuple[Vector, ...] = ((1.0, 0.0, 0.0), (1.0, 0.0, 0.0), (-1.0, 0.0, 0.0))

PATHS: dict[str, tuple[Vector, ...]] = {"square": SQUARE, "two_forward_one_back": TWO_FORWARD_ONE_BACK}


def velocities(path: str | Sequence[Vector], rounds: int, speed_m_s: float = 1.0) -> list[Vector]:
    """Return one velocity per command, NED m/s: a named path at `speed_m_s`, or the caller's own velocities."""
    if isinstance(path, str):
        once: Sequence[Vector] = [(x * speed_m_s, y * speed_m_s, z * speed_m_s) for x, y, z in PATHS[path]]
    else:
        once = path
    return list(once) * rounds
