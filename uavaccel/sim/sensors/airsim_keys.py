"""What models of AirSim's settings have in common."""

from __future__ import annotations

from pydantic import ConfigDict
from pydantic.alias_generators import to_pascal

from uavaccel.config import Config


class AirSimKeys(Config):
    """A mapping with AirSim's keys; others are kept beside."""

    model_config = ConfigDict(extra="allow", alias_generator=to_pascal)
