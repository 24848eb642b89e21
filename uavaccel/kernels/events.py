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
from uavaccel.kernels.fields import Integer, Operand
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


class Rest(NamedTuple):
    """What a frame's refractory periods need: `last_s` of Pixels, and each lane's largest count, `most` (L,) int32.

    `most` is found first: while `counting` is not 0, pixels raise it, which is 1 before, and write nothing else.
    """

    last_s: Operand
    most: Operand
    counting: int


@part
def is_plain(camera: Operand, filtered: int) -> bool:
    """Return whether a camera has no noise, no refractory period and, with `filtered` pixels, no low-pass filter."""
    quiet = camera[LEAK] <= 0.0 and camera[SHOT] <= 0.0 and camera[HOT] <= 0.0
    return quiet and camera[READ] <= 0.0 and camera[REFRACTORY] <= 0.0 and filtered == 0


@part(error_model="numpy")
def seconds(moment_ns: int) -> float:
    """Return a moment in seconds, rounded before anything is subtracted (sim/parts.times)."""
    return times(np.float64(moment_ns), NS)


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


@part(error_model="numpy")
def kept_events(
    signed: int, last_s: np.float32, refractory_s: np.float32, before_s: float, time_s: float, most: int
) -> tuple[Any, np.float32]:
    """Return a pixel's signed count without the events within `refractory_s` of one before, and its last event's time.

    `most` is the largest count of a pixel in the frame, whose events are stamped after `before_s` and up to `time_s`.
    """
    kept = np.int32(0)
    for number in range(abs(signed)):
        stamp_s = stamp(before_s, time_s, most, number)
        if stamp_s - last_s > refractory_s:
            kept, last_s = np.int32(kept + 1), stamp_s
    return kept if signed > 0 else np.int32(-kept), last_s


def raise_to(numbers: Any, place: int, least: int) -> None:
    """Let a number be `least` or more; on a GPU threads take turns (kernels/cuda_views)."""


@overload(raise_to)
def _raise_alone(numbers, place, least):  # type: ignore[no-untyped-def]
    def raised(numbers, place, least):  # type: ignore[no-untyped-def]
        numbers[place] = max(numbers[place], least)

    return raised


def rested(signed: Any, camera: Operand, y: int, x: int, moment: Operand, rest: Operand) -> tuple[Any, bool]:  # type: ignore[empty-body]
    """Return a pixel's signed count without what its refractory period suppresses, and whether it is known yet."""


@part
def _as_is(signed: Any, camera: Operand, y: int, x: int, moment: Operand, rest: Operand) -> tuple[Any, bool]:
    return signed, True


@part(error_model="numpy")
def _after_rest(signed: Any, camera: Operand, y: int, x: int, moment: Operand, rest: Rest) -> tuple[Any, bool]:
    lane, before_s, time_s = moment
    most = rest.most[lane]
    if rest.counting != 0:
        if abs(signed) > most:
            raise_to(rest.most, lane, abs(signed))
        return np.int32(0), False
    refractory_s = camera[REFRACTORY]
    if signed != 0 and refractory_s > (time_s - before_s) / most:
        last_s = rest.last_s[lane, y, x]
        signed, last_s = kept_events(signed, last_s, np.float32(refractory_s), before_s, time_s, most)
        rest.last_s[lane, y, x] = last_s
    return signed, True


def _rested(signed, camera, y, x, moment, rest):  # type: ignore[no-untyped-def]
    function = _after_rest if isinstance(rest, types.BaseNamedTuple) else _as_is
    return lambda signed, camera, y, x, moment, rest: function(signed, camera, y, x, moment, rest)


BY_TYPE = ((threshold, _threshold), (rested, _rested), *pixel.BY_TYPE)
overload(threshold)(_threshold)
overload(rested)(_rested)


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
    moment: tuple[Integer, float, float],
    rest: Operand,
) -> Any:
    """Update a pixel for a new grey level and return its ON minus OFF events.

    Updates `base` (144, 256) and, unless it is empty, `filtered`. `draw` has the pixel's random numbers for this frame:
    for the leak, and for shot noise. `moment` is the lane, and the times of the last frame and of this one. `rest` is a
    Rest, or () where no refractory period can matter.
    """
    dt_s, before = moment[2] - moment[1], base[y, x]
    positive = threshold(before, camera[POSITIVE], camera[SIGMA], sensor.up[y, x])
    negative = threshold(before, camera[NEGATIVE], camera[SIGMA], sensor.down[y, x])
    log = pixel.log_of(before, level, before if filtered.size == 0 else filtered[y, x], camera, sensor, dt_s)
    if camera[HOT] > 0.0 and sensor.heat[y, x] < camera[HOT]:
        before = pixel.heated(before, positive, np.float32(dt_s * HOT_RATE_HZ))
    if camera[LEAK] > 0.0:
        jitter, rate_hz = pixel.jittered(np.float32(camera[JITTER]), draw[0]), np.float32(camera[LEAK])
        before = pixel.leaked(before, positive, np.float32(dt_s), rate_hz, sensor.leak_factor[y, x], jitter)
    signed, known = rested(pixel.signed_count(log, before, positive, negative), camera, y, x, moment, rest)
    if not known:
        return signed
    if filtered.size != 0:
        filtered[y, x] = log
    base[y, x] = pixel.advanced(before, signed, positive, negative)
    if camera[SHOT] > 0.0:  # a pixel that fires memorises the present intensity
        noise = pixel.shot_noise(level, camera, sensor, positive, negative, draw[1], dt_s)
        if noise != 0:
            base[y, x] = log
        return signed + (0 if noise == pixel.ON_AND_OFF else noise)
    return signed


@part
def level_of(events: Integer) -> int:
    """Return an observation's level for a block's ON minus OFF events."""
    return min(max(NEUTRAL_LEVEL + events, 0), 255)
