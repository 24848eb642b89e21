"""Configuration of a sweep: who flies, and what departs from the conditions of its training."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, field_validator

from uavaccel.rl.agents import DEFAULT
from uavaccel.suites.experiment import Experiment
from uavaccel.suites.parts import Part
from uavaccel.suites.sweep.conditions import key_of, value_text


class SweepConfig(Experiment):
    """`suite: sweep`."""

    suite: Literal["sweep"]
    agent: str = DEFAULT
    """As `uavaccel evaluate` takes it."""
    games: Annotated[int, Field(ge=1)] = 300
    """Evaluation lanes of each condition, the same ones in all."""
    sweep: dict[str, tuple[Any, ...]]
    """By short name (suites/sweep/conditions.py) or dotted key, the values: one at a time, all else as trained."""
    evaluation: Part = Part(experiment="evaluate")

    @field_validator("sweep")
    @classmethod
    def _conditions(cls, sweep: dict[str, tuple[Any, ...]]) -> dict[str, tuple[Any, ...]]:
        if not sweep:
            raise ValueError("needs at least one condition, such as wind: [0, 3, 6]")
        for name, values in sweep.items():
            key_of(name)
            texts = [value_text(value) for value in values]
            if not texts or len(set(texts)) < len(texts):
                raise ValueError(f"{name} needs values, each once, not {list(values)}")
        return sweep
