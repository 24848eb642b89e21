"""MODELS of a game engine's effects on images: corruption under time pressure, and auto-exposure; both off by default.

The kinds of corruption are those that the paper observed in Unreal's pipeline (section III-A); magnitudes are this
project's own choice, and MuJoCo corrupts no images. Every figure that depends on these models has to say so.
"""

from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from uavaccel.config import Config, Share
from uavaccel.forms import Positive
from uavaccel.units import NS_PER_S
from uavaccel.vision.guard import mean_brightness

Image = NDArray[np.uint8]

NOISY_PIXELS = 0.05  # share of the pixels hit by salt and pepper
DARKER, BRIGHTER = (0.4, 0.8), (1.25, 2.0)  # ranges of the brightness gain
UP_STOPS_PER_S, DOWN_STOPS_PER_S = 3.0, 1.0
LARGEST_STOPS = 2.0  # of exposure, either way
CHANNEL_ORDERS = ((0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0))


class PerturbationKind(StrEnum):
    """The ways in which an image is corrupted."""

    SALT_AND_PEPPER = "salt_and_pepper"
    BRIGHTNESS = "brightness"
    COLOURS = "colours"
    EMPTY = "empty"


@dataclass(frozen=True)
class PerturbationSettings:
    """The share of images that is perturbed, the kinds, which are equally frequent, and the seed."""

    share: float = 0.0
    kinds: tuple[PerturbationKind, ...] = tuple(PerturbationKind)
    seed: int = 0

    def __post_init__(self) -> None:
        if not 0 <= self.share <= 1:
            raise ValueError(f"the share of perturbed images must lie in 0..1, not {self.share}")
        if self.share > 0 and not self.kinds:
            raise ValueError("a share of perturbed images needs at least one kind")


def share_at(clock_speed: float, share: float, half_excess: float | None) -> float:
    """Return the share of corrupted images at a ClockSpeed: 0 at 1x or below, `share` in the limit.

    A frame at ClockSpeed k has 1/k of the wall time for the same simulated time; half of `share` is reached at
    k - 1 = `half_excess`. Without `half_excess` it is `share` at every ClockSpeed.
    """
    if half_excess is None:
        return share
    excess = max(clock_speed - 1.0, 0.0)
    return share * excess / (excess + half_excess)


class PerturbationConfig(Config):
    """A MODEL of images that are corrupted on their way (uavaccel.vision.perturb); share 0 switches it off."""

    share: Share = 0.0
    """Share of the received images that are perturbed, those requested again included."""
    half_excess: Positive | None = None
    """ClockSpeed above 1 at which half of the share is reached, as a renderer has less time; without it all have it."""
    kinds: Annotated[tuple[PerturbationKind, ...], Field(min_length=1)] = tuple(PerturbationKind)
    """How images go wrong; each perturbed image draws one of them."""

    def at(self, clock_speed: float, seed: int) -> PerturbationSettings:
        """Return what it is at a ClockSpeed."""
        return PerturbationSettings(share_at(clock_speed, self.share, self.half_excess), self.kinds, seed)


def perturb_share(image: Image, settings: PerturbationSettings, index: int) -> tuple[Image, PerturbationKind | None]:
    """Perturb the `index`-th image of a stream, or not; returns it and the kind or None. A pure function."""
    if settings.share <= 0:
        return image, None
    rng = np.random.default_rng(np.random.SeedSequence(settings.seed, spawn_key=(index,)))
    if rng.random() >= settings.share:
        return image, None
    kind = settings.kinds[rng.integers(len(settings.kinds))]
    return perturb(image, kind, rng), kind


def perturb(image: Image, kind: PerturbationKind, rng: np.random.Generator) -> Image:
    """Return a perturbed copy of a uint8 image (H, W, 3)."""
    if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3:
        raise ValueError(f"an image must be uint8 (H, W, 3), not {image.dtype} of {image.shape}")
    if kind is PerturbationKind.EMPTY:
        return np.zeros_like(image)
    if kind is PerturbationKind.COLOURS:
        return np.ascontiguousarray(image[:, :, CHANNEL_ORDERS[rng.integers(len(CHANNEL_ORDERS))]])
    if kind is PerturbationKind.BRIGHTNESS:
        gain = rng.uniform(*(DARKER if rng.random() < 0.5 else BRIGHTER))
        return np.clip(np.round(image * gain), 0, 255).astype(np.uint8)
    noisy, draw = image.copy(), rng.random(image.shape[:2])
    noisy[draw < NOISY_PIXELS / 2] = 0
    noisy[draw > 1 - NOISY_PIXELS / 2] = 255
    return noisy


class AutoExposure:
    """A gain that slowly follows the brightness, which the paper switched off in Unreal.

    It adapts each image's mean brightness towards that of the first, which stays unchanged. Unreal changes the exposure
    by a limited number of stops per second of running time (by default 3 up, 1 down), and not while the game is paused.
    That is wall time: at ClockSpeed k only 1/k of it passes in the same flight, so that images of the same place
    differ.
    """

    def __init__(self) -> None:
        self.stops = 0.0
        self._target: float | None = None
        self._last_ns = 0

    def expose(self, image: Image, ran_ns: int) -> Image:
        """Return a copy of a gray or colour image, exposed after a total running wall time of `ran_ns`."""
        brightness = max(mean_brightness(image), 1.0)
        if self._target is None:
            self._target, self._last_ns = brightness, ran_ns
        wanted = float(np.clip(np.log2(self._target / brightness), -LARGEST_STOPS, LARGEST_STOPS))
        passed_s = (ran_ns - self._last_ns) / NS_PER_S
        step = np.clip(wanted - self.stops, -DOWN_STOPS_PER_S * passed_s, UP_STOPS_PER_S * passed_s)
        self.stops, self._last_ns = self.stops + float(step), ran_ns
        exposed: NDArray[np.float64] = np.clip(np.round(image * 2.0**self.stops), 0, 255)
        return exposed.astype(np.uint8)
