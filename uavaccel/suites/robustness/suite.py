"""The suite `robustness`: one policy evaluated over a grid of latency and ClockSpeed, with each command."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import product
from typing import Literal

from pydantic import field_validator

from uavaccel.limits import MOST_SCALE, Games
from uavaccel.suites.evaluation.parts import EvaluationCase, PolicyExperiment, PolicySuite
from uavaccel.suites.experiment import ClockSpeeds, CommandNames, ProfileName, distinct
from uavaccel.suites.parts import part_cost
from uavaccel.suites.robustness.report import RobustnessReport
from uavaccel.suites.sweep.config import key_of


class RobustnessConfig(PolicyExperiment):
    """`suite: robustness`."""

    suite: Literal["robustness"]
    profile: ProfileName = "airsim"
    """How time is handled: exact to the tick, or as AirSim does."""
    command: CommandNames = ("tcsc", "adsc")
    """The synchronous commands to fly with."""
    clock_speed: ClockSpeeds
    """ClockSpeeds to fly at: simulated seconds per wall second."""
    latency_scale: tuple[float, ...]
    """Factors of the latencies of the profile's model, flown in this order: put what matters most first."""
    games: Games = 100
    """Lanes flown in each cell."""

    @field_validator("latency_scale")
    @classmethod
    def _not_negative(cls, scales: tuple[float, ...]) -> tuple[float, ...]:
        if any(not 0 <= scale <= MOST_SCALE for scale in scales):
            raise ValueError(f"must be 0 to {MOST_SCALE:g}")
        return distinct(scales)


class Robustness(PolicySuite[RobustnessConfig]):
    """`uavaccel run robustness`."""

    name = "robustness"
    config = RobustnessConfig
    report_class = RobustnessReport

    def evaluations(self, config: RobustnessConfig) -> Iterator[EvaluationCase]:
        """Yield the cells latency by latency, so that an interrupted run has complete rows of the map."""
        for scale, clock_speed, command in product(config.latency_scale, config.clock_speed, config.command):
            point = {"profile": config.profile, "command": command, "clock": clock_speed, "latency": scale}
            keys = {key_of(name): value for name, value in point.items()}
            labels = {"command": command, "clock_speed": clock_speed, "latency_scale": scale}
            case_id = f"latency{scale:g}-{command}-{clock_speed:g}x"
            yield EvaluationCase(case_id, "virtual", 0.0, {**keys, "task.timing": "virtual"}, labels)

    def cases(self, config: RobustnessConfig) -> Iterator[EvaluationCase]:
        evaluations = list(self.evaluations(config))
        simulated_s, _ = part_cost(self.part(config, evaluations[0]), config.seed)
        return (replace(case, typical_s=simulated_s) for case in evaluations)
