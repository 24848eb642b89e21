"""What an interval shows: that a quantity lies within stated margins, that it lies outside them, or neither.

That two conditions do not differ significantly is no evidence that they are alike: with four games each, everything is.
Alike they are where the whole interval of their ratio lies within margins stated beforehand, as by two one-sided tests
(Schuirmann, J. Pharmacokinet. Biopharm. 15, 1987); a 95 % interval makes each of the two a test at 2.5 %.

scipy.stats is loaded where it is needed, as in intervals.py.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from uavaccel.metrics.intervals import LEVEL, Proportion

Interval = tuple[float, float]


def exceeds(interval: Interval, limit: float) -> bool | None:
    """Whether a quantity is above `limit`: None where its interval holds the limit."""
    low, high = interval
    if low > limit:
        return True
    return False if high <= limit else None


def within(interval: Interval, margins: Interval) -> bool | None:
    """Whether a quantity lies within `margins`, ends included: None where its interval is partly inside."""
    (low, high), (least, most) = interval, margins
    if least <= low and high <= most:
        return True
    return False if high < least or low > most else None


def opposite(shown: bool | None) -> bool | None:
    """Of what is not shown, the opposite is not shown either."""
    return None if shown is None else not shown


def all_of(shown: Iterable[bool | None]) -> bool | None:
    """False where one part is shown to be false, True where all are shown to be true, else None."""
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
        """61.3x [61.2, 61.4]"""
        value, low, high = (f"{each:.{digits}f}" for each in self)
        return f"{value}{unit} [{low}, {high}]"


def mean_estimate(values: ArrayLike) -> Estimate:
    """Mean of `values` (n,), one a training, with Student's interval; a lone value has none but itself.

    Raises ValueError without values.
    """
    from scipy.stats import t

    each = np.asarray(values, np.float64)
    if not each.size:
        raise ValueError("a mean needs at least one value")
    mean, width = float(each.mean()), 0.0
    if each.size > 1:
        width = float(t.ppf((1 + LEVEL) / 2, each.size - 1) * each.std(ddof=1) / np.sqrt(each.size))
    return Estimate(mean, mean - width, mean + width)


def success_estimate(trainings: Sequence[Proportion]) -> Estimate:
    """Success of policies trained alike, each flown in games of its own.

    Games say how well a policy flies, not what another training would have given. Of several trainings the interval
    is therefore the hull of Wilson's over all games and Student's over the trainings; of one it is Wilson's, and
    holds for that policy alone. Raises ValueError without trainings.
    """
    if not trainings:
        raise ValueError("success needs at least one training")
    pooled = Proportion(sum(each.successes for each in trainings), sum(each.games for each in trainings))
    low, high = pooled.interval
    if len(trainings) > 1:
        over = mean_estimate([each.ratio for each in trainings])
        low, high = max(0.0, min(low, over.low)), min(1.0, max(high, over.high))
    return Estimate(pooled.ratio, low, high)


def ratio_estimate(first: Estimate, second: Estimate) -> Estimate:
    """first / second with the interval that follows from theirs (MOVER-R: Donner and Zou, Stat. Methods Med. Res. 21,
    2012), both of quantities that cannot be negative; without an upper end where the second may be 0.

    Raises ValueError where the second is 0.
    """
    (p, low_p, high_p), (q, low_q, high_q) = first, second
    if q <= 0.0:
        raise ValueError("a ratio to 0 is unknown")
    return Estimate(p / q, _end(p, q, low_p, high_q, -1.0), _end(p, q, high_p, low_q, 1.0))


def _end(p: float, q: float, end_p: float, end_q: float, sign: float) -> float:
    """The lower end of a ratio from the lower of p and the upper of q (sign -1), or the upper from the others (1)."""
    product, denominator = p * q, end_q * (2 * q - end_q)
    root = np.sqrt(max(0.0, product**2 - end_p * (2 * p - end_p) * denominator))
    if abs(denominator) > 1e-12:
        return float(max(0.0, (product + sign * root) / denominator))
    if end_q > 0 and product > 0:  # end_q is 2 q: the quadratic is a line
        return float(end_p * (2 * p - end_p) / (2 * product))
    return float(np.inf) if sign > 0 else 0.0
