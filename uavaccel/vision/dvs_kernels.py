"""The compiled arithmetic of the DVS model: functions of one pixel, for CPU and GPU, then of whole pictures.

Every operation keeps the type and the single rounding it has in v2e (SensorsINI/v2e, commit cac6384,
`v2ecore/emulator.py` and `emulator_utils.py`): no fastmath, no fused multiply-add. Logarithms and what is memorised are
float32 or, after a low-pass, float64; thresholds, factors and draws are float32 where v2e has them so. Pictures are (H,
W). A signed count is +n for n ON events of a pixel and -n for n OFF events; no pixel has both in one frame.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import types
from numba.extending import overload
from numpy.typing import NDArray

from uavaccel.sim.parts import njit, part, times
from uavaccel.vision.dvs_sensor import (
    BLOCK_SIDE,
    HOT_RATE_HZ,
    JITTER,
    LEAK,
    NEGATIVE,
    NEUTRAL_LEVEL,
    POSITIVE,
    SHOT,
    TAU,
)

ONE = np.float32(1.0)
ON_AND_OFF = 2  # a pixel's shot noise of both polarities in one frame

Float = float | np.float32  # float64 after a low-pass
Floats = NDArray[np.floating]
Counts = NDArray[np.int32]
Frame = NDArray[np.uint8]


@part(error_model="numpy")
def low_passed(before: float, log: float, weight: float) -> float:
    """Return a first-order low-pass after one step, in double precision."""
    return times(1.0 - weight, before) + times(weight, log)


@part(error_model="numpy")
def heated(base: Float, positive: Float, share: np.float32) -> Float:
    """Return a hot pixel's memorised intensity, lowered by a share of its threshold."""
    return base - times(share, np.float32(positive))


@part(error_model="numpy")
def leaked(
    base: Float, positive: Float, dt_s: np.float32, rate_hz: np.float32, factor: np.float32, jitter: np.float32
) -> Float:
    """Return the memorised intensity after a leak at `rate_hz` times pixel's `factor` times frame's `jitter`."""
    rate = times(times(rate_hz, factor), jitter)
    return base - times(times(dt_s, rate), np.float32(positive))


@part(error_model="numpy")
def jittered(fraction: np.float32, normal: np.float32) -> np.float32:
    """Return a leak's jitter factor for a standard normal number."""
    return ONE - times(fraction, normal)


@part(error_model="numpy")
def count_single_pixel(log: np.float32, base: np.float32, positive: np.float32, negative: np.float32) -> np.int32:
    """Return the signed count, the whole thresholds in log - base, in float32.

    v2e floor-divides through fmod, which gives the exact floor. So does truncating a double-precision
    quotient: that of two float32 is never rounded up to a whole number below 2^28.
    """
    change = log - base
    threshold = positive if change > 0 else negative
    return np.int32(np.float64(change) / np.float64(threshold))


@part(error_model="numpy")
def count_double_pixel(log: float, base: float, positive: float, negative: float) -> np.int32:
    """Return `count_single_pixel` in float64, where the remainder tells if a whole quotient was rounded up."""
    change = log - base
    threshold, size = positive if change > 0 else negative, abs(change)
    quotient = size / threshold
    count = np.int32(quotient)
    if count > 0 and count == quotient and size % threshold > 0.5 * threshold:
        count = np.int32(count - 1)
    return count if change > 0 else np.int32(-count)


@part(error_model="numpy")
def advanced(base: Float, signed: int | np.int32, positive: Float, negative: Float) -> Float:
    """Return the memorised log intensity after the events, moved by whole thresholds so that the remainder stays.

    v2e multiplies int32 by float32, so the move is rounded to float32 even where the base is float64.
    """
    rise = times(np.float32(max(signed, 0)), np.float32(positive))
    fall = times(np.float32(max(-signed, 0)), np.float32(negative))
    return base + rise - fall


@part(error_model="numpy")
def shot_chance(chance: float, nominal: np.float32, threshold: Float) -> float:
    """Return the probability of a noise event of one polarity, which is higher for a more sensitive pixel."""
    return times(chance, np.float64(nominal / np.float32(threshold)))


