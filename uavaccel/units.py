"""Conversions of frames and units.

Outside MuJoCo everything is NED in the world and FRD in the body, as in AirSim; inside, MuJoCo's axes are
x forward, y left, z up. One turns into the other by half a turn about x, which is its own inverse.
Simulated time is an integer count of nanoseconds or of physics steps ("ticks").
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence
from fractions import Fraction
from itertools import pairwise
from numbers import Real

import numpy as np
from numpy.typing import ArrayLike, NDArray

from uavaccel.errors import UserError

NS_PER_S = 1_000_000_000
CLOCK_SPEEDS = (1e-3, 1e5)
"""Least and most simulated seconds per second of wall time: far beyond any use."""
QUANTILES = (0.0, 0.01, 0.05, 0.1, 0.25, 0.5, 0.75, 0.9, 0.95, 0.99, 0.999, 1.0)
"""Of measured times, those that a calibration file keeps."""
_FLIP_VECTOR = np.array([1.0, -1.0, -1.0])
_FLIP_QUATERNION = np.array([1.0, 1.0, -1.0, -1.0])


def ned_to_mujoco(vector: ArrayLike) -> NDArray[np.float64]:
    """Turn (..., 3) NED or FRD components into MuJoCo's; positions, velocities and rates alike."""
    turned: NDArray[np.float64] = np.asarray(vector, dtype=np.float64) * _FLIP_VECTOR
    return turned


mujoco_to_ned: Callable[[ArrayLike], NDArray[np.float64]] = ned_to_mujoco


def quaternion_ned_to_mujoco(quaternion: ArrayLike) -> NDArray[np.float64]:
    """Turn (..., 4) wxyz attitudes FRD to NED into MuJoCo's FLU to NWU."""
    turned: NDArray[np.float64] = np.asarray(quaternion, dtype=np.float64) * _FLIP_QUATERNION
    return turned


quaternion_mujoco_to_ned: Callable[[ArrayLike], NDArray[np.float64]] = quaternion_ned_to_mujoco


def euler_from_quaternion(quaternion: ArrayLike) -> tuple[float, float, float]:
    """Roll, pitch and yaw in radians (z-y-x order) of one wxyz quaternion."""
    w, x, y, z = (float(value) for value in np.asarray(quaternion))
    roll = float(np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)))
    pitch = float(np.arcsin(np.clip(2 * (w * y - z * x), -1.0, 1.0)))
    yaw = float(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))
    return roll, pitch, yaw


def attitude_difference_rad(a: ArrayLike, b: ArrayLike) -> NDArray[np.float64]:
    """Return the angle in radians of the rotation between wxyz quaternions (..., 4); exactly 0 between equal ones.

    It is computed from the chord between them: the arc cosine of their product would amplify rounding to 1e-3 rad.
    """
    a, b = np.asarray(a, float), np.asarray(b, float)
    b = np.where(np.sum(a * b, axis=-1, keepdims=True) < 0.0, -b, b)  # q and -q are one attitude
    return np.asarray(4.0 * np.arctan2(np.linalg.norm(a - b, axis=-1), np.linalg.norm(a + b, axis=-1)))


def exact(number: float | int | str | Fraction) -> Fraction:
    """Return a number as its decimal notation says, without binary rounding: 0.1 is 1/10."""
    return number if isinstance(number, Fraction) else Fraction(str(number))


def real(value: object) -> float | None:
    """Return a real number, NumPy's included, as the decimal that it prints: np.float32(0.1) is 0.1; else None."""
    value = value[()] if isinstance(value, np.ndarray) else value
    if isinstance(value, np.floating):
        return float(str(value))
    if isinstance(value, bool) or not isinstance(value, Real):
        return None
    try:
        return float(value)
    except OverflowError:
        return float("inf")


def whole(value: object) -> int | None:
    """Return an integer, NumPy's included, as Python's; None for anything else, truth values among it."""
    try:
        return None if isinstance(value, bool) else operator.index(value)  # type: ignore[arg-type]
    except TypeError:
        return None


def seconds_to_ns(seconds: float) -> int:
    """Return seconds as the nearest integer count of nanoseconds."""
    return round(seconds * NS_PER_S)


def ticks_exactly(duration_s: float, tick_ns: int, name: str) -> int:
    """Return the count of ticks in `duration_s`.

    Raises UserError where the tick does not divide it, with both numbers and the nearest durations that it does.
    """
    ticks = exact(duration_s) * NS_PER_S / tick_ns
    if ticks.denominator == 1 and ticks > 0:
        return int(ticks)
    lower = max(int(ticks), 1)
    near = [f"{float(exact(count) * tick_ns / NS_PER_S):g}" for count in (lower, lower + 1)]
    raise UserError(
        f"{name}: {duration_s:g} s is not a positive multiple of the physics step of {tick_ns / 1e6:g} ms; "
        f"{near[0]} and {near[1]} s are"
    )


def ceil_div(numerator: int, denominator: int) -> int:
    """Return the integer quotient, rounded up."""
    return -(-numerator // denominator)


def plain(value: object) -> object:
    """Return NumPy scalars and arrays as plain Python numbers and lists, for JSON and msgpack."""
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else value


def to_ns(seconds: ArrayLike) -> NDArray[np.int64]:
    """Return times in seconds (...) in whole nanoseconds."""
    return np.rint(np.asarray(seconds, np.float64) * NS_PER_S).astype(np.int64)


def check_quantiles(shares: Sequence[float]) -> None:
    """Raise ValueError unless the shares at which a distribution has its quantiles rise from 0 to 1."""
    if len(shares) < 2 or (shares[0], shares[-1]) != (0.0, 1.0):
        raise ValueError("must begin with 0 and end with 1")
    if any(later <= earlier for earlier, later in pairwise(shares)):
        raise ValueError("must rise")


def check_quantile_row(row: Sequence[float], count: int) -> None:
    """Raise ValueError unless a distribution has `count` quantiles, of 0 or more, that do not fall."""
    if len(row) != count:
        raise ValueError(f"needs {count} values, one for each of the quantiles, not {len(row)}")
    if any(later < earlier for earlier, later in pairwise(row)) or min(row, default=0.0) < 0:
        raise ValueError("quantiles must be 0 or more and must not fall")
