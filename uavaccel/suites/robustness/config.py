"""Configuration of a robustness map: who flies, and the axes of the map."""

from __future__ import annotations

from typing import Literal

from pydantic import field_validator

from uavaccel.limits import MOST_SCALE, Games
from uavaccel.rl.agents import DEFAULT
from uavaccel.suites.experiment import ClockSpeeds, CommandNames, Experiment, ProfileName, distinct
from uavaccel.suites.parts import Part


class RobustnessConfig(Experiment):
    """`suite: robustness`."""

    suite: Literal["robustness"]
    agent: str = DEFAULT
    """As `uavaccel evaluate` takes it."""
    profile: ProfileName = "airsim"
    command: CommandNames = ("tcsc", "adsc")
    clock_speed: ClockSpeeds
    latency_scale: tuple[float, ...]
    """Times the latencies of the profile's model; flown in this order, so begin with what matters most."""
    games: Games = 100
    """Evaluation lanes of each cell, the same ones in all."""
    evaluation: Part = Part(experiment="evaluate")

    @field_validator("latency_scale")
    @classmethod
    def _not_negative(cls, scales: tuple[float, ...]) -> tuple[float, ...]:
        if any(not 0 <= scale <= MOST_SCALE for scale in scales):
            raise ValueError(f"must be 0 to {MOST_SCALE:g}")
        return distinct(scales)
