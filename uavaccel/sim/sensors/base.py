"""What AirSim's sensors have in common: keys of their settings, what they measure, and the table of all kinds."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias, TypeVar

from pydantic import ConfigDict
from pydantic.alias_generators import to_pascal

from uavaccel.config import Config
from uavaccel.kinematics import Kinematics
from uavaccel.sim.poses import Pose
from uavaccel.sim.sensors.earth import GeoPoint, geographic
from uavaccel.units import NS_PER_S


class AirSimKeys(Config):
    """A mapping with AirSim's keys; others are kept beside."""

    model_config = ConfigDict(extra="allow", alias_generator=to_pascal)


Settings: TypeAlias = Any  # each class of sensors takes its own
MakeSensor = Callable[[Settings, int, str], object]
Made = TypeVar("Made", bound=MakeSensor)
_sensors: dict[type[AirSimKeys], MakeSensor] = {}


def sensor(settings: type[AirSimKeys]) -> Callable[[Made], Made]:
    """Register a class of sensors, made of these settings, the seed of their noise and a name.

    The settings have AirSim's number of the kind as `sensor_type`, and `enabled`.
    """

    def register(made: Made) -> Made:
        _sensors[settings] = made
        return made

    return register


def sensors() -> dict[type[AirSimKeys], MakeSensor]:
    """All classes of sensors by their settings, in the order of AirSim's numbers."""
    for module in pkgutil.iter_modules([str(Path(__file__).parent)], f"{__package__}."):
        importlib.import_module(module.name)
    return dict(sorted(_sensors.items(), key=lambda each: int(each[0].model_fields["sensor_type"].default)))


class Truth(NamedTuple):
    """A vehicle's state, the simulation's tick, seconds since the last reset, and the place of NED's origin."""

    kinematics: Kinematics
    tick_s: float
    since_reset_s: float
    home: GeoPoint
    body: str = "quadrotor"  # the vehicle's in the model, which no ray meets

    @property
    def time_s(self) -> float:
        return self.kinematics.time_ns / NS_PER_S

    @property
    def sample(self) -> int:
        """The number of the tick since the simulation was made."""
        return round(self.time_s / self.tick_s)

    @property
    def pose(self) -> Pose:
        return Pose(self.kinematics.position_m, self.kinematics.orientation_wxyz)

    @property
    def place(self) -> GeoPoint:
        return geographic(self.kinematics.position_m, self.home)
