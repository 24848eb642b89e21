"""What can be swept: the conditions of envs/conditions.py by their short names, and any dotted key of the task."""

from __future__ import annotations

from uavaccel.envs.conditions import CONDITIONS
from uavaccel.errors import UsageError, suggestion
from uavaccel.yaml_io import parse_yaml


def key_of(name: str) -> str:
    """The dotted key of a condition. Raises UsageError for a name that is neither a short one nor dotted."""
    if name in CONDITIONS:
        return f"task.{CONDITIONS[name].key}"
    if name.startswith("task."):
        return name
    raise UsageError(f"--sweep {name}: is unknown; {suggestion(name, [*CONDITIONS, 'task.KEY'])}")


def keys_of(name: str, value: object) -> dict[str, object]:
    """A condition as an evaluation's keys; a level of light is a range of one level."""
    key = key_of(name)
    return {key: [value, value] if key == key_of("light") and not isinstance(value, list) else value}


def parse_sweep(text: str) -> tuple[str, list[object]]:
    """Name and values of NAME=VALUE,VALUE,... Raises UsageError."""
    name, equals, values = text.partition("=")
    if not equals or not name or not values:
        raise UsageError(f"--sweep {text}: must be NAME=VALUE,VALUE,..., as in wind=0,3,6")
    key_of(name)
    parsed = parse_yaml(f"[{values}]", source=f"--sweep {text}")
    return name, list(parsed)


def value_text(value: object) -> str:
    """A value as rows, tables and figures have it: 3, 0.15, noisy."""
    return f"{value:g}" if isinstance(value, int | float) and not isinstance(value, bool) else str(value)
