"""The RL experiment as a suite: each case trains a policy and evaluates it, in folders of its own below the run's."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from uavaccel.records import RunDirectory
from uavaccel.rl.agents import DEFAULT
from uavaccel.suites.parts import part_cost, part_suite
from uavaccel.suites.rl import report
from uavaccel.suites.rl.cells import (
    EVALUATION_SEED,
    Cell,
    cells,
    evaluated_with,
    evaluation_part,
    training_part,
)
from uavaccel.suites.rl.config import RlConfig
from uavaccel.suites.rl.flights import fly_cell
from uavaccel.suites.rl.gpu import take_gpu
from uavaccel.suites.rl.together import put_together
from uavaccel.suites.suite import Cost, Flown, Row, Suite, Summary, SummaryTable

GPU_RATE = 1_500.0  # simulated seconds per wall second of many lanes on one GPU, about
CELL_BYTES = 2e6  # of policy, figures and curves


class Rl(Suite[RlConfig, Cell]):
    """`uavaccel run rl`."""

    name = "rl"
    config = RlConfig
    batch = 1

    def check(self, config: RlConfig) -> None:
        """Training and evaluation of each cell can be configured; its policy need not exist yet."""
        for cell in cells(config.model_copy(update={"seeds": 1})):
            self._parts(config, cell)

    def cases(self, config: RlConfig) -> Iterator[Cell]:
        known: dict[str, float] = {}  # trainings that differ in their seed alone take as long
        for cell in cells(config):
            kind = replace(cell, seed=0).id
            if kind not in known:
                known[kind] = self._cost(config, cell)[0]
            yield replace(cell, cell_s=known[kind])

    def games(self, config: RlConfig, case: Cell) -> int:
        return sum(part.games for part in self._parts(config, case))

    def cost(self, config: RlConfig, case: Cell) -> Cost:
        simulated_s, cost = self._cost(config, case)
        on_gpu = str(self._parts(config, case)[0].device).startswith("cuda")
        return Cost(simulated_s / GPU_RATE if on_gpu else cost.wall_s, cost.disk_bytes + CELL_BYTES)

    def _parts(self, config: RlConfig, cell: Cell) -> list[Any]:
        """Configurations of the cell's training and evaluations; the policy that ships stands for its own."""
        parts = [part_suite(training_part(config, cell), cell.seed)]
        for command in evaluated_with(config, cell):
            parts.append(part_suite(evaluation_part(config, cell, command, DEFAULT), EVALUATION_SEED))
        return [part_config for _, part_config in parts]

    def _cost(self, config: RlConfig, cell: Cell) -> tuple[float, Cost]:
        """Simulated seconds, wall seconds and bytes of a cell, about."""
        parts = [part_cost(training_part(config, cell), cell.seed)]
        for command in evaluated_with(config, cell):
            parts.append(part_cost(evaluation_part(config, cell, command, DEFAULT), EVALUATION_SEED))
        total = Cost(sum(cost.wall_s for _, cost in parts), sum(cost.disk_bytes for _, cost in parts))
        return sum(simulated_s for simulated_s, _ in parts), total

    def renders(self, config: RlConfig) -> bool:
        return any(
            suite.renders(training)
            for cell in cells(config.model_copy(update={"seeds": 1}))
            for suite, training in [part_suite(training_part(config, cell), cell.seed)]
        )

    @contextmanager
    def open(self, config: RlConfig, timing: str, run: RunDirectory) -> Iterator[RunDirectory]:
        """The run; this process has a GPU of its own from now on, where there are several."""
        take_gpu(self._parts(config, next(cells(config)))[0].device)
        yield run

    def fly(self, config: RlConfig, case: Cell, opened: RunDirectory) -> Flown:
        return fly_cell(config, case, opened)

    def status(self, rows: Sequence[Row]) -> str:
        flown = rows[-1]["evaluations"][0]
        return f"{rows[-1]['case']} won {flown['successes']} of {flown['games']}"

    def headline(self, summary: Summary) -> str:
        return report.headline(summary)

    def overview(self, summary: Summary) -> SummaryTable:
        return SummaryTable(report.SHORT_HEADER, report.overview(summary))

    def report(self, run: RunDirectory) -> Summary:
        return report.write_report(run)

    def compare(self, runs: Sequence[RunDirectory]) -> Path:
        """One report of several runs' cells, in the first one's folder `together`."""
        together = put_together(runs)
        report.write_report(together)
        return together.path / "report.html"
