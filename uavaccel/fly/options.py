"""The options of a script's flight, as its process gets them, and its summary; where settings.json is found."""

from __future__ import annotations

import json
from contextlib import suppress
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Self, TypedDict

THINK_S = {"wall": 0.0, "virtual": 0.001, "lockstep": 0.0}
"""The script's wall time that a flight charges before each call, by timing.

In `wall` the script takes its own time, and in `lockstep` nothing takes time; in `virtual` a script that calls in a
loop would otherwise do so as fast as messages travel, which no script does.
"""

SUMMARY = "flight.json"
DIFFERENCE = "difference.txt"  # says how a flight differs from its reference; missing if it does not
INTERRUPT_SEEN = "interrupted"  # a file in the temporary folder: the script has received an interruption
ANSWERS = "answers.txt"  # a file in the temporary folder: what the first flight's script has read by `input`
SCRATCH = "uavaccel-fly-"  # prefix of a temporary folder, before the number of its process
NAME = "settings.json"
AIRSIM = Path("Documents", "AirSim", NAME)  # in the user's home
_KEYS = {"SettingsVersion", "SimMode", "Vehicles", "ClockSpeed", "SeeDocsAt"}


class FlightSummary(TypedDict, total=False):
    """The summary of a flight, in the file SUMMARY: SI units, NED; `position_m` is None if no client connected.

    `error` is the script's exception that ended the flight, if one did.
    """

    clock_speed: float
    scene: str
    calls: int
    status: int
    finished: bool
    wall_s: float
    error: str | None
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

    `think_s` is the wall time that the script takes before each call, by default the timing's. `until_s` ends the
    flight when its wall time times ClockSpeed reaches it. `keys` are pressed one after the other. `reference` is the
    folder of a finished flight whose messages this one's must equal. `scratch` is a temporary folder.
    `settings_found`: the settings were found, not named.
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
    keys: tuple[str, ...] = ()
    film: bool = False
    reference: Path | None = None
    scratch: Path | None = None
    settings_found: bool = False

    @property
    def thinks_s(self) -> float:
        """The wall time that is charged before each call."""
        return THINK_S[self.timing] if self.think_s is None else self.think_s

    @property
    def own_folder(self) -> bool:
        """Whether recordings go into the flight's folder: it is kept, or the flight is a second one to compare."""
        return self.reference is not None or self.scratch is None or self.scratch not in self.folder.parents

    def to_json(self) -> str:
        return json.dumps(asdict(self), default=str)

    @classmethod
    def from_json(cls, text: str) -> Self:
        values = json.loads(text)
        for field in fields(cls):
            if "Path" in str(field.type) and values[field.name] is not None:
                values[field.name] = Path(values[field.name])
        return cls(**values | {name: tuple(values[name]) for name in ("arguments", "keys")})


def found_settings(script: Path) -> Path | None:
    """Find the settings.json that AirSim would read, beside the script or in the user's documents; None without.

    It has one of AirSim's keys: other programs use this file name too.
    """
    from uavaccel.errors import UserError  # here, as a script's process needs neither at its start
    from uavaccel.files import parse_json, read_bounded

    for path in (script.absolute().parent / NAME, Path.home() / AIRSIM):
        with suppress(OSError, UserError, ValueError):
            mapping = parse_json(read_bounded(path).decode("utf-8-sig"))
            if isinstance(mapping, dict) and _KEYS & mapping.keys():
                return path
    return None
