"""What many event cameras see: the pixels of vision/dvs_kernels over lanes.

A lane's camera differs from the next one's in its parameters alone; what is drawn once per pixel is the sensor's, and
one for all lanes. Events are summed over blocks of 4 x 4 pixels (vision/observation) until they are taken.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import types
from numba.extending import overload
from numpy.typing import NDArray

from uavaccel.kernels.fields import COLUMNS as WIDTH
from uavaccel.kernels.fields import ROWS as HEIGHT
from uavaccel.kernels.operands import Operand
from uavaccel.parts import part
from uavaccel.vision import dvs_kernels as pixel
from uavaccel.vision.dvs import HOT_RATE_HZ, LIN_LOG, RELATIVE_INTENSITY, SHOT_NOISE_AT_WHITE, DvsParameters
from uavaccel.vision.dvs_sensor import MIN_THRESHOLD, Draws
from uavaccel.vision.noise import LEAK_JITTER, SHOT_NOISE, normal_block, uniform_block
from uavaccel.vision.observation import BLOCK_SIDE, NEUTRAL_LEVEL
from uavaccel.vision.rounding import times

# A lane's camera, float64 (CAMERA_FIELDS,): its parameters, and the deviation of its pictures' own noise.
POSITIVE, NEGATIVE, SIGMA, TAU, LEAK, JITTER, SHOT, REFRACTORY, HOT, READ = range(10)
CAMERA_FIELDS = 10

NS = 1e-9

ON_AND_OFF = 2

Four = tuple[Any, Any, Any, Any]


class Pixels(NamedTuple):
    """What the event cameras of L lanes know, (L, 144, 256): float32, or float64 after a low-pass.

    `filtered` is empty without a low-pass, `last_s` without a refractory period. `gathered` (L, 36, 64) int32 are ON
    minus OFF events since they were last taken; `clock` (L,) int64 counts frames, `time_s` (L,) is of the last one.
    """

    base: Operand
    filtered: Operand
    last_s: Operand
    gathered: Operand
    clock: Operand
    time_s: Operand


class Sensor(NamedTuple):
    """What all lanes have in common: draws once per pixel (144, 256), and tables by intensity (256,)."""

    up: Operand
    down: Operand
    leak_factor: Operand
    heat: Operand
    logs: Operand
    weights: Operand
    dimming: Operand


def sensor_of(draws: Draws) -> Sensor:
    """The sensor of these draws."""
    dimming = (SHOT_NOISE_AT_WHITE - 1) * RELATIVE_INTENSITY + 1
    return Sensor(draws.up, draws.down, draws.leak_factor, draws.heat, LIN_LOG, RELATIVE_INTENSITY, dimming)


def pixels_of(lanes: int, parameters: DvsParameters) -> Pixels:
    """What so many lanes' cameras of one kind know, before they have seen anything."""
    wide = parameters.cutoff_hz > 0
    shape, none = (lanes, HEIGHT, WIDTH), (0, HEIGHT, WIDTH)
    kind = np.float64 if wide else np.float32
    return Pixels(
        np.zeros(shape, kind),
        np.zeros(shape if wide else none, kind),
        np.zeros(shape if parameters.refractory_s > 0 else none, np.float32),
        np.zeros((lanes, HEIGHT // BLOCK_SIDE, WIDTH // BLOCK_SIDE), np.int32),
        np.zeros(lanes, np.int64),
        np.zeros(lanes),
    )


def camera_row(parameters: DvsParameters, read_noise: float) -> NDArray[np.float64]:
    """A lane's camera (CAMERA_FIELDS,)."""
    tau_s = 1 / (np.pi * 2 * parameters.cutoff_hz) if parameters.cutoff_hz > 0 else 0.0
    return np.array(
        [
            parameters.positive_threshold,
            parameters.negative_threshold,
            parameters.threshold_sigma,
            tau_s,
            parameters.leak_rate_hz,
            parameters.leak_jitter_fraction,
            parameters.shot_noise_rate_hz,
            parameters.refractory_s,
            parameters.hot_share,
            read_noise,
        ]
    )


@part
def noisy(level: int, deviation: np.float32, normal: np.float32) -> int:
    """A grey level with noise, rounded and clipped to 0..255."""
    value = np.float32(level) + times(deviation, normal)
    return min(max(round(value), 0), 255)


@part
def single_threshold(nominal: float, sigma: float, normal: np.float32) -> np.float32:
    """A pixel's threshold, float32."""
    if sigma == 0.0:
        return np.float32(nominal)
    return max(np.float32(nominal) + times(np.float32(sigma), normal), MIN_THRESHOLD)


@part
def double_threshold(nominal: float, sigma: float, normal: np.float32) -> float:
    """A pixel's threshold after a low-pass: a plain number stays as precise as it is."""
    return nominal if sigma == 0.0 else np.float64(single_threshold(nominal, sigma, normal))


@part
def leaked(
    base: Operand,
    positive: Operand,
    camera: Operand,
    sensor: Operand,
    y: int,
    x: int,
    dt_s: float,
    normal: np.float32,
) -> Any:
    """The memorised intensity of a pixel after its heat and its leak over a frame."""
    if camera[HOT] > 0.0 and sensor.heat[y, x] < camera[HOT]:
        base = pixel.heated(base, positive, np.float32(dt_s * HOT_RATE_HZ))
    if camera[LEAK] > 0.0:
        jitter = pixel.jittered(np.float32(camera[JITTER]), normal)
        rate_hz, factor = np.float32(camera[LEAK]), sensor.leak_factor[y, x]
        base = pixel.leaked(base, positive, np.float32(dt_s), rate_hz, factor, jitter)
    return base


@part
def shot(
    camera: Operand,
    sensor: Operand,
    level: int,
    dt_s: float,
    positive: Operand,
    negative: Operand,
    draw: np.float32,
) -> int:
    """Noise events of a pixel in a frame, as `pixel.shot`."""
    chance = camera[SHOT] / 2 * dt_s * sensor.dimming[level]
    chance_on = pixel.shot_chance(chance, np.float32(camera[POSITIVE]), positive)
    return pixel.shot(draw, chance_on, pixel.shot_chance(chance, np.float32(camera[NEGATIVE]), negative))


@part
def drawn(camera: Operand, seed: int, index: int, block: int) -> tuple[Four, Four]:
    """A block's draws for a frame: for the leak, and for shot noise; zeros where there is none."""
    normals = draws = (np.float32(0.0), np.float32(0.0), np.float32(0.0), np.float32(0.0))
    if camera[LEAK] > 0.0:
        normals = normal_block(np.uint64(seed), np.uint64(index), LEAK_JITTER, block)
    if camera[SHOT] > 0.0:
        draws = uniform_block(np.uint64(seed), np.uint64(index), SHOT_NOISE, block)
    return normals, draws


def threshold(like: Operand, nominal: float, sigma: float, normal: np.float32) -> Any:
    """A pixel's threshold in the precision of `like`."""
    of_type = single_threshold if isinstance(like, np.float32) else double_threshold
    return of_type(nominal, sigma, normal)


def due(log: Operand, base: Operand, positive: Operand, negative: Operand) -> np.int32:
    """A pixel's signed count in the precision of its logarithms."""
    of_type = pixel.count_single_pixel if isinstance(log, np.float32) else pixel.count_double_pixel
    return of_type(log, base, positive, negative)


def log_of(like: Operand, level: int, before: Operand, camera: Operand, sensor: Operand, dt_s: float) -> Any:
    """A pixel's logarithm: float32, or float64 after a low-pass, of which `before` is the last one."""
    of_type = single_log if isinstance(like, np.float32) else double_log
    return of_type(level, before, camera, sensor, dt_s)


@part
def single_log(level: int, before: np.float32, camera: Operand, sensor: Operand, dt_s: float) -> np.float32:
    """Without a low-pass."""
    return sensor.logs[level]


@part(error_model="numpy")
def double_log(level: int, before: float, camera: Operand, sensor: Operand, dt_s: float) -> float:
    """After a low-pass."""
    weight = min(sensor.weights[level] * (dt_s / camera[TAU]), 1.0)
    return pixel.low_passed(before, np.float64(sensor.logs[level]), weight)


def _threshold(like, nominal, sigma, normal):  # type: ignore[no-untyped-def]
    of_type = single_threshold if like == types.float32 else double_threshold
    return lambda like, nominal, sigma, normal: of_type(nominal, sigma, normal)


def _due(log, base, positive, negative):  # type: ignore[no-untyped-def]
    of_type = pixel.count_single_pixel if log == types.float32 else pixel.count_double_pixel
    return lambda log, base, positive, negative: of_type(log, base, positive, negative)


def _log_of(like, level, before, camera, sensor, dt_s):  # type: ignore[no-untyped-def]
    of_type = single_log if like == types.float32 else double_log
    return lambda like, level, before, camera, sensor, dt_s: of_type(level, before, camera, sensor, dt_s)


BY_TYPE = ((threshold, _threshold), (due, _due), (log_of, _log_of))
"""Functions whose machine code follows the precision, and what chooses it: for numba's `overload` of each target."""

for _function, _chosen in BY_TYPE:
    overload(_function)(_chosen)


@part(error_model="numpy")
def see_pixel(
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
    """A pixel sees a grey level: ON minus OFF events.

    `base` (144, 256), and after a low-pass `filtered`, else empty, go on. `draw` are the pixel's numbers of this frame,
    for the leak and for shot noise.
    """
    positive = threshold(base[y, x], camera[POSITIVE], camera[SIGMA], sensor.up[y, x])
    negative = threshold(base[y, x], camera[NEGATIVE], camera[SIGMA], sensor.down[y, x])
    log = new_log(level, base, filtered, y, x, camera, sensor, dt_s)
    before = leaked(base[y, x], positive, camera, sensor, y, x, dt_s, draw[0])
    signed = due(log, before, positive, negative)
    base[y, x] = pixel.advanced(before, signed, positive, negative)
    if camera[SHOT] > 0.0:
        return signed + add_shot(level, camera, sensor, base, log, y, x, dt_s, positive, negative, draw[1])
    return signed


@part
def new_log(
    level: int,
    base: Operand,
    filtered: Operand,
    y: int,
    x: int,
    camera: Operand,
    sensor: Operand,
    dt_s: float,
) -> Any:
    """A pixel's logarithm, kept for the next low-pass."""
    if filtered.size == 0:
        return log_of(base[y, x], level, base[y, x], camera, sensor, dt_s)
    log = log_of(base[y, x], level, filtered[y, x], camera, sensor, dt_s)
    filtered[y, x] = log
    return log


@part
def add_shot(
    level: int,
    camera: Operand,
    sensor: Operand,
    base: Operand,
    log: Operand,
    y: int,
    x: int,
    dt_s: float,
    positive: Operand,
    negative: Operand,
    draw: np.float32,
) -> Any:
    """Shot noise of a pixel, which then memorises the present intensity: ON minus OFF events."""
    noise = shot(camera, sensor, level, dt_s, positive, negative, draw)
    if noise != 0:
        base[y, x] = log
    return 0 if noise == ON_AND_OFF else noise


@part
def stamp(before_s: float, time_s: float, count: int, number: int) -> np.float32:
    """One of vision/dvs.time_stamps."""
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
    """What an observation shows for so many ON minus OFF events of a block."""
    return min(max(NEUTRAL_LEVEL + events, 0), 255)
