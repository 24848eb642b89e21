"""Estimates with 95 % intervals, what they decide, and the success of policies that were trained alike.

That two conditions do not differ significantly is no evidence that they are equivalent: with four games each, no
difference is significant. They are where the whole interval of their ratio lies within margins stated beforehand, as
by two one-sided tests (Schuirmann, J. Pharmacokinet. Biopharm. 15, 1987), each at 2.5 % with a 95 % interval.

Of policies a training and a lane are one sample each: all fly the same lanes, of which some are hard for all. Intervals
therefore cover trainings, lanes and single games, and those of a ratio or a difference are paired over the lanes.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import hypot, sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uavaccel.metrics.intervals import NORMAL_QUANTILE, Proportion, student_quantile

Interval = tuple[float, float]


def exceeds(interval: Interval, limit: float) -> bool | None:
    """Return whether a quantity is above `limit`; None where its interval contains the limit."""
    low, high = interval
    if low > limit:
        return True
    return False if high <= limit else None


def within(interval: Interval, margins: Interval) -> bool | None:
    """Return whether a quantity lies within `margins`, ends included; None where its interval is partly inside."""
    (low, high), (least, most) = interval, margins
    if least <= low and high <= most:
        return True
    return False if high < least or low > most else None


def opposite(shown: bool | None) -> bool | None:
    """Return the negation of a decision; what is undecided stays so."""
    return None if shown is None else not shown


def all_of(shown: Iterable[bool | None]) -> bool | None:
    """Return False where one decision is False, True where all are True, else None."""
    parts = list(shown)
    if False in parts:
        return False
    return None if None in parts else True


class Estimate(NamedTuple):
    """A value and the ends of its 95 % interval."""

    value: float
    low: float
    high: float

    @property
    def interval(self) -> Interval:
        return self.low, self.high

    def text(self, unit: str = "", digits: int = 3) -> str:
        """Return the estimate with its interval, as in "61.3x [61.2, 61.4]"."""
        value, low, high = (f"{each:.{digits}f}" for each in self)
        return f"{value}{unit} [{low}, {high}]"


def mean_estimate(values: ArrayLike) -> Estimate:
    """Return the mean of `values` (n,), one per training, with Student's interval; of a single value its ends are NaN.

    Raises ValueError without values.
    """
    each = np.asarray(values, np.float64)
    if not each.size:
        raise ValueError("a mean needs at least one value")
    mean, width = float(each.mean()), float("nan")
    if each.size > 1:
        width = float(student_quantile(each.size - 1) * each.std(ddof=1) / np.sqrt(each.size))
    return Estimate(mean, mean - width, mean + width)


def difference_estimate(first: Estimate, second: Estimate, correlation: float = 0.0) -> Estimate:
    """Return first - second with the interval that follows from theirs (MOVER), for shares of the same games that of
    Newcombe, Stat. Med. 17 (1998), method 10 of the paired ones, but for its continuity correction of a positive
    correlation.
    """
    (p, low_p, high_p), (q, low_q, high_q) = first, second

    def width(one: float, other: float) -> float:
        return float(np.sqrt(max(0.0, one**2 - 2.0 * correlation * one * other + other**2)))

    return Estimate(p - q, p - q - width(p - low_p, high_q - q), p - q + width(high_p - p, q - low_q))


def ratio_estimate(first: Estimate, second: Estimate, correlation: float = 0.0) -> Estimate:
    """Return first / second with the interval that follows from theirs (MOVER-R: Donner and Zou, Stat. Methods Med.
    Res. 21, 2012). Neither is negative; the upper end is infinite where the second may be 0. Raises ValueError at 0.
    """
    (p, low_p, high_p), (q, low_q, high_q) = first, second
    if q <= 0.0:
        raise ValueError("a ratio to 0 is unknown")
    lower, upper = (_end(p, q, *ends, correlation) for ends in ((low_p, high_q, -1.0), (high_p, low_q, 1.0)))
    return Estimate(p / q, lower, upper)


def _end(p: float, q: float, end_p: float, end_q: float, sign: float, correlation: float) -> float:
    """Return the lower end of a ratio from the lower end of p and the upper of q (sign -1), or its upper end (1)."""
    product, denominator = p * q, end_q * (2 * q - end_q)
    if min(paired := product - correlation * (p - end_p) * (end_q - q), denominator) > 0:
        product = paired  # elsewhere the quadratic has no root between: the unpaired end is the wider one
    root = np.sqrt(max(0.0, product**2 - end_p * (2 * p - end_p) * denominator))
    if abs(denominator) > 1e-12:
        return float(max(0.0, (product + sign * root) / denominator))
    if end_q > 0 and product > 0:  # end_q is 2 q: the quadratic is a line
        return float(end_p * (2 * p - end_p) / (2 * product))
    return float(np.inf) if sign > 0 else 0.0


FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Success:
    """The games won by each of one or more policies. Raises ValueError without policies."""

    policies: tuple[Proportion, ...]
    won: FloatArray | None = None
    """1 where a policy won on a lane, else 0 (policies, lanes); None where unknown, lanes differ or there is one."""

    def __post_init__(self) -> None:
        if not self.policies:
            raise ValueError("success needs at least one training")

    @classmethod
    def on_lanes(cls, outcomes: Sequence[ArrayLike] | NDArray[Any]) -> Success:
        """Return that of the outcomes (lanes,) of each policy, all on the same lanes in the same order."""
        won = np.array(outcomes, np.float64)
        return cls(tuple(Proportion(int(each.sum()), each.size) for each in won), won if won.shape[-1] > 1 else None)

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
    if x is None or y is None or x.shape[1] != y.shape[1]:
        return 0.0
    scale = np.prod([max(sum(covariance(each, each)), each.var() / each.size) for each in (x, y)])
    if not same_policies:
        x, y = x.mean(axis=0, keepdims=True), y.mean(axis=0, keepdims=True)
    return float(np.clip(sum(covariance(x, y)) / sqrt(scale), -1.0, 1.0)) if scale > 0.0 else 0.0
