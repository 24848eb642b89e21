"""What a flight of a script is asked to be, and how the process that flies it is told."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Self


@dataclass(frozen=True)
class FlightOptions:
    """One flight of one script.

    `think_s` is wall time that the script takes before each call; `until_s` ends it after so many seconds of its wall
    clock times ClockSpeed; `reference` is a finished flight whose messages this one's have to equal.
    """

    script: Path
    arguments: tuple[str, ...]
    folder: Path
    timing: str = "virtual"
    profile: str = "native"
    scene: str = "blocks"
    clock_speed: float | None = None
    settings: Path | None = None
    think_s: float = 0.0
    seed: int | None = None
    until_s: float | None = None
    film: bool = False
    reference: Path | None = None

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
