"""Estimates with 95 % intervals, and whether an interval lies within stated margins, outside them, or neither.

That two conditions do not differ significantly is no evidence that they are equivalent: with four games each, no
difference is significant. They are where the whole interval of their ratio lies within margins stated beforehand, as
by two one-sided tests (Schuirmann, J. Pharmacokinet. Biopharm. 15, 1987), each at 2.5 % with a 95 % interval.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from uavaccel.metrics.intervals import student_quantile

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
    """Return the mean of `values` (n,), one per training, with Student's interval; that of a single value has no width.

    Raises ValueError without values.
    """
    each = np.asarray(values, np.float64)
    if not each.size:
        raise ValueError("a mean needs at least one value")
    mean, width = float(each.mean()), 0.0
    if each.size > 1:
        width = float(student_quantile(each.size - 1) * each.std(ddof=1) / np.sqrt(each.size))
    return Estimate(mean, mean - width, mean + width)


def difference_estimate(first: Estimate, second: Estimate, correlation: float = 0.0) -> Estimate:
    """Return first - second with the interval that follows from theirs (MOVER), for shares of the same games that of
    Newcombe, Stat. Med. 17 (1998), method 10 of the paired ones.
    """
    (p, low_p, high_p), (q, low_q, high_q) = first, second

    def width(one: float, other: float) -> float:
        return float(np.sqrt(max(0.0, one**2 - 2.0 * correlation * one * other + other**2)))

    return Estimate(p - q, p - q - width(p - low_p, high_q - q), p - q + width(high_p - p, q - low_q))


def ratio_estimate(first: Estimate, second: Estimate, correlation: float = 0.0) -> Estimate:
    """Return first / second with the interval that follows from theirs (MOVER-R: Donner and Zou, Stat. Methods Med.
    Res. 21, 2012). Neither quantity can be negative; the upper end is infinite where the second may be 0.

    Raises ValueError where the second is 0.
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
