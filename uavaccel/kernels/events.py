"""The event cameras of many lanes, pixel by pixel, on the functions of vision/dvs_kernels.

The cameras of different lanes differ only in their parameters: the per-pixel random numbers of the sensor are shared.
Events are summed over blocks of 4 x 4 pixels (vision/dvs_sensor) until an observation takes them.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import types
from numba.extending import overload

from uavaccel.kernels.fields import COLUMNS as WIDTH
from uavaccel.kernels.fields import ROWS as HEIGHT
from uavaccel.kernels.fields import Operand
from uavaccel.sim.parts import part, times
from uavaccel.vision import dvs_kernels as pixel
from uavaccel.vision.dvs import TABLES
from uavaccel.vision.dvs_sensor import (
    BLOCK_SIDE,
    HOT,
    HOT_RATE_HZ,
    JITTER,
    LEAK,
    MIN_THRESHOLD,
    NEGATIVE,
    NEUTRAL_LEVEL,
    POSITIVE,
    SHOT,
    SIGMA,
    Draws,
    DvsParameters,
)
from uavaccel.vision.dvs_sensor import CAMERA_FIELDS as CAMERA_FIELDS
from uavaccel.vision.dvs_sensor import READ as READ
from uavaccel.vision.dvs_sensor import REFRACTORY as REFRACTORY
from uavaccel.vision.dvs_sensor import TAU as TAU
from uavaccel.vision.dvs_sensor import camera_row as camera_row
from uavaccel.vision.noise import LEAK_JITTER, SHOT_NOISE, normal_block, uniform_block

NS = 1e-9

Four = tuple[Any, Any, Any, Any]


class Pixels(NamedTuple):
    """The state of L event cameras, arrays (L, rows, columns): float32, or float64 with a low-pass filter.

    `base` is the memorised log intensity. `filtered`, the filter's output, is empty without a low-pass filter, and
    `last_s`, the time of a pixel's last event, without a refractory period. `gathered` int32, of the size of a frame,
    counts ON minus OFF events since it was last read; `clock` (L,) int64 counts frames, `time_s` (L,) is the last one's
    time.
    """

    base: Operand
    filtered: Operand
    last_s: Operand
    gathered: Operand
    clock: Operand
    time_s: Operand


class Sensor(NamedTuple):
    """What all lanes share: random numbers of each pixel (rows, columns), and tables by grey level (256,)."""

    up: Operand
    down: Operand
    leak_factor: Operand
    heat: Operand
    logs: Operand
    weights: Operand
    dimming: Operand


def sensor_of(draws: Draws) -> Sensor:
    """Return the sensor with these random numbers."""
    return Sensor(draws.up, draws.down, draws.leak_factor, draws.heat, *TABLES)


def pixels_of(
    lanes: int,
    parameters: DvsParameters,
    size: tuple[int, int] = (HEIGHT, WIDTH),
    frame: tuple[int, int] = (HEIGHT // BLOCK_SIDE, WIDTH // BLOCK_SIDE),
) -> Pixels:
    """Allocate the state of the event cameras of `lanes` lanes; rows and columns of their images and of frames."""
    wide = parameters.cutoff_hz > 0
    shape, none = (lanes, *size), (0, *size)
    kind = np.float64 if wide else np.float32
    return Pixels(
        np.zeros(shape, kind),
        np.zeros(shape if wide else none, kind),
        np.zeros(shape if parameters.refractory_s > 0 else none, np.float32),
        np.zeros((lanes, *frame), np.int32),
        np.zeros(lanes, np.int64),
        np.zeros(lanes),
    )


@part
def is_plain(camera: Operand, filtered: int) -> bool:
    """Return whether a camera has neither noise nor, with `filtered` pixels, a low-pass filter."""
    quiet = camera[LEAK] <= 0.0 and camera[SHOT] <= 0.0 and camera[HOT] <= 0.0
    return quiet and camera[READ] <= 0.0 and filtered == 0


@part
def noisy(level: int, deviation: np.float32, normal: np.float32) -> int:
    """Return a grey level with noise, rounded and clipped to 0..255."""
    value = np.float32(level) + times(deviation, normal)
    return min(max(round(value), 0), 255)


@part
def single_threshold(nominal: float, sigma: float, normal: np.float32) -> np.float32:
    """Return a pixel's threshold in single precision."""
    if sigma == 0.0:
        return np.float32(nominal)
    return max(np.float32(nominal) + times(np.float32(sigma), normal), MIN_THRESHOLD)


