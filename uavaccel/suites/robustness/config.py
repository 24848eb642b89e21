"""Configuration of a robustness map: who flies, and the axes of the map."""

from __future__ import annotations

from typing import Literal

from pydantic import field_validator

from uavaccel.limits import MOST_SCALE, Games
from uavaccel.suites.evaluation.parts import PolicyExperiment
from uavaccel.suites.experiment import ClockSpeeds, CommandNames, ProfileName, distinct


class RobustnessConfig(PolicyExperiment):
    """`suite: robustness`."""

    suite: Literal["robustness"]
    profile: ProfileName = "airsim"
    """How the simulator handles time: native is exact to the step, airsim behaves like AirSim."""
    command: CommandNames = ("tcsc", "adsc")
    """tcsc pauses the simulation while the program works, adsc does not; each value is flown."""
    clock_speed: ClockSpeeds
    """Simulated seconds per wall second that are asked for; each value is flown."""
    latency_scale: tuple[float, ...]
    """Times the latencies of the profile's model; flown in this order, so begin with what matters most."""
    games: Games = 100
    """How many lanes are flown in each cell."""

    @field_validator("latency_scale")
    @classmethod
    def _not_negative(cls, scales: tuple[float, ...]) -> tuple[float, ...]:
        if any(not 0 <= scale <= MOST_SCALE for scale in scales):
            raise ValueError(f"must be 0 to {MOST_SCALE:g}")
        return distinct(scales)
