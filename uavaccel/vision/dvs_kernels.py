"""The compiled arithmetic of the DVS model: functions of one pixel, for CPU and GPU, then of whole pictures.

Every operation keeps the type and the single rounding it has in v2e (SensorsINI/v2e, commit cac6384,
`v2ecore/emulator.py` and `emulator_utils.py`): no fastmath, no fused multiply-add. Logarithms and what is memorised are
float32 or, after a low-pass, float64; thresholds, factors and draws are float32 where v2e has them so. Pictures are (H,
W). A signed count is +n for n ON events of a pixel and -n for n OFF events; no pixel has both in one frame.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from uavaccel.sim.parts import njit, part, times
from uavaccel.vision.dvs_sensor import BLOCK_SIDE, NEUTRAL_LEVEL

ONE = np.float32(1.0)

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
        return np.int32(2)
    return np.int32(on) - np.int32(off)


@njit(nogil=True, cache=True, error_model="numpy")
def look_up(frame: Frame, table: Floats) -> Floats:
    """Look up each intensity in a table (256,)."""
    result = np.empty(frame.shape, table.dtype)
    for y in range(frame.shape[0]):
        for x in range(frame.shape[1]):
            result[y, x] = table[frame[y, x]]
    return result


@njit(nogil=True, cache=True, error_model="numpy")
def low_pass(frame: Frame, filtered_log: Floats, log_table: Floats, weight_table: Floats) -> Floats:
    """Return a first-order low-pass, whose weight depends on the intensity, after one step."""
    result = np.empty_like(filtered_log)
    for y in range(frame.shape[0]):
        for x in range(frame.shape[1]):
            level = frame[y, x]
            result[y, x] = low_passed(filtered_log[y, x], log_table[level], weight_table[level])
    return result


@njit(nogil=True, cache=True, error_model="numpy")
def heat(base: Floats, positive: Floats, hot: NDArray[np.bool_], share: np.float32) -> Floats:
    """Return the memorised intensities, those of hot pixels lowered by a share of their thresholds."""
    result = base.copy()
    for y in range(base.shape[0]):
        for x in range(base.shape[1]):
            if hot[y, x]:
                result[y, x] = heated(base[y, x], positive[y, x], share)
    return result


@njit(nogil=True, cache=True, error_model="numpy")
def leak(
    base: Floats,
    positive: Floats,
    dt_s: np.float32,
    rate_hz: np.float32,
    factor: Floats,
    jitter: np.float32,
    normal: Floats,
) -> Floats:
    """Return the memorised intensities after a leak with jitter, from standard normal numbers."""
    result = np.empty_like(base)
    for y in range(base.shape[0]):
        for x in range(base.shape[1]):
            uneven = jittered(jitter, normal[y, x])
            result[y, x] = leaked(base[y, x], positive[y, x], dt_s, rate_hz, factor[y, x], uneven)
    return result


@njit(nogil=True, cache=True, error_model="numpy")
def count_single(log: Floats, base: Floats, positive: Floats, negative: Floats) -> Counts:
    """Return the signed counts, computed in float32."""
    signed = np.empty(log.shape, np.int32)
    for y in range(log.shape[0]):
        for x in range(log.shape[1]):
            signed[y, x] = count_single_pixel(log[y, x], base[y, x], positive[y, x], negative[y, x])
    return signed


@njit(nogil=True, cache=True, error_model="numpy")
def count_double(log: Floats, base: Floats, positive: Floats, negative: Floats) -> Counts:
    """Return the signed counts, computed in float64."""
    signed = np.empty(log.shape, np.int32)
    for y in range(log.shape[0]):
        for x in range(log.shape[1]):
            signed[y, x] = count_double_pixel(log[y, x], base[y, x], positive[y, x], negative[y, x])
    return signed


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
def advance_base(signed: Counts, base: Floats, positive: Floats, negative: Floats) -> Floats:
    """Return the memorised log intensities after the events."""
    result = np.empty_like(base)
    for y in range(signed.shape[0]):
        for x in range(signed.shape[1]):
            result[y, x] = advanced(base[y, x], signed[y, x], positive[y, x], negative[y, x])
    return result


@njit(nogil=True, cache=True, error_model="numpy")
def shoot(
    frame: Frame,
    chances: Floats,
    draws: Floats,
    positive: Floats,
    negative: Floats,
    nominal: tuple[np.float32, np.float32],
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return masks of ON and OFF shot noise; `chances` (256,) are by intensity, `draws` in [0, 1)."""
    on, off = np.empty(frame.shape, np.bool_), np.empty(frame.shape, np.bool_)
    for y in range(frame.shape[0]):
        for x in range(frame.shape[1]):
            chance = chances[frame[y, x]]
            chance_on = shot_chance(chance, nominal[0], positive[y, x])
            noise = shot(draws[y, x], chance_on, shot_chance(chance, nominal[1], negative[y, x]))
            on[y, x], off[y, x] = noise > 0, noise < 0 or noise == 2
    return on, off


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
