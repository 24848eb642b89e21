"""What AirSim's sensors have in common: keys of their settings, what they measure, and the table of all kinds."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias, TypeVar

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


Settings: TypeAlias = Any  # an AirSimKeys of its own for each class of sensors
MakeSensor = Callable[[Settings, int, str], object]
Made = TypeVar("Made", bound=MakeSensor)
Checked = TypeVar("Checked")
LEAST, MOST = 1e-12, 1e12
_sensors: dict[type[AirSimKeys], MakeSensor] = {}


def sensor(settings: type[AirSimKeys]) -> Callable[[Made], Made]:
    """Register a class of sensors, whose constructor takes these settings, a noise seed and a name.

    The settings have `sensor_type`, AirSim's number of the kind, and `enabled`.
    """

    def register(made: Made) -> Made:
        _sensors[settings] = made
        return made

    return register


def sensors() -> dict[type[AirSimKeys], MakeSensor]:
    """Return all classes of sensors by their settings, in the order of AirSim's numbers."""
    for module in pkgutil.iter_modules([str(Path(__file__).parent)], f"{__package__}."):
        importlib.import_module(module.name)
    return dict(sorted(_sensors.items(), key=lambda each: int(each[0].model_fields["sensor_type"].default)))


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
