"""The RL experiment as a suite: each case trains a policy and evaluates it, in folders of its own below the run's."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from typing import Any

from uavaccel.envs.simulators import EXACT
from uavaccel.errors import UserError
from uavaccel.records import RunDirectory
from uavaccel.rl.agents import DEFAULT
from uavaccel.suites.gpu import on_own_gpu
from uavaccel.suites.parts import part_suite
from uavaccel.suites.report import Row
from uavaccel.suites.rl.cases import Size, TrainingCase, cases, evaluation_part, flights, training_part
from uavaccel.suites.rl.config import RlConfig
from uavaccel.suites.rl.flights import fly_cell
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
        """Training and evaluations of each cell can be configured; its policy need not exist yet."""
        evaluations = {}
        for cell in cases(config.model_copy(update={"seeds": 1})):
            evaluations[cell.exact] = part_configs(config, cell)[-1]
        if config.exact_seeds:
            _refuse_other_lanes(evaluations[False], evaluations[True])

    def provenance(self, config: RlConfig) -> Mapping[str, Any]:
        """Raises UserError where this machine lacks what flies the parts."""
        cell = next(cases(config))
        parts = training_part(config, cell), evaluation_part(config, cell, flights(config, cell)[0], DEFAULT)
        try:
            for suite, part in (part_suite(part, config.seed) for part in parts):
                suite.provenance(part)
        except UserError as error:
            raise UserError(f"{error}; without a GPU: uavaccel run rl_smoke") from error
        return {}

    def may_grow(self, folder: Path) -> tuple[str, ...]:
        return ("seeds", "exact_seeds")

    def stage(self, case: TrainingCase) -> int:
        """A policy is flown in the exact simulator once it is trained, by whichever process."""
        return int(case.exact)

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
        return fly_cell(config, case, opened)

    def status(self, rows: Sequence[Row]) -> str:
        flown = rows[-1]["evaluations"][0]
        return f"{rows[-1]['case']} won {flown['successes']} of {flown['games']}"

    def compare(self, runs: Sequence[RunDirectory]) -> list[Path]:
        """One report of several runs' cells, in the first one's folder `merged`."""
        merged = merge_runs(runs)
        self.report(merged).write()
        return [merged.path / "report.html"]


def _refuse_other_lanes(evaluation: Any, exact: Any) -> None:
    """Both simulators fly the same lanes, side by side."""
    if exact.simulator != EXACT or evaluation.simulator == EXACT:
        raise UserError(
            f"exact_seeds: needs exact.keys.simulator = {EXACT}, not {exact.simulator}, beside an evaluation by the "
            f"kernels, not by {evaluation.simulator}; or exact_seeds = 0"
        )
    if (exact.first_lane, exact.games) != (evaluation.first_lane, evaluation.games):
        raise UserError("exact.keys: games and first_lane must be those of evaluation.keys, lane for lane")
