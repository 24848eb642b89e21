"""AirSim's settings.json: the keys that have an effect here, and the names of those that do not.

Source of keys and defaults: AirSim v1.8.1, AirSimSettings.hpp. A value that contradicts this simulator is refused.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from math import floor
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import BaseModel, Field, model_validator
from pydantic.alias_generators import to_pascal

from uavaccel.config import ClockSpeed, validate
from uavaccel.errors import UserError
from uavaccel.files import parse_json, read_bounded
from uavaccel.sim.earth import GeoPoint
from uavaccel.sim.poses import check_wind
from uavaccel.sim.profile import Profile
from uavaccel.sim.sensors import (
    AirSimKeys,
    BarometerSettings,
    DistanceSettings,
    GpsSettings,
    ImuSettings,
    LidarSettings,
    MagnetometerSettings,
)
from uavaccel.sim.world import MOST_VEHICLES, VEHICLE, World
from uavaccel.units import NS_PER_S, exact, ticks_exactly
from uavaccel.wire.pictures import CameraSettings
from uavaccel.wire.rpc import LOOPBACK, PORT

SensorSettings = Annotated[
    BarometerSettings | ImuSettings | GpsSettings | MagnetometerSettings | DistanceSettings | LidarSettings,
    Field(discriminator="sensor_type"),
]
COMPUTER_VISION = "ComputerVision"
LARGEST_BYTES = 1 << 20
_NOTES = {"SettingsVersion", "SeeDocsAt"}  # keys for people and other programs, which need no effect


class WindSettings(AirSimKeys):
    """The wind in m/s, NED."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0

    @model_validator(mode="after")
    def _bearable(self) -> Self:
        check_wind((self.x, self.y, self.z))
        return self


class RecordedImage(AirSimKeys):
    """An image that is taken at each sample of a recording; of the default vehicle if none is named."""

    vehicle_name: str = ""
    camera_name: str = ""
    image_type: int = 0
    pixels_as_float: bool = False
    compress: bool = True


class RecordingSettings(AirSimKeys):
    """The recorder's interval in seconds, its images, and where it writes."""

    record_interval: Annotated[float, Field(gt=0.0)] = 0.05
    record_on_move: bool = False
    cameras: list[RecordedImage] = Field(default_factory=list)
    folder: str = ""
    enabled: bool = False


class OriginGeopoint(AirSimKeys):
    """The geographic position of NED's origin: degrees, and metres above sea level."""

    latitude: Annotated[float, Field(ge=-90.0, le=90.0)] = 47.641468
    longitude: Annotated[float, Field(ge=-180.0, le=180.0)] = -122.140165
    altitude: Annotated[float, Field(ge=-1000.0, le=10_000.0)] = 122.0


class VehicleSettings(AirSimKeys):
    """A vehicle of settings.json, in NED metres from the player's start and degrees."""

    vehicle_type: Literal["SimpleFlight", "simpleflight", "ComputerVision", "computervision"] = "SimpleFlight"
    auto_create: bool = True
    is_fpv_vehicle: bool = False
    x: float | None = None
    y: float | None = None
    z: float | None = None
    yaw: float | None = None
    cameras: dict[str, CameraSettings] = Field(default_factory=dict)
    sensors: dict[str, SensorSettings] | None = None

    @property
    def placed(self) -> bool:
        """Whether the settings give its start."""
        return (self.x, self.y, self.z) != (None, None, None)


