"""A DVS as a device: its parameters, v2e's presets, the variation from pixel to pixel, and the image observed of it."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.floating]

MIN_THRESHOLD = np.float32(0.01)
HOT_RATE_HZ = 10.0  # of a hot pixel; this project's choice
_HOT = 0x407  # in the seed of hot pixels, which is independent of v2e's maps


@dataclass(frozen=True)
class DvsParameters:
    """The sensor's parameters with v2e's meanings; the defaults are v2e's `clean` model.

    Thresholds and their standard deviation are in log_e intensity, rates in events per pixel per second.
    """

    positive_threshold: float = 0.2
    negative_threshold: float = 0.2
    threshold_sigma: float = 0.02
    cutoff_hz: float = 0.0
    leak_rate_hz: float = 0.0
    leak_jitter_fraction: float = 0.0
    leak_rate_spread_decades: float = 0.0
    shot_noise_rate_hz: float = 0.0
    refractory_s: float = 0.0
    hot_share: float = 0.0
    """Share of hot pixels, which emit ON events at HOT_RATE_HZ even in the dark; not part of v2e."""


_LEAK_SPREAD = {"leak_jitter_fraction": 0.1, "leak_rate_spread_decades": 0.1}

PRESETS: Mapping[str, DvsParameters] = MappingProxyType(
    {
        "constructor": DvsParameters(threshold_sigma=0.03, leak_rate_hz=0.1, **_LEAK_SPREAD),
        "command_line": DvsParameters(
            threshold_sigma=0.03,
            cutoff_hz=300.0,
            leak_rate_hz=0.01,
            shot_noise_rate_hz=0.001,
            refractory_s=0.0005,
            **_LEAK_SPREAD,
        ),
        "clean": DvsParameters(),
        "noisy": DvsParameters(
            threshold_sigma=0.05, cutoff_hz=30.0, leak_rate_hz=0.1, shot_noise_rate_hz=5.0, **_LEAK_SPREAD
        ),
    }
)


def with_thresholds(parameters: DvsParameters, ratio: float) -> DvsParameters:
    """Scale the contrast thresholds by `ratio`; their spread from pixel to pixel stays."""
    return replace(
        parameters,
        positive_threshold=ratio * parameters.positive_threshold,
        negative_threshold=ratio * parameters.negative_threshold,
    )


def with_noise(
    parameters: DvsParameters,
    shot_noise_hz: float = 0.0,
    leak_hz: float = 0.0,
    spread_ratio: float = 1.0,
    hot_share: float = 0.0,
) -> DvsParameters:
    """Add noise: rates are added, the thresholds' spread from pixel to pixel is multiplied."""
    return replace(
        parameters,
        shot_noise_rate_hz=parameters.shot_noise_rate_hz + shot_noise_hz,
        leak_rate_hz=parameters.leak_rate_hz + leak_hz,
        threshold_sigma=spread_ratio * parameters.threshold_sigma,
        hot_share=hot_share,
    )


# A camera as compiled functions take it, float64 (CAMERA_FIELDS,): DVS parameters, and its read noise's deviation.
POSITIVE, NEGATIVE, SIGMA, TAU, LEAK, JITTER, SHOT, REFRACTORY, HOT, READ = range(10)
CAMERA_FIELDS = 10


def camera_row(parameters: DvsParameters, read_noise: float = 0.0) -> NDArray[np.float64]:
    """Return a camera's parameters (CAMERA_FIELDS,); TAU is the time constant of the low-pass filter, s, 0 for none."""
    of, tau_s = parameters, 1 / (math.pi * 2 * parameters.cutoff_hz) if parameters.cutoff_hz > 0 else 0.0
    thresholds = of.positive_threshold, of.negative_threshold, of.threshold_sigma
    rates = of.leak_rate_hz, of.leak_jitter_fraction, of.shot_noise_rate_hz
    return np.array([*thresholds, tau_s, *rates, of.refractory_s, of.hot_share, read_noise])


