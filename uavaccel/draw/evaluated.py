"""Evaluations during a training, on the axes of its learning curve: points with their intervals, or seeds in a band."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes

from uavaccel.metrics.intervals import wilson_interval


@dataclass(frozen=True)
class Evaluated:
    """Of one seed: when each evaluation was, in games or seconds (n,), and lanes won, of so many each."""

    at: Sequence[float]
    successes: Sequence[int]
    lanes: int

    @property
    def ratio(self) -> np.ndarray:
        """Success (n,), 0 to 1."""
        return np.asarray(self.successes, np.float64) / self.lanes


def plot_evaluated(axes: Axes, seeds: Sequence[Evaluated], colour: str) -> None:
    """One seed: points with 95 % Wilson intervals. Several: their mean where all were evaluated, from least to most."""
    if len(seeds) < 2:
        for seed in seeds:
            _plot_points(axes, seed, colour)
        return
    first, last = max(seed.at[0] for seed in seeds), min(seed.at[-1] for seed in seeds)
    at = np.unique([place for seed in seeds for place in seed.at if first <= place <= last])
    if not at.size:
        return
    success = np.array([np.interp(at, seed.at, seed.ratio) for seed in seeds])
    label = f"evaluated on {seeds[0].lanes} lanes: mean, least and most of {len(seeds)} seeds"
    axes.plot(at, success.mean(axis=0), "o--", color=colour, markersize=4, label=label)
    axes.fill_between(at, success.min(axis=0), success.max(axis=0), color=colour, alpha=0.3, linewidth=0)


def _plot_points(axes: Axes, seed: Evaluated, colour: str) -> None:
    ends = np.array([wilson_interval(won, seed.lanes) for won in seed.successes]).T
    reach = np.maximum(np.abs(ends - seed.ratio), 0.0)
    label = f"evaluated on {seed.lanes} lanes, 95 % Wilson interval"
    axes.errorbar(
        seed.at,
        seed.ratio,
        reach,
        fmt="o--",
        color=colour,
        markersize=4,
        linewidth=1.0,
        capsize=2,
        label=label,
    )
