"""Uncertainty over games and trainings: bootstraps, Wilson and Student, exact tests and permutations."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from itertools import combinations
from math import atan, comb, cos, pi, sin, sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

RESAMPLES = 2000
LEVEL = 0.95
TAILS = (1.0 - LEVEL) / 2.0, 1.0 - (1.0 - LEVEL) / 2.0
NORMAL_QUANTILE = 1.959963984540054  # below which 97.5 % of a standard normal distribution lie
UNKNOWN = float("nan"), float("nan")  # the ends of an interval of which a single value is known
LARGEST_QUANTILE = 12.8  # Student's for one degree of freedom is 12.71


def bootstrap_interval(
    samples: Sequence[ArrayLike], statistic: Callable[..., np.ndarray], seed: int
) -> tuple[float, float]:
    """Return the 95 % percentile bootstrap interval of `statistic(*samples)`, each sample resampled over its games.

    `samples` holds arrays (games,) with one value per game: pairs of games are not independent and must be averaged
    before. `statistic` reduces the last axis. The same seed gives the same interval. Its ends are NaN where a sample is
    of one game, which tells nothing of others. Raises ValueError for a sample without games.
    """
    rng = np.random.default_rng(seed)
    resampled = []
    for sample in samples:
        values = np.asarray(sample, dtype=np.float64)
        if values.size == 0:
            raise ValueError("a bootstrap needs at least one game")
        resampled.append(values[rng.integers(values.size, size=(RESAMPLES, values.size))])
    if any(sample.shape[1] == 1 for sample in resampled):
        return UNKNOWN
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
        n, p, z = self.games, self.ratio, NORMAL_QUANTILE  # Newcombe, Stat. Med. 17 (1998), method 3
        denominator = 2 * (n + z**2)
        centre, half = (2 * n * p + z**2) / denominator, z / denominator * sqrt(4 * n * p * (1 - p) + z**2)
        return centre - half if self.successes else 0.0, centre + half if self.successes < n else 1.0

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
    a, b = np.asarray(first, dtype=bool), np.asarray(second, dtype=bool)
    if a.shape != b.shape or a.ndim != 1:
        raise ValueError(f"paired outcomes need one length, got {a.shape} and {b.shape}")
    only_first, only_second = int(np.sum(a & ~b)), int(np.sum(b & ~a))
    discordant = only_first + only_second
    tail = sum(comb(discordant, wins) for wins in range(min(only_first, only_second) + 1))
    return McNemar(only_first, only_second, min(1.0, 2 * tail / 2**discordant))


def fisher_exact_p(first: tuple[int, int], second: tuple[int, int]) -> float:
    """Return the two-sided p-value of Fisher's exact test that two ratios, (successes, games) each, are equal."""
    (won, games), (others_won, others) = first, second
    wins = won + others_won
    ways = [comb(games, k) * comb(others, wins - k) for k in range(max(0, wins - others), min(games, wins) + 1)]
    seen = comb(games, won) * comb(others, others_won)
    return sum(way for way in ways if way <= seen) / sum(ways)


def student_quantile(degrees: int) -> float:
    """Return the value below which 97.5 % of Student's t distribution lie, to 14 digits. `degrees` is at least 1."""
    low, high = 0.0, LARGEST_QUANTILE
    while low < (middle := (low + high) / 2) < high:
        low, high = (middle, high) if _student_share(middle, degrees) < TAILS[1] else (low, middle)
    return high


def _student_share(value: float, degrees: int) -> float:
    """Return the share of Student's t distribution below a value >= 0 (Abramowitz and Stegun 26.7.3 and 26.7.4)."""
    angle = atan(value / sqrt(degrees))
    odd = degrees % 2
    term = total = cos(angle) * (degrees > 1) if odd else 1.0
    for k in range(1 + odd, degrees - 1, 2):
        term *= cos(angle) ** 2 * k / (k + 1)
        total += term
    return 0.5 + ((angle + sin(angle) * total) / pi if odd else sin(angle) * total / 2)


MOST_EXACT = 200_000  # permutations that are enumerated; beyond, so many are sampled
ROUNDING = 1e-12


