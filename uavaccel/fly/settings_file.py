"""AirSim's settings.json where AirSim's users have it: beside their script, or in their documents."""

from __future__ import annotations

import json
from pathlib import Path

NAME = "settings.json"
AIRSIM = Path("Documents", "AirSim", NAME)  # in one's home
_KEYS = {"SettingsVersion", "SimMode", "Vehicles", "ClockSpeed", "SeeDocsAt"}


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
