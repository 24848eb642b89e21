"""The paper as a suite: its games are whole runs of other suites, its report is the verdict on each claim."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass

from uavaccel.records import RunDirectory
from uavaccel.suites.paper.config import PaperConfig, read_claims
from uavaccel.suites.paper.report import PaperReport
from uavaccel.suites.paper.verdicts import training_run
from uavaccel.suites.parts import fly_part, part_cost, part_suite
from uavaccel.suites.suite import Cost, GameResult, Suite


@dataclass(frozen=True)
class Case:
    """A part: one run of another suite."""

    name: str
    part_s: float
    timing: str = "virtual"

    @property
    def id(self) -> str:
        return self.name

    def simulated_s(self) -> float:
        return self.part_s


class Paper(Suite[PaperConfig, Case]):
    """`uavaccel run paper`."""

    name = "paper"
    config = PaperConfig
    report_class = PaperReport
    batch = 1

    def check(self, config: PaperConfig) -> None:
        read_claims(config)
        if config.with_run is not None:
            training_run(config.with_run)

    def cases(self, config: PaperConfig) -> Iterator[Case]:
        for name, part in config.parts.items():
            yield Case(name, part_cost(part, config.seed)[0])

    def cost(self, config: PaperConfig, case: Case) -> Cost:
        return part_cost(config.parts[case.name], config.seed)[1]

    def renders(self, config: PaperConfig) -> bool:
        suites = [part_suite(part, config.seed) for part in config.parts.values()]
        return any(suite.renders(part_config) for suite, part_config in suites)

    def open(
        self, config: PaperConfig, timing: str, run: RunDirectory
    ) -> AbstractContextManager[RunDirectory]:
        return nullcontext(run)

    def fly(self, config: PaperConfig, case: Case, opened: RunDirectory) -> GameResult:
        summary = fly_part(opened, case.name, config.parts[case.name], config.seed)
        return GameResult({"suite": self.name, "case": case.id, "cells": len(summary["cells"])})
