"""What a flight of a script is asked to be, and how the process that flies it is told."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Self, TypedDict

THINK_S = {"wall": 0.0, "virtual": 0.001, "lockstep": 0.0}
"""By timing, the script's wall time that a flight charges before each call.

In `wall` the script takes what it takes, in `lockstep` nothing takes any time; in `virtual` one that calls in a loop
would otherwise do so as often as the wire carries it, which no script does.
"""

SUMMARY = "flight.json"
DIFFERENCE = "difference.txt"  # in it, how a flight differs from its reference; not there where it does not
HEEDED = "interrupted"  # in the temporary folder: the script has got an interruption
SCRATCH = "uavaccel-fly-"  # then the number of the process to which a temporary folder belongs
NAME = "settings.json"
AIRSIM = Path("Documents", "AirSim", NAME)  # in one's home
_KEYS = {"SettingsVersion", "SimMode", "Vehicles", "ClockSpeed", "SeeDocsAt"}


class FlightSummary(TypedDict, total=False):
    """What a flight says of itself in SUMMARY: SI units, NED; `position_m` is None where no client connected."""

    clock_speed: float
    calls: int
    status: int
    finished: bool
    wall_s: float
    simulated_s: float
    position_m: list[float] | None
    failure: str | None
    refused: list[str]
    script_s: float
    slept_s: float
    think_s: float


@dataclass(frozen=True)
class FlightOptions:
    """One flight of one script.

    `think_s` is wall time that the script takes before each call, None the timing's; `until_s` ends it after so many
    seconds of its wall clock times ClockSpeed; `reference` is a finished flight whose messages this one's have to
    equal. `scratch` is a temporary folder; `settings_found`: nobody named the settings, they were found.
    """

    script: Path
    arguments: tuple[str, ...]
    folder: Path
    timing: str = "virtual"
    profile: str = "native"
    scene: str = "blocks"
    clock_speed: float | None = None
    settings: Path | None = None
    think_s: float | None = None
    seed: int | None = None
    until_s: float | None = None
    film: bool = False
    reference: Path | None = None
    scratch: Path | None = None
    settings_found: bool = False

    @property
    def thinks_s(self) -> float:
        """Wall time before each call."""
        return THINK_S[self.timing] if self.think_s is None else self.think_s

    def to_json(self) -> str:
        return json.dumps(
            {key: str(value) if isinstance(value, Path) else value for key, value in asdict(self).items()}
        )

    @classmethod
    def from_json(cls, text: str) -> Self:
        """The inverse of `to_json`."""
        values = json.loads(text)
        for field in fields(cls):
            if "Path" in str(field.type) and values[field.name] is not None:
                values[field.name] = Path(values[field.name])
        return cls(**values | {"arguments": tuple(values["arguments"])})


def found_settings(script: Path) -> Path | None:
    """The file that AirSim would have read: the script's own before the user's. None if there is none."""
    places = (script.absolute().parent / NAME, Path.home() / AIRSIM)
    return next((path for path in places if _is_airsims(path)), None)


def _is_airsims(path: Path) -> bool:
    """Whether it is there and has one of AirSim's keys: other programs call their settings so too."""
    try:
        mapping = json.loads(path.read_text(encoding="utf-8-sig"))
    except (OSError, ValueError, RecursionError):
        return False
    return isinstance(mapping, dict) and bool(_KEYS & mapping.keys())
