"""The RL experiment as a suite: each case trains a policy and evaluates it, in folders of its own below the run's."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path

from uavaccel.records import RunDirectory
from uavaccel.suites.gpu import on_own_gpu
from uavaccel.suites.parts import part_suite
from uavaccel.suites.report import Row
from uavaccel.suites.rl.cases import (
    Size,
    TrainingCase,
    cases,
    training_part,
)
from uavaccel.suites.rl.config import RlConfig
from uavaccel.suites.rl.flights import train_and_evaluate
from uavaccel.suites.rl.merged import merge_runs
from uavaccel.suites.rl.report import RlReport
from uavaccel.suites.rl.size import checkpoint_bytes, part_configs, size_of
from uavaccel.suites.suite import Cost, GameResult, Suite


class Rl(Suite[RlConfig, TrainingCase]):
    """`uavaccel run rl`."""

    name = "rl"
    config = RlConfig
    report_class = RlReport
    batch = 1

    def check(self, config: RlConfig) -> None:
        """Training and evaluation of each cell can be configured; its policy need not exist yet."""
        for cell in cases(config.model_copy(update={"seeds": 1})):
            part_configs(config, cell)

    def cases(self, config: RlConfig) -> Iterator[TrainingCase]:
        known: dict[str, Size] = {}  # trainings that differ in their seed alone are of one size
        for number, cell in enumerate(cases(config)):
            kind = replace(cell, seed=0).id
            if kind not in known:
                known[kind] = size_of(config, cell)
            # A checkpoint goes when its training is over: the first cell's stands for all.
            kept = 0.0 if number else checkpoint_bytes(config, cell)
            yield replace(cell, size=known[kind]._replace(disk_bytes=known[kind].disk_bytes + kept))

    def games(self, config: RlConfig, case: TrainingCase) -> int:
        return case.size.games

    def cost(self, config: RlConfig, case: TrainingCase) -> Cost:
        return Cost(case.size.wall_s, case.size.disk_bytes)

    def renders(self, config: RlConfig) -> bool:
        parts = [training_part(config, cell) for cell in cases(config.model_copy(update={"seeds": 1}))]
        return any(suite.renders(training) for suite, training in [part_suite(part, 0) for part in parts])

    def open(self, config: RlConfig, timing: str, run: RunDirectory) -> AbstractContextManager[RunDirectory]:
        part = training_part(config, next(cases(config)))
        return on_own_gpu(run, str(getattr(part_suite(part, config.seed)[1], "device", "cpu")))

    def fly(self, config: RlConfig, case: TrainingCase, opened: RunDirectory) -> GameResult:
        return train_and_evaluate(config, case, opened)

    def status(self, rows: Sequence[Row]) -> str:
        flown = rows[-1]["evaluations"][0]
        return f"{rows[-1]['case']} won {flown['successes']} of {flown['games']}"

    def compare(self, runs: Sequence[RunDirectory]) -> list[Path]:
        """One report of several runs' cells, in the first one's folder `merged`."""
        merged = merge_runs(runs)
        self.report(merged).write()
        return [merged.path / "report.html"]
