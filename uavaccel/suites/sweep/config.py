"""Configuration of a sweep: who flies, and which conditions depart from those of the training."""

from __future__ import annotations

from typing import Literal

from pydantic import field_validator

from uavaccel.envs.conditions import CONDITIONS
from uavaccel.errors import UsageError, suggestion
from uavaccel.suites.evaluation.parts import PolicyExperiment
from uavaccel.yaml_io import parse_yaml


def key_of(name: str) -> str:
    """Return the dotted key of a condition. Raises UsageError for a name that is neither short nor a task's key."""
    if name in CONDITIONS:
        return f"task.{CONDITIONS[name].key}"
    if name.startswith("task."):
        return name
    raise UsageError(f"--sweep {name}: is unknown; {suggestion(name, [*CONDITIONS, 'task.KEY'])}")


def keys_of(name: str, value: object) -> dict[str, object]:
    """Return a condition as keys of an evaluation; a single level of light is a range of one level."""
    key = key_of(name)
    return {key: [value, value] if key == key_of("light") and not isinstance(value, list) else value}


def parse_sweep(text: str) -> tuple[str, list[object]]:
    """Parse NAME=VALUE,VALUE,... into name and values. Raises UsageError."""
    name, equals, values = text.partition("=")
    if not equals or not name or not values:
        raise UsageError(f"--sweep {text}: must be NAME=VALUE,VALUE,..., as in wind=0,3,6")
    key_of(name)
    parsed = parse_yaml(f"[{values}]", source=f"--sweep {text}")
    return name, list(parsed)


def value_text(value: object) -> str:
    """Return a value as names, tables and figures have it: 3, 0.15, noisy."""
    return f"{value:g}" if isinstance(value, int | float) and not isinstance(value, bool) else str(value)


class SweepConfig(PolicyExperiment):
    """`suite: sweep`."""

    suite: Literal["sweep"]
    sweep: dict[str, tuple[object, ...]]
    """Values by short name (envs/conditions.py) or dotted key; one is changed at a time, all else is as trained."""

    @field_validator("sweep")
    @classmethod
    def _conditions(cls, sweep: dict[str, tuple[object, ...]]) -> dict[str, tuple[object, ...]]:
        if not sweep:
            raise ValueError("needs at least one condition, such as wind: [0, 3, 6]")
        for name, values in sweep.items():
            key_of(name)
            texts = [value_text(value) for value in values]
            if not texts or len(set(texts)) < len(texts):
                raise ValueError(f"{name} needs values, each once, not {list(values)}")
        return sweep
