"""A sweep as a suite: a case is an evaluation under one condition, a run directory of its own below the run's."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from typing import Any

from uavaccel.errors import UserError
from uavaccel.records import RunDirectory
from uavaccel.rl.agents import policy_sha256
from uavaccel.suites.evaluation.as_part import OF_SUMMARY, fly_evaluation, won
from uavaccel.suites.evaluation.config import EvaluateConfig
from uavaccel.suites.experiment import timing_of
from uavaccel.suites.gpu import on_own_gpu
from uavaccel.suites.parts import part_cost, part_suite
from uavaccel.suites.report import Row
from uavaccel.suites.suite import AnySuite, Cost, Flown, Suite
from uavaccel.suites.sweep.cases import Case, cases, conditions, part_of
from uavaccel.suites.sweep.config import SweepConfig
from uavaccel.suites.sweep.report import SweepReport


class Sweep(Suite[SweepConfig, Case]):
    """`uavaccel evaluate --sweep`, `uavaccel run sweep`."""

    name = "sweep"
    config = SweepConfig
    report_class = SweepReport
    batch = 1

    def check(self, config: SweepConfig) -> None:
        for case in conditions(config):
            _, evaluation = part_suite(part_of(config, case), config.seed)
            if not isinstance(evaluation, EvaluateConfig):
                raise UserError(f"evaluation.experiment = {config.evaluation.experiment}: is no evaluation")

    def cases(self, config: SweepConfig) -> Iterator[Case]:
        return cases(config)

    def games(self, config: SweepConfig, case: Case) -> int:
        return config.games

    def cost(self, config: SweepConfig, case: Case) -> Cost:
        return part_cost(part_of(config, case), config.seed)[1]

    def renders(self, config: SweepConfig) -> bool:
        suite, evaluation = _as_trained(config)
        return suite.renders(evaluation)

    def why_serial(self, config: SweepConfig) -> str:
        """As its evaluations."""
        suite, evaluation = _as_trained(config)
        if timing_of(evaluation) == "wall":
            return "neighbours would spoil the measurement on the wall clock"
        return suite.why_serial(evaluation)

    def provenance(self, config: SweepConfig) -> Mapping[str, Any]:
        return {"policy_sha256": policy_sha256(config.agent)}

    def open(
        self, config: SweepConfig, timing: str, run: RunDirectory
    ) -> AbstractContextManager[RunDirectory]:
        return on_own_gpu(run)

    def fly(self, config: SweepConfig, case: Case, opened: RunDirectory) -> Flown:
        row = {
            "suite": self.name,
            "case": case.id,
            "condition": case.condition,
            "value": case.value,
            "same": list(case.same),
        }
        return fly_evaluation(opened, row, part_of(config, case), config.seed, (*OF_SUMMARY, "timing"))

    def status(self, rows: Sequence[Row]) -> str:
        return won(rows[-1])


def _as_trained(config: SweepConfig) -> tuple[AnySuite, Any]:
    return part_suite(part_of(config, Case()), config.seed)
