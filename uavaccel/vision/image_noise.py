"""A camera's read noise: Gaussian and independent for each pixel, channel and time (EMVA 1288's dark noise).

It is a pure function of image, seed and time, so that a resumed game has the same noise as one that never stopped.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uavaccel.vision import noise

Image = NDArray[np.uint8]
APART = 0x6E01  # makes a game's noise independent of its other random numbers


@dataclass(frozen=True)
class ImageNoise:
    """Noise with a standard deviation `sigma` in grey levels of 255, in a game that began at `start_ns`."""

    sigma: float = 0.0
    seed: int = 0
    start_ns: int = 0

    def add(self, image: Image, time_ns: int) -> Image:
        """Return a copy of a uint8 image with the noise of that time, rounded and clipped to 0..255.

        If the deviation is 0 it is the image itself.
        """
        if self.sigma == 0.0:
            return image
        moment = time_ns - self.start_ns
        noisy = image + np.float32(self.sigma) * noise.normal(image.shape, self.seed, moment, noise.READ_NOISE)
        return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def noise_seed(game: np.random.SeedSequence) -> int:
    """Return the noise seed of a game, independent of other random numbers from the game's seed."""
    apart = np.random.SeedSequence(game.entropy, spawn_key=(*game.spawn_key, APART))
    return int(apart.generate_state(1, np.uint32)[0])
