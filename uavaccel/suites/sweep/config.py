"""Configuration of a sweep: who flies, and what departs from the conditions of its training."""

from __future__ import annotations

from typing import Literal

from pydantic import field_validator

from uavaccel.suites.evaluation.parts import PolicyExperiment
from uavaccel.suites.sweep.conditions import key_of, value_text


class SweepConfig(PolicyExperiment):
    """`suite: sweep`."""

    suite: Literal["sweep"]
    sweep: dict[str, tuple[object, ...]]
    """By short name (envs/conditions.py) or dotted key, the values: one at a time, all else as trained."""

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
