"""Counter-based random numbers of a seed, a frame and a pixel (Philox 4x32-10, Salmon et al., SC 2011).

A picture's noise does not depend on the order in which its pixels are processed: it is the same on one core, on many
threads and on a GPU. A block is four pixels in a row.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from uavaccel.sim.parts import njit, part

LEAK_JITTER, SHOT_NOISE, READ_NOISE, LATENCY = 1, 2, 3, 4  # independent streams
PIXELS = 4  # per block

_MULTIPLIER_0, _MULTIPLIER_1 = np.uint64(0xD2511F53), np.uint64(0xCD9E8D57)
_WEYL_0, _WEYL_1 = np.uint64(0x9E3779B9), np.uint64(0xBB67AE85)
_LOW, _WORD = np.uint64(0xFFFFFFFF), np.uint64(32)
_ROUNDS = 10
_HALF = np.uint64(8)  # bits of a word beyond the 24 of a float32
_STEP_32, _STEP_24 = 2.0**-32, np.float32(2.0**-24)

Word = int | np.uint64
Words = tuple[np.uint64, np.uint64, np.uint64, np.uint64]
Four = tuple[np.float32, np.float32, np.float32, np.float32]


@part
def words(seed: Word, frame: Word, stream: int, block: int) -> Words:
    """Return four random words of 32 bits."""
    a, b = np.uint64(block) & _LOW, np.uint64(frame) & _LOW
    c, d = np.uint64(frame) >> _WORD, np.uint64(stream)
    k, m = np.uint64(seed) & _LOW, np.uint64(seed) >> _WORD
    for _ in range(_ROUNDS):
        x, y = _MULTIPLIER_0 * a, _MULTIPLIER_1 * c
        a, b, c, d = (y >> _WORD) ^ b ^ k, y & _LOW, (x >> _WORD) ^ d ^ m, x & _LOW
        k, m = (k + _WEYL_0) & _LOW, (m + _WEYL_1) & _LOW
    return a, b, c, d


@part
def uniform_block(seed: Word, frame: Word, stream: int, block: int) -> Four:
    """Return four uniform numbers in [0, 1)."""
    a, b, c, d = words(seed, frame, stream, block)
    return (
        np.float32(a >> _HALF) * _STEP_24,
        np.float32(b >> _HALF) * _STEP_24,
        np.float32(c >> _HALF) * _STEP_24,
        np.float32(d >> _HALF) * _STEP_24,
    )


@part
def normal_block(seed: Word, frame: Word, stream: int, block: int) -> Four:
    """Return four standard normal numbers, by Box and Muller's method in double precision."""
    a, b, c, d = words(seed, frame, stream, block)
    near = math.sqrt(-2.0 * math.log((np.float64(a) + 0.5) * _STEP_32))
    far = math.sqrt(-2.0 * math.log((np.float64(b) + 0.5) * _STEP_32))
    turn, other = 2.0 * math.pi * (np.float64(c) * _STEP_32), 2.0 * math.pi * (np.float64(d) * _STEP_32)
    return (
        np.float32(near * math.cos(turn)),
        np.float32(near * math.sin(turn)),
        np.float32(far * math.cos(other)),
        np.float32(far * math.sin(other)),
    )


@njit(nogil=True, cache=True)
def fill_uniform(out: NDArray[np.float32], seed: Word, frame: Word, stream: int) -> None:
    """Fill an array (n,) with uniform numbers in [0, 1), from block 0 on."""
    for first in range(0, len(out), PIXELS):
        four = uniform_block(seed, frame, stream, first // PIXELS)
        for place in range(min(PIXELS, len(out) - first)):
            out[first + place] = four[place]


@njit(nogil=True, cache=True)
def fill_normal(out: NDArray[np.float32], seed: Word, frame: Word, stream: int) -> None:
    """Fill an array (n,) with standard normal numbers, from block 0 on."""
    for first in range(0, len(out), PIXELS):
        four = normal_block(seed, frame, stream, first // PIXELS)
        for place in range(min(PIXELS, len(out) - first)):
            out[first + place] = four[place]


def _filled(
    fill: Callable[[NDArray[np.float32], Word, Word, int], None], shape: tuple[int, ...], *of: int
) -> NDArray[np.float32]:
    """Return an array of random numbers of a seed, a frame, both below 2**64, and a stream."""
    out, (seed, frame, stream) = np.empty(shape, np.float32), of
    fill(out.ravel(), np.uint64(seed), np.uint64(frame), stream)
    return out


uniform, normal = partial(_filled, fill_uniform), partial(_filled, fill_normal)


Image = NDArray[np.uint8]
APART = 0x6E01  # makes a game's noise independent of its other random numbers


@dataclass(frozen=True)
class ImageNoise:
    """A camera's read noise: Gaussian and independent for each pixel, channel and time (EMVA 1288's dark noise).

    Its standard deviation is `sigma` in grey levels of 255, in a game that began at `start_ns`. It is a pure function
    of image, seed and time, so that a game flown again has the same noise.
    """

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
        noisy = image + np.float32(self.sigma) * normal(image.shape, self.seed, moment, READ_NOISE)
        return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def noise_seed(game: np.random.SeedSequence) -> int:
    """Return the noise seed of a game, independent of other random numbers from the game's seed."""
    apart = np.random.SeedSequence(game.entropy, spawn_key=(*game.spawn_key, APART))
    return int(apart.generate_state(1, np.uint32)[0])