def hierarchical_interval(samples: Sequence[ArrayLike], seed: int, resamples: int = RESAMPLES) -> tuple[float, float]:
    """Return the 95 % percentile bootstrap interval of the mean over seeds of each seed's mean, of real-valued results.

    `samples` has an array (games,) for each training seed; seeds are resampled, then the games of each. The interval
    lies in the range of the values and has no width where all are equal: for shares of games won take
    `estimates.Success`. For one seed it covers its games alone, and of a single game its ends are NaN. Equal `seed`
    gives equal intervals. Raises ValueError without seeds, and for a seed without games.
    """
    values = [np.asarray(sample, dtype=np.float64) for sample in samples]
    if not values or any(value.size == 0 for value in values):
        raise ValueError("a bootstrap over seeds needs at least one seed, and games of each")
    if sum(value.size for value in values) == 1:
        return UNKNOWN
    rng, count = np.random.default_rng(seed), len(values)
    resampled = rng.integers(count, size=(resamples, count))
    means = np.empty(resampled.shape)
    for number, games in enumerate(values):
        here = resampled == number
        chosen = rng.integers(games.size, size=(int(here.sum()), games.size))
        means[here] = games[chosen].mean(axis=1)
    low, high = np.quantile(means.mean(axis=1), TAILS)
    return float(low), float(high)


def permutation_p(first: ArrayLike, second: ArrayLike, seed: int = 0) -> float | None:
    """Return the two-sided p-value of a permutation test that two groups of trainings, a value each, have equal means.

    The test is exact up to MOST_EXACT permutations; beyond, as many are sampled. None where a group has fewer than two
    trainings: whatever their difference, the seeds may explain it.
    """
    groups = [np.asarray(group, dtype=np.float64) for group in (first, second)]
    sizes = groups[0].size, groups[1].size
    if min(sizes) < 2:
        return None
    pooled = np.concatenate(groups)
    shares = _shares(*sizes, seed)
    sums = shares @ pooled
    differences = sums / sizes[0] - (pooled.sum() - sums) / sizes[1]
    return _share_as_far(differences, float(groups[0].mean() - groups[1].mean()), _is_exact_split(*sizes))


def sign_flip_p(differences: ArrayLike, seed: int = 0) -> float | None:
    """Return the two-sided p-value of a sign-flip test that differences within trainings, one each, have mean 0.

    The test is exact or sampled as in `permutation_p`; None for fewer than two trainings.
    """
    values = np.asarray(differences, dtype=np.float64)
    if values.size < 2:
        return None
    exact = 2**values.size <= MOST_EXACT
    if exact:
        signs = 1.0 - 2.0 * (np.arange(2**values.size)[:, None] >> np.arange(values.size) & 1)
    else:
        signs = np.random.default_rng(seed).choice((-1.0, 1.0), size=(MOST_EXACT, values.size))
    return _share_as_far(signs @ values / values.size, float(values.mean()), exact)


def _share_as_far(differences: NDArray[np.float64], seen: float, exact: bool) -> float:
    """Return the share that is as far from 0 as what was observed, which is counted among sampled permutations."""
    as_far = int(np.sum(np.abs(differences) >= abs(seen) - ROUNDING))
    return as_far / differences.size if exact else (as_far + 1) / (differences.size + 1)


def _is_exact_split(first: int, second: int) -> bool:
    return comb(first + second, first) <= MOST_EXACT


@lru_cache(maxsize=8)
def _shares(first: int, second: int, seed: int) -> NDArray[np.float64]:
    """Return which trainings each permutation has in its first group, 0 or 1 (permutations, trainings)."""
    count = first + second
    if _is_exact_split(first, second):
        chosen = np.array(list(combinations(range(count), first)))
    else:
        ranks = np.random.default_rng(seed).random((MOST_EXACT, count))
        chosen = np.argsort(ranks, axis=1)[:, :first]
    shares = np.zeros((len(chosen), count))
    np.put_along_axis(shares, chosen, 1.0, axis=1)
    return shares


def speedup_interval(baseline_wall_s: ArrayLike, wall_s: ArrayLike, seed: int) -> tuple[float, float]:
    """Return the bootstrap interval of the ratio of mean wall times of the same commands (paper, section IV-B).

    It is a ratio of means, not a mean of ratios, as games are not paired; ADSC at 1x is over the cell, and both are
    resampled independently. Raises ValueError on no games or on wall times that are not positive.
    """
    samples = [np.asarray(values, dtype=np.float64) for values in (baseline_wall_s, wall_s)]
    if any(values.size == 0 or not np.all(values > 0) for values in samples):
        raise ValueError("wall times must be positive, and there must be some")
    return bootstrap_interval(samples, lambda baseline, cell: baseline.mean(axis=-1) / cell.mean(axis=-1), seed)