@part(error_model="numpy")
def shot(draw: np.float32, chance_on: float, chance_off: float) -> np.int32:
    """Return a frame's noise for a random number in [0, 1): 1 for ON, -1 for OFF, 2 for one event of each."""
    on, off = draw > 1.0 - chance_on, draw < chance_off
    if on and off:
        return np.int32(ON_AND_OFF)
    return np.int32(on) - np.int32(off)


@part(error_model="numpy")
def shot_noise(
    level: int, camera: Floats, tables: Any, positive: Float, negative: Float, draw: np.float32, dt_s: float
) -> np.int32:
    """Return a pixel's shot noise in a frame, as `shot` does."""
    chance = camera[SHOT] / 2 * dt_s * tables.dimming[level]
    chance_on = shot_chance(chance, np.float32(camera[POSITIVE]), positive)
    return shot(draw, chance_on, shot_chance(chance, np.float32(camera[NEGATIVE]), negative))


def log_of(like: Float, level: int, before: Any, camera: Floats, tables: Any, dt_s: float) -> Any:
    """Return a pixel's log intensity: float32, or float64 after the low-pass filter, whose last output is `before`."""
    function: Any = single_log if isinstance(like, np.float32) else double_log
    return function(level, before, camera, tables, dt_s)


def signed_count(log: Float, base: Float, positive: Float, negative: Float) -> np.int32:
    """Return a pixel's signed event count in the precision of its log intensity."""
    function = count_single_pixel if isinstance(log, np.float32) else count_double_pixel
    return function(log, base, positive, negative)  # type: ignore[arg-type]


@part
def single_log(level: int, before: np.float32, camera: Floats, tables: Any, dt_s: float) -> np.float32:
    """Return the log intensity without a low-pass filter."""
    log: np.float32 = tables.logs[level]
    return log


@part(error_model="numpy")
def double_log(level: int, before: float, camera: Floats, tables: Any, dt_s: float) -> float:
    """Return the log intensity after the low-pass filter."""
    weight = min(tables.weights[level] * (dt_s / camera[TAU]), 1.0)
    return low_passed(before, np.float64(tables.logs[level]), weight)


def _log_of(like, level, before, camera, tables, dt_s):  # type: ignore[no-untyped-def]
    function = single_log if like == types.float32 else double_log
    return lambda like, level, before, camera, tables, dt_s: function(level, before, camera, tables, dt_s)


def _signed_count(log, base, positive, negative):  # type: ignore[no-untyped-def]
    function = count_single_pixel if log == types.float32 else count_double_pixel
    return lambda log, base, positive, negative: function(log, base, positive, negative)


BY_TYPE = ((log_of, _log_of), (signed_count, _signed_count))
"""Functions whose implementation depends on the precision, with what chooses it by type, for numba's `overload`."""

for _function, _chosen in BY_TYPE:
    overload(_function)(_chosen)


@njit(nogil=True, cache=True, error_model="numpy")
def count(
    frame: Frame,
    memory: tuple[Floats, Floats],
    thresholds: tuple[Floats, Floats],
    hot: NDArray[np.bool_],
    leak_factor: Floats,
    camera: Floats,
    tables: Any,
    normals: Floats,
    dt_s: float,
) -> tuple[Floats, Floats, Counts]:
    """Return log intensities, those memorised after hot pixels' drift and leak, and signed counts.

    `memory` has the memorised intensities and the filter's last output, `tables` the arrays of dvs.Tables. `hot` is
    empty without any, and the standard normal `normals` without a leak.
    """
    (base, filtered), (positive, negative) = memory, thresholds
    log, before, signed = np.empty_like(base), base, np.empty(base.shape, np.int32)
    for y in range(frame.shape[0]):
        for x in range(frame.shape[1]):
            log[y, x] = log_of(base[y, x], frame[y, x], filtered[y, x], camera, tables, dt_s)
    if hot.size > 0 or camera[LEAK] > 0.0:
        before = base.copy()
        for y in range(frame.shape[0]):
            for x in range(frame.shape[1]):
                if hot.size > 0 and hot[y, x]:
                    before[y, x] = heated(before[y, x], positive[y, x], np.float32(dt_s * HOT_RATE_HZ))
                if camera[LEAK] > 0.0:
                    jitter, rate_hz = jittered(np.float32(camera[JITTER]), normals[y, x]), np.float32(camera[LEAK])
                    factor = leak_factor[y, x]
                    before[y, x] = leaked(before[y, x], positive[y, x], np.float32(dt_s), rate_hz, factor, jitter)
    for y in range(frame.shape[0]):
        for x in range(frame.shape[1]):
            signed[y, x] = signed_count(log[y, x], before[y, x], positive[y, x], negative[y, x])
    return log, before, signed


