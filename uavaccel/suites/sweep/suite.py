"""The suite `sweep`: each case is an evaluation in which one condition departs from those of the training."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from uavaccel.suites.evaluation.parts import EvaluationCase, PolicySuite
from uavaccel.suites.experiment import timing_of
from uavaccel.suites.parts import part_cost, part_suite
from uavaccel.suites.sweep.config import SweepConfig, keys_of
from uavaccel.suites.sweep.report import AS_TRAINED, SweepReport, case_id


class Sweep(PolicySuite[SweepConfig]):
    """`uavaccel evaluate --sweep`, `uavaccel run sweep`."""

    name = "sweep"
    config = SweepConfig
    report_class = SweepReport
    kept = (*PolicySuite.kept, "timing")

    def evaluations(self, config: SweepConfig) -> Iterator[EvaluationCase]:
        """Yield the evaluation as trained, then those with one condition changed."""
        yield EvaluationCase(AS_TRAINED, "virtual", 0.0, {}, {"condition": "", "value": None})
        for name, values in config.sweep.items():
            for value in values:
                labels = {"condition": name, "value": value}
                yield EvaluationCase(case_id(name, value), "virtual", 0.0, keys_of(name, value), labels)

    def cases(self, config: SweepConfig) -> Iterator[EvaluationCase]:
        """Yield the evaluations to fly; conditions that change nothing are flown once, as trained."""
        evaluations = [
            (case, part, part_suite(part, config.seed)[1])
            for case in self.evaluations(config)
            for part in [self.part(config, case)]
        ]
        (_, _, usual), *departed = evaluations
        same = [case.id for case, _, evaluation in departed if evaluation == usual]
        for case, part, evaluation in evaluations:
            if case.id not in same:
                labels = {**case.labels, "same": same if case.id == AS_TRAINED else []}
                simulated_s, _ = part_cost(part, config.seed)
                yield replace(case, labels=labels, timing=timing_of(evaluation), typical_s=simulated_s)

    def why_serial(self, config: SweepConfig) -> str:
        """Return why its evaluations are serial, if they are."""
        suite, evaluation = self.first(config)
        if timing_of(evaluation) == "wall":
            return "neighbours would spoil the measurement on the wall clock"
        return suite.why_serial(evaluation)
