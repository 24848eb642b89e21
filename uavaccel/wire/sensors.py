"""Which sensors a vehicle has: those of its settings, else those of DefaultSensors, else AirSim's four.

Source: AirSim v1.8.1, AirSimSettings.hpp (createDefaultSensorSettings); a list that is given stands alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, TypeVar, Union

from pydantic import Field

from uavaccel.sim.sensors.base import sensors
from uavaccel.sim.sensors.field import BarometerSettings, GpsSettings, MagnetometerSettings
from uavaccel.sim.sensors.inertial import ImuSettings

SENSORS = sensors()
if TYPE_CHECKING:
    SensorSettings = BarometerSettings | GpsSettings | ImuSettings | MagnetometerSettings
else:
    SensorSettings = Annotated[Union[tuple(SENSORS)], Field(discriminator="sensor_type")]  # noqa: UP007  not yet known
Kind = TypeVar("Kind")
DEFAULTS: dict[str, SensorSettings] = {
    "imu": ImuSettings(),
    "magnetometer": MagnetometerSettings(),
    "gps": GpsSettings(),
    "barometer": BarometerSettings(),
}


class Sensors:
    """A vehicle's sensors by name; `seed` is that of their noise."""

    def __init__(
        self,
        given: Mapping[str, SensorSettings] | None,
        defaults: Mapping[str, SensorSettings] | None,
        seed: int,
    ) -> None:
        chosen = given if given is not None else defaults if defaults is not None else DEFAULTS
        self._sensors = {
            name: SENSORS[type(settings)](settings, seed, name)
            for name, settings in chosen.items()
            if settings.enabled
        }

    def named(self, kind: type[Kind], word: str, name: object) -> Kind:
        """The sensor of a kind that a client calls so, the first if it names none. Raises ValueError."""
        if not isinstance(name, str):
            raise ValueError(f"a sensor's name must be a text, not {type(name).__name__}")
        known = {own: sensor for own, sensor in self._sensors.items() if isinstance(sensor, kind)}
        found = next(iter(known.values()), None) if name == "" else known.get(name)
        if found is None:
            there = f"there is {', '.join(known)}" if known else "the settings' Sensors give none"
            raise ValueError(f"No {word} with name {name} exist on vehicle; {there}")
        return found