class DvsSensor(NamedTuple):
    """One sensor: its parameters, and the sampled maps (H, W) of its pixels.

    Thresholds are float32, or float64 with a low-pass, for which v2e computes in double precision.
    """

    parameters: DvsParameters
    positive_threshold: Floats
    negative_threshold: Floats
    leak_rate_factor: NDArray[np.float32]
    hot: NDArray[np.bool_] | None = None
    """Mask of hot pixels; None without any."""


class Draws(NamedTuple):
    """Random numbers of each pixel (H, W).

    `up` and `down` are standard normal and spread the thresholds; `leak_factor` is log-normal; `heat` is uniform in
    [0, 1), and pixels whose heat is below the share of hot ones are hot.
    """

    up: NDArray[np.float32]
    down: NDArray[np.float32]
    leak_factor: NDArray[np.float32]
    heat: NDArray[np.float64]


def sample_pixels(parameters: DvsParameters, shape: tuple[int, int], seed: int) -> Draws:
    """Sample the random numbers of a sensor of that seed."""
    rng = np.random.default_rng(seed)
    even = np.zeros(shape, np.float32)  # thresholds without a spread are not drawn
    up, down = (rng.standard_normal(shape, np.float32) if parameters.threshold_sigma else even for _ in "+-")
    spread = np.float32(math.log(10) * parameters.leak_rate_spread_decades)
    factor = np.exp(spread * rng.standard_normal(shape, np.float32))
    return Draws(up, down, factor, np.random.default_rng((seed, _HOT)).random(shape))


def make_sensor(parameters: DvsParameters, shape: tuple[int, int], seed: int) -> DvsSensor:
    """Sample a sensor of `shape` (H, W): thresholds N(nominal, sigma) >= 0.01, log-normal leak rates, hot pixels."""
    draws = sample_pixels(parameters, shape, seed)
    positive = _thresholds(parameters.positive_threshold, parameters.threshold_sigma, draws.up)
    negative = _thresholds(parameters.negative_threshold, parameters.threshold_sigma, draws.down)
    sensor = sensor_from_maps(parameters, positive, negative, draws.leak_factor)
    if parameters.hot_share <= 0:
        return sensor
    return sensor._replace(hot=draws.heat < parameters.hot_share)


def sensor_from_maps(
    parameters: DvsParameters, positive: Floats, negative: Floats, leak_rate_factor: Floats | None = None
) -> DvsSensor:
    """Make a sensor with given maps (H, W), such as another emulator's; without a leak map all factors are 1."""
    precision = np.float64 if parameters.cutoff_hz > 0 else np.float32
    factor = np.ones(positive.shape) if leak_rate_factor is None else leak_rate_factor
    return DvsSensor(
        parameters,
        np.ascontiguousarray(positive, precision),
        np.ascontiguousarray(negative, precision),
        np.ascontiguousarray(factor, np.float32),
    )


def _thresholds(nominal: float, sigma: float, normal: NDArray[np.float32]) -> Floats:
    if sigma == 0:  # a plain number in v2e: rounded only where it meets a float32
        return np.full(normal.shape, nominal)
    spread: Floats = np.maximum(np.float32(nominal) + np.float32(sigma) * normal, MIN_THRESHOLD)
    return spread


BLOCK_SIDE = 4  # pixels; each block is summed into one
NEUTRAL_LEVEL = 128  # grey level for as many ON as OFF events


def dvs_observation(on: NDArray[np.integer], off: NDArray[np.integer]) -> NDArray[np.uint8]:
    """Return 128 plus the sum of ON - OFF over blocks of 4 x 4 pixels, clipped to 0..255.

    Counts (H, W) become (H / 4, W / 4): 144 x 256 gives 36 x 64. The reduction is this project's own choice.
    Raises ValueError if the shapes differ or are not multiples of 4.
    """
    if on.shape != off.shape or on.ndim != 2 or on.shape[0] % BLOCK_SIDE or on.shape[1] % BLOCK_SIDE:
        raise ValueError(f"ON and OFF need one (H, W) shape of multiples of {BLOCK_SIDE}: {on.shape}, {off.shape}")
    from uavaccel.vision.dvs_kernels import block_sums  # compiled, and not needed for the constants

    return block_sums(on, off)
