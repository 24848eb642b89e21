"""A camera's read noise: Gaussian, of each pixel, channel and moment (EMVA 1288's dark noise, in grey levels).

A pure function of image, seed and time, so that a game that is gone on with has the noise of one that never stopped.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from uavaccel.vision import noise

Image = NDArray[np.uint8]
_APART = 0x6E01  # of a game's noise from what else it draws


@dataclass(frozen=True)
class ImageNoise:
    """Noise of a standard deviation in grey levels of 255, from a seed, in a game that began at `start_ns`."""

    sigma: float = 0.0
    seed: int = 0
    start_ns: int = 0

    def add(self, image: Image, time_ns: int) -> Image:
        """A copy of a uint8 image of any shape, with the noise of a moment, rounded and clipped to 0..255.

        The image itself where the deviation is 0.
        """
        if self.sigma == 0.0:
            return image
        moment = time_ns - self.start_ns
        noisy = image + np.float32(self.sigma) * noise.normal(
            image.shape, self.seed, moment, noise.READ_NOISE
        )
        return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def noise_seed(game: np.random.SeedSequence) -> int:
    """Seed of the noise of a game, set apart from what else is drawn from the game's seed."""
    apart = np.random.SeedSequence(game.entropy, spawn_key=(*game.spawn_key, _APART))
    return int(apart.generate_state(1, np.uint32)[0])
