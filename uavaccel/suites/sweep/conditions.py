"""What can be swept by a short name, and the task's keys that it stands for; any dotted key can be swept as it is."""

from __future__ import annotations

from typing import Any

from uavaccel.errors import UsageError, suggestion
from uavaccel.yaml_io import parse_yaml

SHORT = {
    "wind": "task.difficulty.wind_m_s",
    "light": "task.difficulty.light",
    "textures": "task.difficulty.texture_variation",
    "scenery": "task.difficulty.scenery",
    "spacing": "task.difficulty.row_spacing_m",
    "gap": "task.difficulty.min_gap_m",
    "mass": "task.difficulty.mass_ratio",
    "thrust": "task.difficulty.thrust_ratio",
    "speed": "task.speed_m_s",
    "height": "task.altitude_m",
    "sensor": "task.dvs_preset",
    "threshold": "task.dvs_threshold_ratio",
    "spread": "task.dvs_spread_ratio",
    "shot_noise": "task.dvs_shot_noise_hz",
    "leak": "task.dvs_leak_hz",
    "hot_pixels": "task.dvs_hot_pixels",
    "image_noise": "task.image_noise",
    "latency": "task.latency.scale",
    "clock": "task.clock_speed",
    "command": "task.command",
    "profile": "task.profile",
}
UNITS = {
    "wind": "m/s",
    "spacing": "m",
    "gap": "m",
    "speed": "m/s",
    "height": "m",
    "light": "of daylight",
    "mass": "× AirSim's",
    "thrust": "× AirSim's",
    "threshold": "× the preset's",
    "spread": "× the preset's",
    "shot_noise": "Hz",
    "leak": "Hz",
    "hot_pixels": "of all",
    "image_noise": "of 255",
    "latency": "× the model's",
    "clock": "x",
}


def key_of(name: str) -> str:
    """The dotted key of a condition. Raises UsageError for a name that is neither a short one nor dotted."""
    if name in SHORT:
        return SHORT[name]
    if name.startswith("task."):
        return name
    raise UsageError(f"--sweep {name}: is unknown; {suggestion(name, [*SHORT, 'task.KEY'])}")


def keys_of(name: str, value: Any) -> dict[str, Any]:
    """A condition as an evaluation's keys; a level of light is a range of one level."""
    key = key_of(name)
    return {key: [value, value] if key == SHORT["light"] and not isinstance(value, list) else value}


def parse_sweep(text: str) -> tuple[str, list[Any]]:
    """Name and values of NAME=VALUE,VALUE,... Raises UsageError."""
    name, equals, values = text.partition("=")
    if not equals or not name or not values:
        raise UsageError(f"--sweep {text}: must be NAME=VALUE,VALUE,..., as in wind=0,3,6")
    key_of(name)
    parsed = parse_yaml(f"[{values}]", source=f"--sweep {text}")
    return name, list(parsed)


def value_text(value: Any) -> str:
    """A value as rows, tables and figures have it: 3, 0.15, noisy."""
    return f"{value:g}" if isinstance(value, int | float) and not isinstance(value, bool) else str(value)