@part
def double_threshold(nominal: float, sigma: float, normal: np.float32) -> float:
    """Return a pixel's threshold for a low-pass filter: without a sigma the nominal one, in double precision."""
    return nominal if sigma == 0.0 else np.float64(single_threshold(nominal, sigma, normal))


@part
def block_draws(camera: Operand, seed: int, index: int, block: int) -> tuple[Four, Four]:
    """Return random numbers of four pixels for a frame: normal for the leak, uniform for shot noise; 0 without them."""
    normals = draws = (np.float32(0.0), np.float32(0.0), np.float32(0.0), np.float32(0.0))
    if camera[LEAK] > 0.0:
        normals = normal_block(np.uint64(seed), np.uint64(index), LEAK_JITTER, block)
    if camera[SHOT] > 0.0:
        draws = uniform_block(np.uint64(seed), np.uint64(index), SHOT_NOISE, block)
    return normals, draws


def threshold(like: Operand, nominal: float, sigma: float, normal: np.float32) -> Any:
    """Return a pixel's threshold in the precision of `like`."""
    function = single_threshold if isinstance(like, np.float32) else double_threshold
    return function(nominal, sigma, normal)


def _threshold(like, nominal, sigma, normal):  # type: ignore[no-untyped-def]
    function = single_threshold if like == types.float32 else double_threshold
    return lambda like, nominal, sigma, normal: function(nominal, sigma, normal)


overload(threshold)(_threshold)
BY_TYPE = ((threshold, _threshold), *pixel.BY_TYPE)


@part(error_model="numpy")
def update_pixel(
    level: int,
    camera: Operand,
    sensor: Operand,
    base: Operand,
    filtered: Operand,
    draw: tuple[np.float32, np.float32],
    y: int,
    x: int,
    dt_s: float,
) -> Any:
    """Update a pixel for a new grey level and return its ON minus OFF events.

    Updates `base` (144, 256) and, unless it is empty, `filtered`. `draw` has the pixel's random numbers for this frame:
    for the leak, and for shot noise.
    """
    before = base[y, x]
    positive = threshold(before, camera[POSITIVE], camera[SIGMA], sensor.up[y, x])
    negative = threshold(before, camera[NEGATIVE], camera[SIGMA], sensor.down[y, x])
    log = pixel.log_of(before, level, before if filtered.size == 0 else filtered[y, x], camera, sensor, dt_s)
    if filtered.size != 0:
        filtered[y, x] = log
    if camera[HOT] > 0.0 and sensor.heat[y, x] < camera[HOT]:
        before = pixel.heated(before, positive, np.float32(dt_s * HOT_RATE_HZ))
    if camera[LEAK] > 0.0:
        jitter, rate_hz = pixel.jittered(np.float32(camera[JITTER]), draw[0]), np.float32(camera[LEAK])
        before = pixel.leaked(before, positive, np.float32(dt_s), rate_hz, sensor.leak_factor[y, x], jitter)
    signed = pixel.signed_count(log, before, positive, negative)
    base[y, x] = pixel.advanced(before, signed, positive, negative)
    if camera[SHOT] > 0.0:  # a pixel that fires memorises the present intensity
        noise = pixel.shot_noise(level, camera, sensor, positive, negative, draw[1], dt_s)
        if noise != 0:
            base[y, x] = log
        return signed + (0 if noise == pixel.ON_AND_OFF else noise)
    return signed


@part
def stamp(before_s: float, time_s: float, count: int, number: int) -> np.float32:
    """Return the number-th of `count` time stamps (vision/dvs.time_stamps)."""
    start = np.float32(before_s + (time_s - before_s) / count)
    if count == 1:
        return start
    end = np.float32(time_s)
    spacing = np.float64((end - start) / np.float32(count - 1))
    if number < count // 2:
        return np.float32(np.float64(start) + times(spacing, np.float64(number)))
    return np.float32(np.float64(end) - times(spacing, np.float64(count - 1 - number)))


@part
def level_of(events: int) -> int:
    """Return an observation's level for a block's ON minus OFF events."""
    return min(max(NEUTRAL_LEVEL + events, 0), 255)
