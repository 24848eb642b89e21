"""Noise that depends on the time of a reading and a seed, not on the readings before it."""

from __future__ import annotations

import math
import zlib

import numpy as np
from numpy.typing import NDArray


class White:
    """Independent standard normal numbers for each sample of a sensor."""

    def __init__(self, seed: int, sensor: str, size: int) -> None:
        self._key = np.random.SeedSequence([seed, zlib.crc32(sensor.encode())]).generate_state(2, np.uint64)
        self._size = size

    def at(self, sample: int) -> NDArray[np.float64]:
        """(size,), of the sample of that number, 0 or more."""
        generator = np.random.Generator(np.random.Philox(key=self._key, counter=[0, 0, 0, sample]))
        return generator.standard_normal(self._size)


class Drift:
    """A first-order Gauss-Markov process of three axes or fewer, in steps of a second; for ever if `tau_s` is inf.

    `sigma`: after a long time; of a random walk, of a second's step. It starts at `sigma` times a normal number where
    `at_rest` is false, else at 0.
    """

    def __init__(self, white: White, sigma: float, tau_s: float, at_rest: bool) -> None:
        self._white, self._sigma = white, sigma
        self._keep = math.exp(-1.0 / tau_s)
        self._step = 1.0 if math.isinf(tau_s) else math.sqrt(1.0 - self._keep**2)
        self._first = white.at(0) * (0.0 if at_rest else sigma)
        self._second, self._value = 0, self._first

    def at(self, time_s: float) -> NDArray[np.float64]:
        """The process at a time, 0 or more; it stays what it is within a second."""
        if time_s < self._second:  # a saved state was gone back to
            self._second, self._value = 0, self._first
        while self._second + 1 <= time_s:
            self._second += 1
            step = self._white.at(self._second) * self._sigma * self._step
            self._value = self._value * self._keep + step
        return self._value
