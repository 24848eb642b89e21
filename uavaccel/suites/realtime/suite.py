"""The suite `realtime`: agents that need time to think are trained, then evaluated with weights from the run."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import closing, nullcontext
from itertools import product
from pathlib import Path

from uavaccel.errors import UserError
from uavaccel.forms import RowForm
from uavaccel.records import RunDirectory
from uavaccel.suites.old_report import Report
from uavaccel.suites.own_code import own_module
from uavaccel.suites.realtime.config import EvaluationCase, RealtimeConfig, TrainingCase, cases, flies
from uavaccel.suites.rows import Row
from uavaccel.suites.suite import GameResult, Suite

AnyCase = TrainingCase | EvaluationCase


class Realtime(Suite[RealtimeConfig, AnyCase]):
    """`uavaccel run realtime`."""

    name = "realtime"
    config = RealtimeConfig
    batch = 1

    @property
    def report_class(self) -> type[Report]:
        from uavaccel.suites.realtime.report import RealtimeReport

        return RealtimeReport

    @property
    def form(self) -> RowForm:
        from uavaccel.suites.realtime.flights import WEIGHTS, RealtimeRow  # loads PyTorch

        return RowForm(RealtimeRow, self.name, arrays=WEIGHTS)

    def check(self, config: RealtimeConfig) -> None:
        """Raise UserError for an environment that cannot be made, and for an agent that cannot act in it."""
        from uavaccel.realtime.plant import is_of_mujoco
        from uavaccel.suites.realtime.environments import timed

        _import_modules(config)
        for name, agent in product(config.environments, config.agents):
            if not flies(config, name, agent):
                continue
            block = config.environments[name]
            try:
                with closing(timed(block, config.agents[agent], 0.0, "adsc", 1.0)) as env:
                    if config.agents[agent].look_ahead and not is_of_mujoco(env):
                        raise UserError("look_ahead: looks into Gymnasium's MuJoCo environments alone")
            except UserError as error:
                raise UserError(f"environments.{name}, agents.{agent}: {error}") from error
            except Exception as error:  # whatever an environment of anybody's raises
                said = (str(error) or type(error).__name__).splitlines()[0]
                raise UserError(f"environments.{name}: {block.id} cannot be made: {said}") from error

    def cases(self, config: RealtimeConfig) -> Iterator[AnyCase]:
        return cases(config)

    def stage(self, case: AnyCase) -> int:
        return int(isinstance(case, EvaluationCase))

    def why_serial(self, config: RealtimeConfig) -> str:
        return "neighbours would spoil the measurement on the wall clock" if config.timing == "wall" else ""

    def may_grow(self, folder: Path) -> tuple[str, ...]:
        return ("seeds",)

    def games(self, config: RealtimeConfig, case: AnyCase) -> int:
        return case.episodes if isinstance(case, EvaluationCase) else 1

    def open(self, config: RealtimeConfig, timing: str, run: RunDirectory) -> nullcontext[RunDirectory]:
        _import_modules(config)  # in this worker
        return nullcontext(run)

    def fly(self, config: RealtimeConfig, case: AnyCase, opened: RunDirectory) -> GameResult:
        from uavaccel.suites.realtime.flights import fly_evaluation, fly_training

        if isinstance(case, TrainingCase):
            return GameResult(*fly_training(config, case))
        row = next(row for row in opened.rows() if row["case"] == case.training.id)
        return GameResult(fly_evaluation(config, case, opened.load_arrays(row)))

    def compare(self, runs: Sequence[RunDirectory]) -> list[Path]:
        """Compare a run on the simulated clock with one on the machine's, in either order."""
        from uavaccel.suites.realtime.report import compare_clocks

        by_timing = {str(run.config()["timing"]): run for run in runs}
        if set(by_timing) != {"virtual", "wall"}:
            raise UserError("realtime: compares a run with timing virtual and one with timing wall")
        return compare_clocks(by_timing["virtual"], by_timing["wall"])

    def status(self, rows: Sequence[Row]) -> str:
        return str(rows[-1]["case"])


def _import_modules(config: RealtimeConfig) -> None:
    """Import the modules that register environments, as in "module:Name-v0". Raises UserError as `own_module` does."""
    for name, block in config.environments.items():
        module, named, _ = block.id.partition(":")
        if named:
            own_module(module, f"environments.{name}.id")
