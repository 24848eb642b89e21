"""Uncertainty over trainings: the bootstrap over seeds and games, and tests in which a training is one sample."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from itertools import combinations
from math import comb

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uavaccel.metrics.intervals import RESAMPLES, TAILS

MOST_EXACT = 200_000  # permutations that are enumerated; beyond, so many are sampled
ROUNDING = 1e-12


def hierarchical_interval(samples: Sequence[ArrayLike], seed: int, resamples: int = RESAMPLES) -> tuple[float, float]:
    """Return the 95 % percentile bootstrap interval of the mean over seeds of each seed's mean, of real-valued results.

    `samples` has an array (games,) for each training seed; seeds are resampled, then the games of each. The interval
    lies in the range of the values and has no width where all are equal: for shares of games won take
    `success.Success`. For one seed it covers its games alone. Equal `seed` gives equal intervals. Raises
    ValueError without seeds, and for a seed without games.
    """
    values = [np.asarray(sample, dtype=np.float64) for sample in samples]
    if not values or any(value.size == 0 for value in values):
        raise ValueError("a bootstrap over seeds needs at least one seed, and games of each")
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
