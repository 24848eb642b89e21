"""The suite `paper`: its cases are whole runs of other suites, its report has the verdict on each claim."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, nullcontext

from uavaccel.forms import Count
from uavaccel.records import RunDirectory
from uavaccel.suites.paper.config import PaperConfig, read_claims
from uavaccel.suites.paper.report import PaperReport, training_run
from uavaccel.suites.parts import fly_part, part_simulated_s, part_suite
from uavaccel.suites.rows import GameRow
from uavaccel.suites.suite import GameResult, SimpleCase, Suite


class PaperRow(GameRow):
    """The row of a part: a run of another suite."""

    cells: Count
    """Number of entries in its summary."""


class Paper(Suite[PaperConfig, SimpleCase]):
    """`uavaccel run paper`."""

    name = "paper"
    config = PaperConfig
    report_class = PaperReport
    row = PaperRow
    batch = 1

    def check(self, config: PaperConfig) -> None:
        read_claims(config)
        if config.with_run is not None:
            training_run(config.with_run)

    def cases(self, config: PaperConfig) -> Iterator[SimpleCase]:
        for name, part in config.parts.items():
            yield SimpleCase(name, "virtual", part_simulated_s(part, config.seed))

    def renders(self, config: PaperConfig) -> bool:
        suites = [part_suite(part, config.seed) for part in config.parts.values()]
        return any(suite.renders(part_config) for suite, part_config in suites)

    def open(
        self, config: PaperConfig, timing: str, run: RunDirectory
    ) -> AbstractContextManager[RunDirectory]:
        return nullcontext(run)

    def fly(self, config: PaperConfig, case: SimpleCase, opened: RunDirectory) -> GameResult:
        summary = fly_part(opened, case.id, config.parts[case.id], config.seed)
        row: PaperRow = {"suite": self.name, "case": case.id, "cells": len(summary["cells"])}
        return GameResult(row)
