"""One pixel of the DVS model: the arithmetic of v2e, compiled for a CPU's loops or a GPU's threads alike.

Every operation keeps the type and the single rounding it has in v2e (SensorsINI/v2e, commit cac6384,
`v2ecore/emulator.py` and `emulator_utils.py`): no fastmath, no fused multiply-add. Logarithms and what is memorised are
float32 or, after a low-pass, float64; thresholds, factors and draws are float32 where v2e has them so.
A signed count is +n for n ON events of a pixel and -n for n OFF events; no pixel has both in one frame.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from uavaccel.vision.rounding import times

ONE = np.float32(1.0)

Float = Any  # float32, or float64 after a low-pass


@njit(cache=True, error_model="numpy")
def low_passed(before: float, log: float, weight: float) -> float:
    """One step of a first-order low-pass, in double precision."""
    return times(1.0 - weight, before) + times(weight, log)


@njit(cache=True, error_model="numpy")
def heated(base: Float, positive: Float, share: np.float32) -> Float:
    """A hot pixel's memorised intensity, fallen by a share of its threshold."""
    return base - times(share, np.float32(positive))


@njit(cache=True, error_model="numpy")
def leaked(
    base: Float,
    positive: Float,
    dt_s: np.float32,
    rate_hz: np.float32,
    factor: np.float32,
    jitter: np.float32,
) -> Float:
    """The memorised intensity after a leak of `rate_hz`, times a pixel's own factor, times this frame's `jitter`."""
    rate = times(times(rate_hz, factor), jitter)
    return base - times(times(dt_s, rate), np.float32(positive))


@njit(cache=True, error_model="numpy")
def jittered(fraction: np.float32, normal: np.float32) -> np.float32:
    """What a leak is multiplied by, for a draw of the standard normal distribution."""
    return ONE - times(fraction, normal)


@njit(cache=True, error_model="numpy")
def count_single(log: np.float32, base: np.float32, positive: np.float32, negative: np.float32) -> np.int32:
    """Signed count: whole thresholds in log - base, float32.

    v2e floor-divides through fmod, which gives the exact floor. So does truncating a double-precision
    quotient: that of two float32 is never rounded up to a whole number below 2^28.
    """
    change = log - base
    threshold = positive if change > 0 else negative
    return np.int32(np.float64(change) / np.float64(threshold))


@njit(cache=True, error_model="numpy")
def count_double(log: float, base: float, positive: float, negative: float) -> np.int32:
    """As `count_single`, in float64, where a whole quotient may have been rounded up: the remainder decides."""
    change = log - base
    threshold, size = positive if change > 0 else negative, abs(change)
    quotient = size / threshold
    count = np.int32(quotient)
    if count > 0 and count == quotient and size % threshold > 0.5 * threshold:
        count = np.int32(count - 1)
    return count if change > 0 else np.int32(-count)


@njit(cache=True, error_model="numpy")
def advanced(base: Float, signed: np.int32, positive: Float, negative: Float) -> Float:
    """The memorised log intensity after the events: moved by whole thresholds, so the remainder is kept.

    v2e multiplies int32 by float32, so the move is rounded to float32 even where the base is float64.
    """
    rise = times(np.float32(max(signed, 0)), np.float32(positive))
    fall = times(np.float32(max(-signed, 0)), np.float32(negative))
    return base + rise - fall


@njit(cache=True, error_model="numpy")
def shot_chance(chance: float, nominal: np.float32, threshold: Float) -> float:
    """Probability of a noise event of one polarity: the more sensitive the pixel, the higher."""
    return times(chance, np.float64(nominal / np.float32(threshold)))


@njit(cache=True, error_model="numpy")
def shot(draw: np.float32, chance_on: float, chance_off: float) -> np.int32:
    """Noise of a frame, for a draw of [0, 1): 1 for an ON event, -1 for an OFF event, 2 for one of each."""
    on, off = draw > 1.0 - chance_on, draw < chance_off
    if on and off:
        return np.int32(2)
    return np.int32(on) - np.int32(off)
