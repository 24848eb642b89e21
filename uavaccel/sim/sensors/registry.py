"""The sensors that a vehicle can have: every module of this folder registers its own."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

from uavaccel.sim.sensors.airsim_keys import AirSimKeys

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
