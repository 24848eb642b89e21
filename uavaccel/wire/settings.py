"""AirSim's settings.json: what a server here honours of it, and by name what it passes over.

Source of keys and defaults: AirSim v1.8.1, AirSimSettings.hpp. A value that contradicts this simulator is refused.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from math import floor
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field
from pydantic.alias_generators import to_pascal

from uavaccel.config import Config, validate
from uavaccel.errors import UserError
from uavaccel.sim.profile import Profile
from uavaccel.units import NS_PER_S, exact, ticks_exactly

LOOPBACK = "127.0.0.1"
PORT = 41451
VEHICLE = "SimpleFlight"
_NOTES = {"SettingsVersion", "SeeDocsAt"}  # for people and other programs; nothing is lost with them


class _AirSim(Config):
    """A mapping with AirSim's keys; others are kept beside."""

    model_config = ConfigDict(extra="allow", alias_generator=to_pascal)


class Wind(_AirSim):
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0


class Recording(_AirSim):
    record_interval: Annotated[float, Field(gt=0.0)] = 0.05
    folder: str = ""
    enabled: bool = False


class Vehicle(_AirSim):
    vehicle_type: Literal["SimpleFlight", "simpleflight"] = "SimpleFlight"


class Settings(_AirSim):
    """The settings of a server, by AirSim's names in snake case. SI units, wind NED."""

    sim_mode: Literal["Multirotor", ""] = "Multirotor"
    clock_type: Literal["SteppableClock", ""] = ""
    clock_speed: Annotated[float, Field(gt=0.0)] = 1.0
    local_host_ip: str = ""
    api_server_port: Annotated[int, Field(ge=0, le=65535)] = PORT
    enable_rpc: Literal[True] = True
    rpc_enabled: Literal[True] = True
    physics_engine_name: Literal["FastPhysicsEngine", ""] = ""
    vehicles: Annotated[dict[str, Vehicle], Field(max_length=1)] = Field(default_factory=dict)
    wind: Wind = Wind()
    recording: Recording = Recording()

    @property
    def vehicle(self) -> str:
        """The vehicle's name."""
        return next(iter(self.vehicles), VEHICLE)

    @property
    def address(self) -> str:
        """Where to listen: an IP address or a host's name."""
        return self.local_host_ip or LOOPBACK

    def recorder_of(self, profile: Profile) -> Profile:
        """The profile with the recorder's period. Raises UserError where an exact profile's tick does not divide it.

        AirSim's recorder waits for more than the interval (RecordingThread.cpp).
        """
        interval_s = self.recording.record_interval
        if profile.exact_times:
            ticks = ticks_exactly(interval_s, profile.tick_ns, "Recording.RecordInterval")
        else:
            ticks = floor(exact(interval_s) * NS_PER_S / profile.tick_ns) + 1
        return replace(profile, recorder_ticks=ticks)

    def passed_over(self) -> list[str]:
        """Dotted names of what was given and has no meaning here."""
        return [name for name in _unknown(self, "") if name not in _NOTES]

    def as_json(self, clock_speed: float) -> str:
        """What getSettingsString returns: the settings as given, with the ClockSpeed that holds."""
        given = self.model_dump(mode="json", by_alias=True, exclude_unset=True)
        return json.dumps({"SimMode": "Multirotor", **given, "ClockSpeed": clock_speed})


def read_settings(path: Path) -> Settings:
    """The settings in a file. Raises UserError: one line that names the file, the key and what would be right."""
    try:
        mapping = json.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise UserError(f"{path}: cannot be read: {error.strerror}") from None
    except ValueError as error:
        raise UserError(f"{path}: not JSON: {error}") from None
    if not isinstance(mapping, dict):
        raise UserError(f"{path}: settings should be a mapping in braces, not {type(mapping).__name__}")
    return validate(Settings, mapping, str(path))


def _unknown(value: Any, prefix: str) -> Iterator[str]:
    """Dotted names of the keys that no field of the models takes."""
    if isinstance(value, BaseModel):
        yield from (f"{prefix}{name}" for name in value.model_extra or {})
        for name in sorted(value.model_fields_set & set(type(value).model_fields)):
            yield from _unknown(getattr(value, name), f"{prefix}{to_pascal(name)}.")
    elif isinstance(value, dict):
        for name, inner in value.items():
            yield from _unknown(inner, f"{prefix}{name}.")
