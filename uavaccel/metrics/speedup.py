"""Effective speed-up of an accelerated cell over the real-time one, and the provenance of numbers."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from uavaccel.metrics.intervals import bootstrap_interval

Provenance = Literal["measured", "modelled", "mixed"]


def effective_speedup(baseline_wall_s: ArrayLike, wall_s: ArrayLike) -> float:
    """Return the ratio of mean wall times of the same commands: ADSC at 1x over the cell (paper, section IV-B).

    It is a ratio of means, not a mean of ratios, as games are not paired. Raises ValueError on no games or on wall
    times that are not positive.
    """
    baseline, cell = _checked(baseline_wall_s), _checked(wall_s)
    return float(baseline.mean() / cell.mean())


def speedup_interval(baseline_wall_s: ArrayLike, wall_s: ArrayLike, seed: int) -> tuple[float, float]:
    """Return the bootstrap interval of `effective_speedup`; games of baseline and cell are resampled independently."""

    def ratio_of_means(baseline: np.ndarray, cell: np.ndarray) -> np.ndarray:
        return np.asarray(baseline.mean(axis=-1) / cell.mean(axis=-1))

    return bootstrap_interval((_checked(baseline_wall_s), _checked(wall_s)), ratio_of_means, seed)


def timing_provenance(timing: str) -> Provenance:
    """Return "measured" for the machine's own clock, "modelled" for a simulated one (virtual, lockstep)."""
    return "measured" if timing == "wall" else "modelled"


def combined_provenance(*parts: Provenance) -> Provenance:
    """Return the provenance of a number made of several: "mixed" unless all agree. Raises ValueError without parts."""
    if not parts:
        raise ValueError("a combined provenance needs at least one part")
    return parts[0] if len(set(parts)) == 1 else "mixed"


def _checked(wall_s: ArrayLike) -> np.ndarray:
    values = np.asarray(wall_s, dtype=np.float64)
    if values.size == 0 or not np.all(values > 0):
        raise ValueError("wall times must be positive, and there must be some")
    return values
