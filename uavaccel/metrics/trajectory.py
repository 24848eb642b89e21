"""Recorded flights compared: position errors, event dissimilarity, and the handling of identical replicas.

Times are seconds from the tick at which a game's first command was accepted; positions are metres.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.intp]


class Trajectory(NamedTuple):
    """Time-stamped points of one flight: `time_s` (n,) ascending, `position_m` (n, 3)."""

    time_s: FloatArray
    position_m: FloatArray


def trajectory(time_s: ArrayLike, position_m: ArrayLike) -> Trajectory:
    """Return a checked `Trajectory`. Raises ValueError for empty, misshapen, non-finite or unsorted input."""
    times = np.ascontiguousarray(time_s, dtype=np.float64)
    points = np.ascontiguousarray(position_m, dtype=np.float64)
    if times.ndim != 1 or times.size == 0 or points.ndim != 2 or len(points) != times.size:
        raise ValueError(f"a trajectory needs times (n,), points (n, 3), not {times.shape}, {points.shape}")
    if not (np.isfinite(times).all() and np.isfinite(points).all()):
        raise ValueError("a trajectory's times and points must be finite")
    if np.any(np.diff(times) < 0):
        raise ValueError("a trajectory's times must ascend")
    return Trajectory(times, points)


def position_rmse(reference: Trajectory, flight: Trajectory) -> float:
    """Return the root mean square distance in metres between two flights at equal simulated times.

    They are compared at the reference's sample times, the other flight interpolated linearly, up to the end of the
    shorter one; NaN if they do not overlap in time. Unlike STLC it reveals a lap too few or too late.
    """
    shared = min(reference.time_s.size, flight.time_s.size)
    if np.array_equal(reference.time_s[:shared], flight.time_s[:shared]):  # one grid: nothing to interpolate
        difference = flight.position_m[:shared] - reference.position_m[:shared]
    else:
        inside = (reference.time_s >= flight.time_s[0]) & (reference.time_s <= flight.time_s[-1])
        columns = [np.interp(reference.time_s[inside], flight.time_s, column) for column in flight.position_m.T]
        difference = np.column_stack(columns) - reference.position_m[inside]
    if difference.size == 0:
        return float("nan")
    return float(np.sqrt(np.mean(np.einsum("ij,ij->i", difference, difference))))


def mean_position_rmse(
    games: Sequence[Trajectory], references: Sequence[Trajectory], exclude_self: bool = False
) -> FloatArray:
    """Return each game's `position_rmse` averaged over the references (games,); see `mean_over_references`."""

    def rmse_matrix(games: Sequence[Trajectory], references: Sequence[Trajectory]) -> FloatArray:
        return np.array([[position_rmse(reference, game) for reference in references] for game in games])

    return mean_over_references(rmse_matrix, games, references, exclude_self)


def command_gaps_s(command_start_s: ArrayLike, command_end_s: ArrayLike) -> FloatArray:
    """Return the simulated seconds between a command's end and the next one's acceptance (commands - 1,)."""
    start = np.asarray(command_start_s, dtype=np.float64)
    end = np.asarray(command_end_s, dtype=np.float64)
    return start[1:] - end[:-1]


def quartiles(values: ArrayLike) -> tuple[float, float, float]:
    """Return lower quartile, median and upper quartile (linear interpolation); NaN where a value is NaN."""
    q25, median, q75 = np.quantile(np.asarray(values, dtype=np.float64), (0.25, 0.5, 0.75))
    return float(q25), float(median), float(q75)


def distinct(flights: Sequence[Trajectory]) -> tuple[list[Trajectory], IndexArray]:
    """Return the byte-wise distinct flights in order of appearance, and each flight's index among them.

    Replicas of a native TCSC game are identical, so that whatever is computed per pair is computed once.
    """
    keys = [(flight.time_s.tobytes(), flight.position_m.tobytes()) for flight in flights]
    unique = dict(zip(reversed(keys), reversed(flights), strict=True))  # of each the first
    places = {key: place for place, key in enumerate(dict.fromkeys(keys))}
    return [unique[key] for key in places], np.array([places[key] for key in keys], np.intp)


def mean_over_references(
    measure: Callable[[Sequence[Trajectory], Sequence[Trajectory]], FloatArray],
    games: Sequence[Trajectory],
    references: Sequence[Trajectory],
    exclude_self: bool,
) -> FloatArray:
    """Return the mean over the references (games,) of a measure, which is computed for distinct flights only.

    `measure` returns a matrix (games, references). With `exclude_self` the games are the references, in
    one order, and a game is not compared with itself; a lone reference has nothing to compare with: NaN.
    Raises ValueError if there are no references, or if `exclude_self` meets lists of different lengths.
    """
    if not references:
        raise ValueError("a mean over references needs at least one reference")
    (unique_games, game_index), (unique_references, reference_index) = map(distinct, (games, references))
    full = measure(unique_games, unique_references)[np.ix_(game_index, reference_index)]
    if not exclude_self:
        return np.asarray(full.mean(axis=1))
    if full.shape[0] != full.shape[1]:
        raise ValueError("exclude_self needs the games themselves as references")
    if full.shape[0] == 1:
        return np.full(1, np.nan)
    return np.asarray(np.mean(full, axis=1, where=~np.eye(full.shape[0], dtype=bool)))


def active_pixels(counts: ArrayLike) -> NDArray[np.int64]:
    """Count the pixels with at least one event, for each image of (..., H, W) counts of one polarity."""
    return np.asarray(np.count_nonzero(counts, axis=(-2, -1)), np.int64)


def dvs_ed_percent(
    on: ArrayLike, off: ArrayLike, reference_on: ArrayLike, reference_off: ArrayLike
) -> NDArray[np.float64]:
    """Return the DVS-ED (n,) of each image of a run against the real-time run's image of the same index.

    |difference in ON pixels| + |difference in OFF pixels|, as a percentage of all pixels. Arguments are event
    counts (n, H, W); of two runs of unequal length the images that both have are compared.
    Raises ValueError where the images differ in size, or a run's polarities in number.
    """
    shapes = [np.shape(stack) for stack in (on, off, reference_on, reference_off)]
    if len(shapes[0]) != 3 or shapes[0] != shapes[1] or shapes[2] != shapes[3] or shapes[0][1:] != shapes[2][1:]:
        raise ValueError(f"event counts must be (n, H, W), not {shapes}")
    run, reference = (
        np.stack([active_pixels(counts) for counts in pair]) for pair in ((on, off), (reference_on, reference_off))
    )
    shared = min(run.shape[1], reference.shape[1])
    return np.asarray(100.0 * np.abs(run[:, :shared] - reference[:, :shared]).sum(axis=0) / np.prod(shapes[0][1:]))
