"""A MODEL of the images that a renderer short of time gets wrong; off by default: MuJoCo perturbs nothing.

The kinds are those the paper saw from Unreal's pipeline (section III-A); their sizes are this project's own
choice. Whoever uses this says so beside every figure that depends on it.
"""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]

NOISY_PIXELS = 0.05  # share of the pixels that salt and pepper hit
DARKER, BRIGHTER = (0.4, 0.8), (1.25, 2.0)  # ranges of the brightness gain
CHANNEL_ORDERS = ((0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0))


class Kind(StrEnum):
    """The ways in which an image goes wrong."""

    SALT_AND_PEPPER = "salt_and_pepper"
    BRIGHTNESS = "brightness"
    COLOURS = "colours"
    EMPTY = "empty"


@dataclass(frozen=True)
class PerturbationSettings:
    """Which share of the images is perturbed, in which ways (equally often), and by which seed."""

    share: float = 0.0
    kinds: tuple[Kind, ...] = tuple(Kind)
    seed: int = 0

    def __post_init__(self) -> None:
        if not 0 <= self.share <= 1:
            raise ValueError(f"the share of perturbed images must lie in 0..1, not {self.share}")
        if self.share > 0 and not self.kinds:
            raise ValueError("a share of perturbed images needs at least one kind")


def perturb_share(image: Image, settings: PerturbationSettings, index: int) -> tuple[Image, Kind | None]:
    """The `index`-th image of a stream, perturbed or itself, and how; a function of its arguments alone."""
    if settings.share <= 0:
        return image, None
    rng = np.random.default_rng(np.random.SeedSequence(settings.seed, spawn_key=(index,)))
    if rng.random() >= settings.share:
        return image, None
    kind = settings.kinds[rng.integers(len(settings.kinds))]
    return perturb(image, kind, rng), kind


def perturb(image: Image, kind: Kind, rng: np.random.Generator) -> Image:
    """A perturbed copy of a uint8 image (H, W, 3)."""
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
    Kind.SALT_AND_PEPPER: _salt_and_pepper,
    Kind.BRIGHTNESS: _brightness,
    Kind.COLOURS: _colours,
    Kind.EMPTY: _empty,
}