@njit(nogil=True, cache=True, error_model="numpy")
def memorise(
    frame: Frame,
    log: Floats,
    before: Floats,
    signed: Counts,
    thresholds: tuple[Floats, Floats],
    camera: Floats,
    tables: Any,
    draws: Floats,
    dt_s: float,
) -> tuple[Floats, Counts]:
    """Return the memorised log intensities after the events, and the shot noise, as `shot`, empty without any.

    A pixel that fires by noise memorises the present intensity. `draws` are uniform in [0, 1), empty without noise.
    """
    positive, negative = thresholds
    base, noise = np.empty_like(before), np.zeros(draws.shape, np.int32)
    for y in range(signed.shape[0]):
        for x in range(signed.shape[1]):
            base[y, x] = advanced(before[y, x], signed[y, x], positive[y, x], negative[y, x])
    for y in range(draws.shape[0]):
        for x in range(draws.shape[1]):
            up, down = positive[y, x], negative[y, x]
            noise[y, x] = shot_noise(frame[y, x], camera, tables, up, down, draws[y, x], dt_s)
            if noise[y, x] != 0:
                base[y, x] = log[y, x]
    return base, noise


@njit(nogil=True, cache=True, error_model="numpy")
def drop_refractory(
    signed: Counts, stamps_s: Floats, last_event_s: Floats, refractory_s: np.float32
) -> tuple[Counts, Floats]:
    """Drop events within `refractory_s` of a pixel's previous one; returns the signed counts and last event times."""
    kept, last = np.zeros_like(signed), last_event_s.copy()
    for y in range(signed.shape[0]):
        for x in range(signed.shape[1]):
            for stamp in stamps_s[: abs(signed[y, x])]:
                if stamp - last[y, x] > refractory_s:
                    kept[y, x] += np.sign(signed[y, x])
                    last[y, x] = stamp
    return kept, last


@njit(nogil=True, cache=True, error_model="numpy")
def list_events(
    signed: Counts, stamps_s: Floats, last_event_s: Floats, refractory_s: np.float32, events: Floats
) -> None:
    """Fill `events` (n, 4) with rows (t, x, y, p), by stamp, ON before OFF, each in raster order.

    `signed` are the counts before `drop_refractory`; n is the number of events that it keeps.
    """
    last, row = last_event_s.copy(), 0
    for i in range(len(stamps_s)):
        for polarity in (1, -1):
            for y in range(signed.shape[0]):
                for x in range(signed.shape[1]):
                    if signed[y, x] * polarity > i and stamps_s[i] - last[y, x] > refractory_s:
                        events[row, 0], events[row, 1] = stamps_s[i], x
                        events[row, 2], events[row, 3] = y, polarity
                        last[y, x] = stamps_s[i]
                        row += 1


@njit(nogil=True, cache=True)
def block_sums(on: NDArray[np.integer], off: NDArray[np.integer]) -> NDArray[np.uint8]:
    """Return 128 plus ON - OFF summed over blocks of 4 x 4 pixels, clipped to 0..255: (H / 4, W / 4)."""
    image = np.empty((on.shape[0] // BLOCK_SIDE, on.shape[1] // BLOCK_SIDE), np.uint8)
    for row in range(image.shape[0]):
        for column in range(image.shape[1]):
            level = np.int64(NEUTRAL_LEVEL)
            for y in range(row * BLOCK_SIDE, (row + 1) * BLOCK_SIDE):
                for x in range(column * BLOCK_SIDE, (column + 1) * BLOCK_SIDE):
                    level += np.int64(on[y, x]) - np.int64(off[y, x])
            image[row, column] = min(max(level, 0), 255)
    return image