class Settings(AirSimKeys):
    """The settings of a server under AirSim's names in snake case, in SI units, the wind NED."""

    sim_mode: Literal["Multirotor", "ComputerVision", ""] = "Multirotor"
    clock_type: Literal["SteppableClock", ""] = ""
    clock_speed: ClockSpeed = 1.0
    local_host_ip: str = ""
    api_server_port: Annotated[int, Field(ge=0, le=65535)] = PORT
    enable_rpc: Literal[True] = True
    rpc_enabled: Literal[True] = True
    physics_engine_name: Literal["FastPhysicsEngine", ""] = ""
    vehicles: Annotated[dict[str, VehicleSettings], Field(max_length=MOST_VEHICLES)] = Field(default_factory=dict)
    wind: WindSettings = WindSettings()
    recording: RecordingSettings = RecordingSettings()
    camera_defaults: CameraSettings = CameraSettings()
    external_cameras: dict[str, CameraSettings] = Field(default_factory=dict)
    default_sensors: dict[str, SensorSettings] | None = None
    origin_geopoint: OriginGeopoint = OriginGeopoint()
    sensor_seed: Annotated[int, Field(ge=0)] = 0
    """The seed of the sensors' noise, which is our own key."""

    @model_validator(mode="after")
    def _flyable(self) -> Self:
        """Refuse vehicles that are only cameras where vehicles fly: AirSim does not create those."""
        for name, vehicle in self.created():
            if vehicle.vehicle_type.lower() == COMPUTER_VISION.lower() and not self.flightless:
                kind = vehicle.vehicle_type
                raise ValueError(f"Vehicles.{name}.VehicleType = '{kind}' needs SimMode = '{COMPUTER_VISION}'")
        return self

    @property
    def vehicle(self) -> str:
        """The default vehicle's name: the alphabetically first one, or the one with IsFpvVehicle."""
        created = self.created()
        watched = (name for name, vehicle in created if vehicle.is_fpv_vehicle)
        return next(watched, created[0][0] if created else COMPUTER_VISION if self.flightless else VEHICLE)

    @property
    def flightless(self) -> bool:
        """Whether the SimMode is ComputerVision, in which vehicles are only cameras that are put somewhere."""
        return self.sim_mode == COMPUTER_VISION

    def created(self) -> list[tuple[str, VehicleSettings]]:
        """Return the vehicles that exist from the start, in alphabetical order as in AirSim's map."""
        return [(name, self.vehicles[name]) for name in sorted(self.vehicles) if self.vehicles[name].auto_create]

    @property
    def home(self) -> GeoPoint:
        """The geographic position of NED's origin."""
        origin = self.origin_geopoint
        return GeoPoint(origin.latitude, origin.longitude, origin.altitude)

    @property
    def address(self) -> str:
        """The address to listen on: an IP address or a host name."""
        return self.local_host_ip or LOOPBACK

    @property
    def recordings(self) -> Path:
        """The folder of startRecording: Recording.Folder, or AirSim's own."""
        return Path(self.recording.folder) if self.recording.folder else Path.home() / "Documents" / "AirSim"

    def recorder_of(self, profile: Profile) -> Profile:
        """Set a profile's recorder period. Raises UserError if an exact profile's tick does not divide it.

        AirSim's recorder waits for more than the interval (RecordingThread.cpp).
        """
        interval_s = self.recording.record_interval
        if profile.exact_times:
            ticks = ticks_exactly(interval_s, profile.tick_ns, "Recording.RecordInterval")
        else:
            ticks = floor(exact(interval_s) * NS_PER_S / profile.tick_ns) + 1
        return replace(profile, recorder_ticks=ticks)

    def prepare(self, world: World) -> None:
        """Set the wind and the altitude of a world."""
        world.lead.state["wind"] = (self.wind.x, self.wind.y, self.wind.z)
        world.lead.parameters["ground_altitude_m"] = self.origin_geopoint.altitude

    def without_effect(self) -> list[str]:
        """Return the dotted names of the given keys that have no effect here."""
        return [name for name in _unknown(self, "") if name not in _NOTES]

    def warning(self, path: Path | None) -> str:
        """Say in a line, which begins with their file, which given keys have no effect; nothing if all have one.

        Of those with the same last name, as every camera may have them, the first is named.
        """
        alike: dict[str, list[str]] = {}
        for name in self.without_effect():
            alike.setdefault(name.rpartition(".")[2], []).append(name)
        said = (f"{first} and {len(others)} more" if others else first for first, *others in alike.values())
        return f"{path}: without effect here: {', '.join(said)}" if alike else ""

    def as_json(self, clock_speed: float) -> str:
        """Return the answer of getSettingsString: the given settings, with the ClockSpeed that is in effect."""
        given = self.model_dump(mode="json", by_alias=True, exclude_unset=True)
        return json.dumps({"SimMode": "Multirotor", **given, "ClockSpeed": clock_speed})


@contextmanager
def naming_settings(path: Path | None) -> Iterator[None]:
    """Name the file in a UserError of settings that were read, and do not fit what they are used with."""
    try:
        yield
    except UserError as error:
        raise UserError(f"{path}: {error}" if path else str(error)) from None


def read_settings(path: Path) -> Settings:
    """Read the settings in a file. Raises UserError: one line that names the file, the key and what would be right."""
    try:
        mapping = parse_json(read_bounded(path, LARGEST_BYTES).decode("utf-8-sig"))
    except OSError as error:
        raise UserError(f"{path}: cannot be read: {error.strerror}") from None
    except ValueError as error:
        raise UserError(f"{path}: not JSON: {error}") from None
    if not isinstance(mapping, dict):
        raise UserError(f"{path}: settings should be a mapping in braces, not {type(mapping).__name__}")
    return validate(Settings, mapping, str(path))


def _unknown(value: object, prefix: str) -> Iterator[str]:
    """Yield the dotted names of the keys that no field of the models takes."""
    if isinstance(value, BaseModel):
        yield from (f"{prefix}{name}" for name in value.model_extra or {})
        for name in sorted(value.model_fields_set & set(type(value).model_fields)):
            yield from _unknown(getattr(value, name), f"{prefix}{to_pascal(name)}.")
    elif isinstance(value, dict):
        for name, inner in value.items():
            yield from _unknown(inner, f"{prefix}{name}.")
    elif isinstance(value, list):
        for number, inner in enumerate(value):
            yield from _unknown(inner, f"{prefix}{number}.")
