"""Effective speed-up of an accelerated cell over the real-time one, and the provenance of numbers."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from uavaccel.metrics.intervals import bootstrap_interval

Provenance = Literal["measured", "modelled", "mixed"]


def speedup_interval(baseline_wall_s: ArrayLike, wall_s: ArrayLike, seed: int) -> tuple[float, float]:
    """Return the bootstrap interval of the ratio of mean wall times of the same commands (paper, section IV-B).

    It is a ratio of means, not a mean of ratios, as games are not paired; ADSC at 1x is over the cell, and both are
    resampled independently. Raises ValueError on no games or on wall times that are not positive.
    """
    samples = [np.asarray(values, dtype=np.float64) for values in (baseline_wall_s, wall_s)]
    if any(values.size == 0 or not np.all(values > 0) for values in samples):
        raise ValueError("wall times must be positive, and there must be some")
    return bootstrap_interval(samples, lambda baseline, cell: baseline.mean(axis=-1) / cell.mean(axis=-1), seed)


def timing_provenance(timing: str) -> Provenance:
    """Return "measured" for the machine's own clock, "modelled" for a simulated one (virtual, lockstep)."""
    return "measured" if timing == "wall" else "modelled"


def combined_provenance(*parts: Provenance) -> Provenance:
    """Return the provenance of a number made of several: "mixed" unless all agree. Raises ValueError without parts."""
    if not parts:
        raise ValueError("a combined provenance needs at least one part")
    return parts[0] if len(set(parts)) == 1 else "mixed"
