"""The per-pixel arithmetic of the DVS model, compiled.

Every operation keeps the type and the single rounding it has in v2e (SensorsINI/v2e, commit cac6384,
`v2ecore/emulator.py` and `emulator_utils.py`): no fastmath, no fused multiply-add. Arrays are (H, W).
A signed count is +n for n ON events of a pixel and -n for n OFF events; no pixel has both in one frame.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.floating]
Counts = NDArray[np.int32]
Frame = NDArray[np.uint8]


@njit(nogil=True, cache=True, error_model="numpy")
def look_up(frame: Frame, table: Floats) -> Floats:
    """The entry of a 256-element table for each intensity."""
    result = np.empty(frame.shape, table.dtype)
    for y in range(frame.shape[0]):
        for x in range(frame.shape[1]):
            result[y, x] = table[frame[y, x]]
    return result


@njit(nogil=True, cache=True, error_model="numpy")
def low_pass(frame: Frame, filtered_log: Floats, log_table: Floats, weight_table: Floats) -> Floats:
    """One step of a first-order low-pass whose weight depends on the intensity."""
    result = np.empty_like(filtered_log)
    for y in range(frame.shape[0]):
        for x in range(frame.shape[1]):
            weight = weight_table[frame[y, x]]
            result[y, x] = (1.0 - weight) * filtered_log[y, x] + weight * log_table[frame[y, x]]
    return result


@njit(nogil=True, cache=True, error_model="numpy")
def count_single(log: Floats, base: Floats, positive: Floats, negative: Floats) -> Counts:
    """Signed counts: whole thresholds in log - base, float32.

    v2e floor-divides through fmod, which gives the exact floor. So does truncating a double-precision
    quotient: that of two float32 is never rounded up to a whole number below 2^28.
    """
    signed = np.empty(log.shape, np.int32)
    for y in range(log.shape[0]):
        for x in range(log.shape[1]):
            change, up, down = log[y, x] - base[y, x], positive[y, x], negative[y, x]
            threshold = up if change > 0 else down
            signed[y, x] = np.int32(np.float64(change) / np.float64(threshold))
    return signed


@njit(nogil=True, cache=True, error_model="numpy")
def count_double(log: Floats, base: Floats, positive: Floats, negative: Floats) -> Counts:
    """As `count_single`, in float64, where a whole quotient may have been rounded up: the remainder decides."""
    signed = np.empty(log.shape, np.int32)
    for y in range(log.shape[0]):
        for x in range(log.shape[1]):
            change, up, down = log[y, x] - base[y, x], positive[y, x], negative[y, x]
            threshold, size = up if change > 0 else down, abs(change)
            quotient = size / threshold
            count = np.int32(quotient)
            if count > 0 and count == quotient and size % threshold > 0.5 * threshold:
                count -= 1
            signed[y, x] = count if change > 0 else -count
    return signed


@njit(nogil=True, cache=True, error_model="numpy")
def drop_refractory(
    signed: Counts, stamps_s: Floats, last_event_s: Floats, refractory_s: np.float32
) -> tuple[Counts, Floats]:
    """Signed counts without events within `refractory_s` of the pixel's previous one, and the new last times."""
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
    """The memorised log intensity after the events: moved by whole thresholds, so the remainder is kept.

    v2e multiplies int32 by float32, so the move is rounded to float32 even where the base is float64.
    """
    result = np.empty_like(base)
    for y in range(signed.shape[0]):
        for x in range(signed.shape[1]):
            rise = np.float32(max(signed[y, x], 0)) * np.float32(positive[y, x])
            fall = np.float32(max(-signed[y, x], 0)) * np.float32(negative[y, x])
            result[y, x] = base[y, x] + rise - fall
    return result


@njit(nogil=True, cache=True, error_model="numpy")
def split_polarities(signed: Counts) -> tuple[Counts, Counts]:
    """ON and OFF counts of signed counts."""
    on, off = np.empty_like(signed), np.empty_like(signed)
    for y in range(signed.shape[0]):
        for x in range(signed.shape[1]):
            on[y, x] = max(signed[y, x], 0)
            off[y, x] = max(-signed[y, x], 0)
    return on, off


@njit(nogil=True, cache=True, error_model="numpy")
def list_events(
    signed: Counts, stamps_s: Floats, last_event_s: Floats, refractory_s: np.float32, events: Floats
) -> None:
    """Fill `events` (n, 4) with rows (t, x, y, p): stamp by stamp, ON before OFF, each in raster order.

    `signed` are the counts before `drop_refractory`, and n the number of events that it keeps.
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
