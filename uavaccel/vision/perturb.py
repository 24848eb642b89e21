"""A MODEL of how a renderer under time pressure corrupts images; off by default, since MuJoCo corrupts none.

The kinds are those that the paper observed in Unreal's pipeline (section III-A); their magnitudes are this
project's own choice. Every figure that depends on this model has to say so.
"""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]

NOISY_PIXELS = 0.05  # share of the pixels hit by salt and pepper
DARKER, BRIGHTER = (0.4, 0.8), (1.25, 2.0)  # ranges of the brightness gain
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


def perturb_share(
    image: Image, settings: PerturbationSettings, index: int
) -> tuple[Image, PerturbationKind | None]:
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
    return _PERTURB[kind](image, rng)


def _salt_and_pepper(image: Image, rng: np.random.Generator) -> Image:
    noisy, draw = image.copy(), rng.random(image.shape[:2])
    noisy[draw < NOISY_PIXELS / 2] = 0
    noisy[draw > 1 - NOISY_PIXELS / 2] = 255
    return noisy


def _brightness(image: Image, rng: np.random.Generator) -> Image:
    gain = rng.uniform(*(DARKER if rng.random() < 0.5 else BRIGHTER))
    return np.clip(np.round(image * gain), 0, 255).astype(np.uint8)


def _colours(image: Image, rng: np.random.Generator) -> Image:
    return np.ascontiguousarray(image[:, :, CHANNEL_ORDERS[rng.integers(len(CHANNEL_ORDERS))]])


def _empty(image: Image, rng: np.random.Generator) -> Image:
    return np.zeros_like(image)


_PERTURB = {
    PerturbationKind.SALT_AND_PEPPER: _salt_and_pepper,
    PerturbationKind.BRIGHTNESS: _brightness,
    PerturbationKind.COLOURS: _colours,
    PerturbationKind.EMPTY: _empty,
}
