"""Success of policies trained alike: what other trainings would win on other lanes, and how two kinds compare.

A training and a lane are one sample each: all policies fly the same lanes, of which some are hard for all. Intervals
therefore cover trainings, lanes and single games, and those of a ratio or a difference are paired over the lanes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import hypot, sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uavaccel.metrics.equivalence import Estimate, difference_estimate, mean_estimate, ratio_estimate
from uavaccel.metrics.intervals import NORMAL_QUANTILE, Proportion

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Success:
    """The games won by each of one or more policies. Raises ValueError without policies."""

    policies: tuple[Proportion, ...]
    won: FloatArray | None = None
    """1 where a policy won on a lane, else 0 (policies, lanes); None where it is not known, or lanes differ."""

    def __post_init__(self) -> None:
        if not self.policies:
            raise ValueError("success needs at least one training")

    @classmethod
    def on_lanes(cls, outcomes: Sequence[ArrayLike] | NDArray[Any]) -> Success:
        """Return that of the outcomes (lanes,) of each policy, all on the same lanes in the same order."""
        won = np.array(outcomes, np.float64)
        return cls(tuple(Proportion(int(each.sum()), each.size) for each in won), won)

    @property
    def pooled(self) -> Proportion:
        return Proportion.pooled(self.policies)

    @property
    def estimate(self) -> Estimate:
        """The share of all games won, with a 95 % interval over trainings, lanes and games.

        It is the hull of Wilson's over all games, as if each had a training and a lane of its own, and of one whose
        half width is that of Student's over trainings and that of the lanes, squared and added (Banerjee, Sankhya 22,
        1960). Of one policy it is Wilson's, and holds for that policy alone. It has a width at 0 and 100 %, as Wilson's
        has. Where the lanes are not known, it does not cover that other lanes are harder for all.
        """
        low, high = self.pooled.interval
        if len(self.policies) > 1:
            mean = mean_estimate([policy.ratio for policy in self.policies])
            of_lanes = 0.0 if self.won is None else max(0.0, covariance(self.won, self.won).of_lanes)
            width = hypot(mean.high - mean.value, NORMAL_QUANTILE * sqrt(of_lanes))
            low, high = max(0.0, min(low, mean.value - width)), min(1.0, max(high, mean.value + width))
        return Estimate(self.pooled.ratio, low, high)

    def ratio(self, other: Success, same_policies: bool = False) -> Estimate:
        """Return this success over another's. Raises ValueError where the other is 0."""
        return ratio_estimate(self.estimate, other.estimate, correlation(self, other, same_policies))

    def difference(self, other: Success, same_policies: bool = False) -> Estimate:
        """Return this success less another's."""
        return difference_estimate(self.estimate, other.estimate, correlation(self, other, same_policies))


class Covariance(NamedTuple):
    """Covariance of two means over policies and lanes: what policies, lanes and single games contribute."""

    of_policies: float
    of_lanes: float
    of_games: float


def covariance(first: FloatArray, second: FloatArray) -> Covariance:
    """Return the covariance of the means of two results (policies, lanes) of the same policies on the same lanes.

    It is worked out by analysis of variance, in which chance may make a part negative. Of one policy, all is of games.
    """
    policies, lanes = first.shape
    of_lanes = float(np.cov(first.mean(axis=0), second.mean(axis=0))[0, 1]) / lanes
    if policies == 1:
        return Covariance(0.0, 0.0, of_lanes)
    left, right = (each - each.mean(0) - each.mean(1, keepdims=True) + each.mean() for each in (first, second))
    of_games = float(np.sum(left * right)) / ((policies - 1) * (lanes - 1)) / first.size
    of_policies = float(np.cov(first.mean(axis=1), second.mean(axis=1))[0, 1]) / policies
    return Covariance(of_policies - of_games, of_lanes - of_games, of_games)


def correlation(first: Success, second: Success, same_policies: bool) -> float:
    """Return that of two successes on the same lanes, and of the same policies if these flew twice; else 0."""
    x, y = first.won, second.won
    if x is None or y is None or x.shape[1] != y.shape[1] or x.shape[1] < 2:
        return 0.0
    scale = np.prod([max(sum(covariance(each, each)), each.var() / each.size) for each in (x, y)])
    if not same_policies:
        x, y = x.mean(axis=0, keepdims=True), y.mean(axis=0, keepdims=True)
    return float(np.clip(sum(covariance(x, y)) / sqrt(scale), -1.0, 1.0)) if scale > 0.0 else 0.0
