"""The suite `evaluate`: an agent flies lanes that no training has seen (paper, section IV-D)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from uavaccel.config import validate
from uavaccel.envs.flyable import check_flyable
from uavaccel.envs.obstacle_lane import ObstacleLane
from uavaccel.envs.simulators import KERNELS, check_names, check_simulator
from uavaccel.files import Plain
from uavaccel.records import RunDirectory
from uavaccel.rl.agents import check_agent, make_agent, policy_sha256
from uavaccel.suites.evaluation.config import EvaluateConfig, completed
from uavaccel.suites.evaluation.flights import Case, EvaluateRow, fly_game, lane_case
from uavaccel.suites.old_report import Report
from uavaccel.suites.rows import Row
from uavaccel.suites.suite import GameResult, Suite, choose_row

if TYPE_CHECKING:
    from uavaccel.draw.film import Film

Opened = Callable[[int], GameResult]


class Evaluation(Suite[EvaluateConfig, Case]):
    """`uavaccel evaluate`."""

    name = "evaluate"
    config = EvaluateConfig
    row = EvaluateRow

    @property
    def report_class(self) -> type[Report]:
        from uavaccel.suites.evaluation.report import EvaluationReport  # loads what draws

        return EvaluationReport

    def complete(self, mapping: Mapping[str, Plain]) -> Mapping[str, Plain]:
        return completed(mapping)

    def check(self, config: EvaluateConfig) -> None:
        check_agent(config.agent, config.task)
        check_names(config.simulator, config.device)
        if config.simulator == KERNELS:
            check_flyable(config.task, 1, config.device)

    def cases(self, config: EvaluateConfig) -> Iterator[Case]:
        for lane in range(config.first_lane, config.first_lane + config.games):
            yield Case(lane_case(lane), config.task.timing, config.task.typical_s, lane)

    def case_of(self, row: Plain) -> str:
        return lane_case(row["lane"])

    def may_grow(self, folder: Path) -> tuple[str, ...]:
        return ("games",)

    @contextmanager
    def open(self, config: EvaluateConfig, timing: str, run: RunDirectory) -> Iterator[Opened]:
        """Yield a function that flies the game on a lane, in one environment or in a batch."""
        from uavaccel.suites.evaluation.batch import GamesInBatch
        from uavaccel.suites.evaluation.lanes import GamesOverArrays

        if self.why_serial(config):
            done = run.done_cases()
            left = [case.lane for case in self.cases(config) if case.id not in done]
            games = GamesOverArrays if config.simulator == KERNELS else GamesInBatch
            with closing(games(config, left)) as batch:
                yield batch.game
            return
        import torch as th

        th.set_num_threads(1)
        with closing(ObstacleLane(**config.task.model_dump(mode="json"))) as environment:
            agent = make_agent(config.agent, config.task)
            yield lambda lane: GameResult(fly_game(config, environment, agent, lane))

    def fly(self, config: EvaluateConfig, case: Case, opened: Opened) -> GameResult:
        return opened(case.lane)

    def why_serial(self, config: EvaluateConfig) -> str:
        """A batch has processes or threads of its own."""
        if config.simulator == KERNELS:
            return "simulator = kernels flies all lanes as one batch"
        many = config.environments
        return f"environments = {many} flies in processes of its own" if many > 1 else ""

    def renders(self, config: EvaluateConfig) -> bool:
        return config.task.observation != "state" and config.simulator != KERNELS

    def provenance(self, config: EvaluateConfig) -> Mapping[str, object]:
        """Return the policy's hash and the simulator.

        Raises UserError for a device that this machine does not have, and for weights that cannot be read.
        """
        check_simulator(config.simulator, config.device)
        make_agent(config.agent, config.task)  # the weights too: nothing is written yet
        by = {"simulator": config.simulator, "device": config.device}
        return {"policy_sha256": policy_sha256(config.agent), **by}

    def status(self, rows: Sequence[Row]) -> str:
        return f"success {sum(row['is_success'] for row in rows) / len(rows):.0%}"

    def compare(self, runs: Sequence[RunDirectory]) -> list[Path]:
        from uavaccel.suites.evaluation.report import COMPARISON, plot_evaluations
        from uavaccel.suites.evaluation.side_by_side import write_simulators

        both = write_simulators(runs)
        return [plot_evaluations(runs, runs[0].file(COMPARISON)).path, *both]

    def film(self, run: RunDirectory, case: str | None) -> tuple[str, Film]:
        """Fly a game again, by default the best, and film it: in `virtual` and `lockstep` it is the same game."""
        from uavaccel.suites.evaluation.film import best_first, film_lane

        row = choose_row(run, case, best_first(run.rows()))
        config = validate(EvaluateConfig, run.config(), str(run.path / "config.yaml"))
        return row["case"], film_lane(config, int(row["lane"]))
