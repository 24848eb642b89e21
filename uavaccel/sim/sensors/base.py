"""What AirSim's sensors have in common: keys of their settings, what they measure, and noise.

Noise depends only on a seed and on the time of a reading, not on earlier readings.
"""

from __future__ import annotations

import math
import zlib
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, field_validator
from pydantic.alias_generators import to_pascal

from uavaccel.config import Config
from uavaccel.kinematics import Kinematics
from uavaccel.sim.poses import Pose
from uavaccel.sim.sensors.earth import GeoPoint, geographic
from uavaccel.units import NS_PER_S


class AirSimKeys(Config):
    """Settings with AirSim's PascalCase keys; unknown keys are kept.

    Every number is 0, or between LEAST and MOST in size: what is computed from it stays finite.
    """

    model_config = ConfigDict(extra="allow", alias_generator=to_pascal)

    @field_validator("*")
    @classmethod
    def _in_range(cls, value: Checked) -> Checked:
        if isinstance(value, int | float) and value and not LEAST <= abs(value) <= MOST:
            raise ValueError(f"must be 0, or between {LEAST:g} and {MOST:g} in size")
        return value


Checked = TypeVar("Checked")
LEAST, MOST = 1e-12, 1e12


class Truth(NamedTuple):
    """Ground truth for a reading: a vehicle's state, physics step, time since the last reset, and NED's origin."""

    kinematics: Kinematics
    tick_s: float
    since_reset_s: float
    home: GeoPoint
    body: str = "quadrotor"  # the vehicle's body in the model, through which rays pass

    @property
    def time_s(self) -> float:
        return self.kinematics.time_ns / NS_PER_S

    @property
    def sample(self) -> int:
        """Number of the tick since the simulation was made."""
        return round(self.time_s / self.tick_s)

    @property
    def pose(self) -> Pose:
        """Pose of the vehicle, NED."""
        return Pose(self.kinematics.position_m, self.kinematics.orientation_wxyz)

    @property
    def place(self) -> GeoPoint:
        """Geographic position of the vehicle."""
        return geographic(self.kinematics.position_m, self.home)


UPDATES_PER_S = 50  # of a drift: BarometerSimpleParams' update_frequency


def seeds_of(seed: int, sensor: str) -> np.random.SeedSequence:
    """Return the seed sequence of a sensor, by its name."""
    return np.random.SeedSequence([seed, zlib.crc32(sensor.encode())])


class White:
    """White noise: independent standard normal numbers for each sample."""

    def __init__(self, seed: int, sensor: str, size: int) -> None:
        self._key = seeds_of(seed, sensor).generate_state(2, np.uint64)
        self._size = size

    def at(self, sample: int) -> NDArray[np.float64]:
        """Return the noise (size,) of sample number `sample`, 0 or more."""
        generator = np.random.Generator(np.random.Philox(key=self._key, counter=[0, 0, 0, sample]))
        return generator.standard_normal(self._size)


class Drift:
    """A first-order process that begins at 0; each step multiplies it by `keep` and adds `gain` times a normal number.

    It has UPDATES_PER_S steps, as AirSim's barometer.
    """

    def __init__(self, seed: int, sensor: str, size: int, keep: float, gain: float) -> None:
        self._white, self._size = White(seed, sensor, UPDATES_PER_S * size), size
        self._keep, self._gain = keep, gain
        self._shares = gain * keep ** np.arange(UPDATES_PER_S - 1, -1, -1.0)[:, None]  # at a second's end
        self._begin()

    def _begin(self) -> None:
        self._second, self._first = 0, np.zeros(self._size)
        self._values: list[NDArray[np.float64]] = []  # of this second, once they are asked for

    def at(self, time_s: float) -> NDArray[np.float64]:
        """Return the value (size,) at a time, 0 s or more."""
        second, update = divmod(math.floor(time_s * UPDATES_PER_S + 1e-6), UPDATES_PER_S)
        if second < self._second:  # a reset, or a saved state was gone back to
            self._begin()
        while self._second < second:
            gained = (self._shares * self._drawn()).sum(axis=0)
            self._first = self._keep**UPDATES_PER_S * self._first + gained
            self._second += 1
            self._values = []
        if not self._values:
            self._values = [self._first]
            for drawn in self._drawn():
                self._values.append(self._keep * self._values[-1] + self._gain * drawn)
        return self._values[update].copy()

    def _drawn(self) -> NDArray[np.float64]:
        """Return the normal numbers (UPDATES_PER_S, size) of the present second."""
        return self._white.at(self._second).reshape(UPDATES_PER_S, self._size)
