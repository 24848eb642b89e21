"""The robustness map as a suite: a sweep over latency and ClockSpeed at once, with each command."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import product

from uavaccel.suites.evaluation.parts import EvaluationCase, PolicySuite
from uavaccel.suites.parts import part_cost
from uavaccel.suites.robustness.config import RobustnessConfig
from uavaccel.suites.robustness.report import RobustnessReport
from uavaccel.suites.sweep.conditions import key_of


class Robustness(PolicySuite[RobustnessConfig]):
    """`uavaccel run robustness`."""

    name = "robustness"
    config = RobustnessConfig
    report_class = RobustnessReport

    def evaluations(self, config: RobustnessConfig) -> Iterator[EvaluationCase]:
        """Latency by latency, so that a run that is stopped has whole rows of the map."""
        for scale, clock_speed, command in product(config.latency_scale, config.clock_speed, config.command):
            point = {
                "profile": config.profile,
                "command": command,
                "clock": clock_speed,
                "latency": scale,
            }
            keys = {key_of(name): value for name, value in point.items()}
            labels = {"command": command, "clock_speed": clock_speed, "latency_scale": scale}
            case_id = f"latency{scale:g}-{command}-{clock_speed:g}x"
            yield EvaluationCase(case_id, {**keys, "task.timing": "virtual"}, labels)

    def cases(self, config: RobustnessConfig) -> Iterator[EvaluationCase]:
        evaluations = list(self.evaluations(config))
        simulated_s, _ = part_cost(self.part(config, evaluations[0]), config.seed)
        return (replace(case, simulated=simulated_s) for case in evaluations)
