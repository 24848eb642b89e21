"""Spatiotemporal Linear Combine distance (STLC) of two trajectories.

Su et al., "A survey of trajectory distance measures and performance evaluation", VLDB J. 29 (2020):

    Sim_S = mean_{p in R} e^{-d(p, S)} + mean_{q in S} e^{-d(q, R)}     d: metres to the nearest point
    Sim_T = mean_{p in R} e^{-t(p, S)} + mean_{q in S} e^{-t(q, R)}     t: seconds to the nearest time
    STLC  = lam Sim_S + (1 - lam) Sim_T                                 in (0, 2]; identical: 2

Space and time are matched independently, so on a closed path STLC cannot see a lap too few or too late:
report `uavaccel.metrics.trajectory.position_rmse` beside it. The paper (section III-C2a) gives neither units
nor lam; metres, seconds and lam = 0.5, the survey authors' own, are used here.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise, product

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from uavaccel.metrics.trajectory import FloatArray, Trajectory, mean_over_references, trajectory


def stlc(times_r: ArrayLike, points_r: ArrayLike, times_s: ArrayLike, points_s: ArrayLike, lam: float = 0.5) -> float:
    """Return the STLC of two flights: times (n,) in seconds from the start, points (n, 3) in metres.

    Symmetric; identical flights give exactly 2 for every `lam`. Raises ValueError on misshapen input.
    """
    r, s = trajectory(times_r, points_r), trajectory(times_s, points_s)
    return float(stlc_matrix([r], [s], lam)[0, 0])


def mean_stlc(games: Sequence[Trajectory], references: Sequence[Trajectory], exclude_self: bool = False) -> FloatArray:
    """Return each game's STLC averaged over all references (games,); see `trajectory.mean_over_references`."""
    return mean_over_references(stlc_matrix, games, references, exclude_self)


def stlc_matrix(games: Sequence[Trajectory], references: Sequence[Trajectory], lam: float = 0.5) -> FloatArray:
    """Return the STLC of every game with every reference (games, references)."""
    if not 0.0 <= lam <= 1.0:
        raise ValueError(f"lam must lie in [0, 1], got {lam}")
    space = _spatial_closeness(games, references) + _spatial_closeness(references, games).T
    time = _temporal_similarity(games, references)
    return time + lam * (space - time)  # exactly 2 where both are 2, which lam*S + (1-lam)*T is not


def _spatial_closeness(flights: Sequence[Trajectory], targets: Sequence[Trajectory]) -> FloatArray:
    """Return mean_{p in flight} e^{-d(p, target)} (flights, targets)."""
    result = np.empty((len(flights), len(targets)))
    if result.size == 0:
        return result
    points = np.concatenate([flight.position_m for flight in flights])
    bounds = np.cumsum([0] + [len(flight.position_m) for flight in flights])
    for j, target in enumerate(targets):
        closeness = np.exp(-_distances_m(points, target.position_m))
        result[:, j] = [closeness[start:end].mean() for start, end in pairwise(bounds)]
    return result


@njit(cache=True, nogil=True)
def _distances_m(points: FloatArray, path: FloatArray) -> FloatArray:
    """Return the distance of each of `points` (n, 3) from the nearest point of `path` (m, 3).

    From one point to the next a path moves at most its longest step: points that cannot be the nearest are skipped.
    """
    step_m, nearest = 1e-12, 0
    for j in range(1, len(path)):
        step_m = max(step_m, (1 + 1e-9) * _distance_m(path[j], path[j - 1]))
    result = np.empty(len(points))
    for i in range(len(points)):
        least_m, j = _distance_m(points[i], path[nearest]), 0  # its neighbour's nearest is near it
        while j < len(path):
            distance_m = _distance_m(points[i], path[j])
            if distance_m < least_m:
                least_m, nearest = distance_m, j
            j += 1 + int(min((distance_m - least_m) / step_m, len(path)))
        result[i] = least_m
    return result


@njit(cache=True, nogil=True)
def _distance_m(a: FloatArray, b: FloatArray) -> float:
    x, y, z = a[0] - b[0], a[1] - b[1], a[2] - b[2]
    return np.sqrt(x * x + y * y + z * z)


def _temporal_similarity(games: Sequence[Trajectory], references: Sequence[Trajectory]) -> FloatArray:
    """Return Sim_T (games, references); flights share few time grids, so each pair of grids is computed once."""
    known: dict[tuple[bytes, bytes], float] = {}
    result = np.empty((len(games), len(references)))
    times = [[(flight.time_s, flight.time_s.tobytes()) for flight in flights] for flights in (games, references)]
    for (i, (r, r_key)), (j, (s, s_key)) in product(*map(enumerate, times)):
        if (r_key, s_key) not in known:
            known[r_key, s_key] = _temporal_closeness(r, s) + _temporal_closeness(s, r)
        result[i, j] = known[r_key, s_key]
    return result


def _temporal_closeness(times_s: FloatArray, target_s: FloatArray) -> float:
    """Return mean_{p} e^{-t(p, target)}, with t to the nearer of the two neighbours in the sorted target times."""
    right = np.searchsorted(target_s, times_s).clip(max=target_s.size - 1)
    left = (right - 1).clip(min=0)
    gap_s = np.minimum(np.abs(times_s - target_s[left]), np.abs(times_s - target_s[right]))
    return float(np.exp(-gap_s).mean())
