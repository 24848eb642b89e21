"""The robustness map as a suite: a cell is an evaluation, a run directory of its own below the run's."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from typing import Any

from uavaccel.records import RunDirectory
from uavaccel.rl.agents import policy_sha256
from uavaccel.suites.evaluation.as_part import fly_evaluation, won
from uavaccel.suites.experiment import CommandName
from uavaccel.suites.gpu import on_own_gpu
from uavaccel.suites.parts import Part, part_cost, part_suite
from uavaccel.suites.report import Row
from uavaccel.suites.robustness.config import RobustnessConfig
from uavaccel.suites.robustness.report import RobustnessReport
from uavaccel.suites.suite import Cost, Flown, Suite


@dataclass(frozen=True)
class Cell:
    """One point of the map."""

    command: CommandName
    clock_speed: float
    latency_scale: float
    simulated: float = field(default=0.0, compare=False)
    timing: str = "virtual"

    @property
    def id(self) -> str:
        return f"latency{self.latency_scale:g}-{self.command}-{self.clock_speed:g}x"

    def simulated_s(self) -> float:
        return self.simulated


class Robustness(Suite[RobustnessConfig, Cell]):
    """`uavaccel run robustness`."""

    name = "robustness"
    config = RobustnessConfig
    report_class = RobustnessReport
    batch = 1

    def check(self, config: RobustnessConfig) -> None:
        cell = Cell(config.command[0], config.clock_speed[0], config.latency_scale[0])
        part_suite(part_of(config, cell), config.seed)

    def cases(self, config: RobustnessConfig) -> Iterator[Cell]:
        """Latency by latency, so that a run that is stopped has whole rows of the map."""
        part = part_of(config, Cell(config.command[0], config.clock_speed[0], config.latency_scale[0]))
        simulated_s, _ = part_cost(part, config.seed)
        for scale in config.latency_scale:
            for clock_speed in config.clock_speed:
                for command in config.command:
                    yield Cell(command, clock_speed, scale, simulated_s)

    def games(self, config: RobustnessConfig, case: Cell) -> int:
        return config.games

    def cost(self, config: RobustnessConfig, case: Cell) -> Cost:
        return part_cost(part_of(config, case), config.seed)[1]

    def renders(self, config: RobustnessConfig) -> bool:
        suite, evaluation = part_suite(part_of(config, next(self.cases(config))), config.seed)
        return suite.renders(evaluation)

    def provenance(self, config: RobustnessConfig) -> Mapping[str, Any]:
        return {"policy_sha256": policy_sha256(config.agent)}

    def open(
        self, config: RobustnessConfig, timing: str, run: RunDirectory
    ) -> AbstractContextManager[RunDirectory]:
        return on_own_gpu(run)

    def fly(self, config: RobustnessConfig, case: Cell, opened: RunDirectory) -> Flown:
        row = {
            "suite": self.name,
            "case": case.id,
            **{name: getattr(case, name) for name in ("command", "clock_speed", "latency_scale")},
        }
        return fly_evaluation(opened, row, part_of(config, case), config.seed)

    def status(self, rows: Sequence[Row]) -> str:
        return won(rows[-1])


def part_of(config: RobustnessConfig, cell: Cell) -> Part:
    """The evaluation that a cell is."""
    keys = {
        **config.evaluation.keys,
        "agent": config.agent,
        "games": config.games,
        "task.profile": config.profile,
        "task.timing": "virtual",
        "task.command": cell.command,
        "task.clock_speed": cell.clock_speed,
        "task.latency.scale": cell.latency_scale,
    }
    return Part(experiment=config.evaluation.experiment, keys=keys)
