"""Uncertainty over games: the bootstrap, Wilson's interval, and the exact tests of McNemar and Fisher.

scipy.stats takes long to load, so it is imported where it is used.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

RESAMPLES = 2000
LEVEL = 0.95
TAILS = (1.0 - LEVEL) / 2.0, 1.0 - (1.0 - LEVEL) / 2.0


def bootstrap_interval(
    samples: Sequence[ArrayLike], statistic: Callable[..., np.ndarray], seed: int
) -> tuple[float, float]:
    """Return the 95 % percentile bootstrap interval of `statistic(*samples)`, each sample resampled over its games.

    `samples` holds arrays (games,) with one value per game: pairs of games are not independent and must be averaged
    before. `statistic` reduces the last axis. The same seed gives the same interval. Raises ValueError for a sample
    without games.
    """
    rng = np.random.default_rng(seed)
    resampled = []
    for sample in samples:
        values = np.asarray(sample, dtype=np.float64)
        if values.size == 0:
            raise ValueError("a bootstrap needs at least one game")
        resampled.append(values[rng.integers(values.size, size=(RESAMPLES, values.size))])
    low, high = np.quantile(statistic(*resampled), TAILS)
    return float(low), float(high)


def median_interval(values: ArrayLike, seed: int) -> tuple[float, float]:
    """Return the bootstrap interval over games of the median of `values` (games,)."""
    return bootstrap_interval((values,), partial(np.median, axis=-1), seed)


@dataclass(frozen=True)
class Proportion:
    """The games won of those flown. Raises ValueError unless 0 <= successes <= games > 0."""

    successes: int
    games: int

    def __post_init__(self) -> None:
        if self.games <= 0 or not 0 <= self.successes <= self.games:
            raise ValueError(f"need 0 <= successes <= games > 0, got {self.successes} of {self.games}")

    @classmethod
    def of(cls, keys: Mapping[str, Any]) -> Proportion:
        """Return the proportion of a mapping with the keys `successes` and `games`."""
        return cls(keys["successes"], keys["games"])

    @classmethod
    def pooled(cls, parts: Sequence[Proportion]) -> Proportion:
        """Return the proportion of all games of several proportions."""
        return cls(sum(part.successes for part in parts), sum(part.games for part in parts))

    @property
    def ratio(self) -> float:
        return self.successes / self.games

    @cached_property
    def interval(self) -> tuple[float, float]:
        """The ends of the 95 % Wilson score interval of the ratio, in [0, 1]."""
        from scipy.stats import binomtest

        interval = binomtest(self.successes, self.games).proportion_ci(LEVEL, method="wilson")
        return float(interval.low), float(interval.high)

    def as_summary(self) -> dict[str, float]:
        """Return the keys of a summary for the proportion."""
        low, high = self.interval
        return {
            "games": self.games,
            "successes": self.successes,
            "success_ratio": self.ratio,
            "wilson_low": low,
            "wilson_high": high,
        }

    def text(self, digits: int = 1, interval_digits: int = 0) -> str:
        """Return the ratio with its interval in per cent, as in "23.0% [16, 32]"."""
        low, high = (f"{100 * end:.{interval_digits}f}" for end in self.interval)
        return f"{self.ratio:.{digits}%} [{low}, {high}]"


class McNemar(NamedTuple):
    """Games that only the first condition won, games that only the second won, and the two-sided exact p-value."""

    only_first: int
    only_second: int
    p_value: float


def mcnemar_exact(first: ArrayLike, second: ArrayLike) -> McNemar:
    """Return McNemar's exact test of two conditions on the same lanes: bool arrays (games,), paired by index.

    Only discordant games count; without any, p is 1. Raises ValueError for arrays of different lengths.
    """
    from scipy.stats import binomtest

    a, b = np.asarray(first, dtype=bool), np.asarray(second, dtype=bool)
    if a.shape != b.shape or a.ndim != 1:
        raise ValueError(f"paired outcomes need one length, got {a.shape} and {b.shape}")
    only_first, only_second = int(np.sum(a & ~b)), int(np.sum(b & ~a))
    discordant = only_first + only_second
    p_value = float(binomtest(only_first, discordant).pvalue) if discordant else 1.0
    return McNemar(only_first, only_second, p_value)


def fisher_exact_p(first: tuple[int, int], second: tuple[int, int]) -> float:
    """Return the two-sided p-value of Fisher's exact test that two ratios, (successes, games) each, are equal."""
    from scipy.stats import fisher_exact

    table = np.array([[successes, games - successes] for successes, games in (first, second)])
    return float(fisher_exact(table).pvalue)
