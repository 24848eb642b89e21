"""The DVS model over pictures: `dvs_pixel` for every pixel, and what needs all of them. Arrays are (H, W)."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from uavaccel.vision import dvs_pixel as pixel

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
            level = frame[y, x]
            result[y, x] = pixel.low_passed(filtered_log[y, x], log_table[level], weight_table[level])
    return result


@njit(nogil=True, cache=True, error_model="numpy")
def heat(base: Floats, positive: Floats, hot: NDArray[np.bool_], share: np.float32) -> Floats:
    """The memorised intensity, fallen by a share of the threshold where a pixel is hot."""
    result = base.copy()
    for y in range(base.shape[0]):
        for x in range(base.shape[1]):
            if hot[y, x]:
                result[y, x] = pixel.heated(base[y, x], positive[y, x], share)
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
    """The memorised intensity after a leak, uneven by `jitter` times a normal draw."""
    result = np.empty_like(base)
    for y in range(base.shape[0]):
        for x in range(base.shape[1]):
            uneven = pixel.jittered(jitter, normal[y, x])
            result[y, x] = pixel.leaked(base[y, x], positive[y, x], dt_s, rate_hz, factor[y, x], uneven)
    return result


@njit(nogil=True, cache=True, error_model="numpy")
def count_single(log: Floats, base: Floats, positive: Floats, negative: Floats) -> Counts:
    """Signed counts, float32."""
    signed = np.empty(log.shape, np.int32)
    for y in range(log.shape[0]):
        for x in range(log.shape[1]):
            signed[y, x] = pixel.count_single(log[y, x], base[y, x], positive[y, x], negative[y, x])
    return signed


@njit(nogil=True, cache=True, error_model="numpy")
def count_double(log: Floats, base: Floats, positive: Floats, negative: Floats) -> Counts:
    """Signed counts, float64."""
    signed = np.empty(log.shape, np.int32)
    for y in range(log.shape[0]):
        for x in range(log.shape[1]):
            signed[y, x] = pixel.count_double(log[y, x], base[y, x], positive[y, x], negative[y, x])
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
    """The memorised log intensity after the events."""
    result = np.empty_like(base)
    for y in range(signed.shape[0]):
        for x in range(signed.shape[1]):
            result[y, x] = pixel.advanced(base[y, x], signed[y, x], positive[y, x], negative[y, x])
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
    """Where shot noise makes ON and OFF events; `chances` by intensity, `draws` of [0, 1)."""
    on, off = np.empty(frame.shape, np.bool_), np.empty(frame.shape, np.bool_)
    for y in range(frame.shape[0]):
        for x in range(frame.shape[1]):
            chance = chances[frame[y, x]]
            chance_on = pixel.shot_chance(chance, nominal[0], positive[y, x])
            noise = pixel.shot(draws[y, x], chance_on, pixel.shot_chance(chance, nominal[1], negative[y, x]))
            on[y, x], off[y, x] = noise > 0, noise < 0 or noise == 2
    return on, off


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
