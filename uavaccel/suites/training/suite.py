"""The suite `train`: games flown one after another by a learner."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING

from uavaccel.envs.simulators import EXACT
from uavaccel.errors import UserError
from uavaccel.files import Plain
from uavaccel.forms import RowForm
from uavaccel.records import RunDirectory
from uavaccel.rl.agents import first_policy, policy_sha256
from uavaccel.rl.config import check_algorithm
from uavaccel.rl.policy import trained_with
from uavaccel.suites.old_report import Report
from uavaccel.suites.rows import Row
from uavaccel.suites.suite import GameResult, SimpleCase, Suite
from uavaccel.suites.training.config import CHECKPOINTS, TrainConfig, game_case

if TYPE_CHECKING:
    from uavaccel.suites.training.flights import Trainer



class Training(Suite[TrainConfig, SimpleCase]):
    """`uavaccel train`."""

    name = "train"
    config = TrainConfig
    serial = "its games learn from each other; --set environments=N flies N lanes side by side"

    @property
    def report_class(self) -> type[Report]:
        from uavaccel.suites.training.report import TrainingReport  # loads what draws

        return TrainingReport

    @property
    def form(self) -> RowForm:
        from uavaccel.suites.training.rows import TrainRow  # loads TensorBoard

        return RowForm(TrainRow, self.name, self.case_of)

    def case_of(self, row: Plain) -> str:
        return game_case(row["game"])

    def check(self, config: TrainConfig) -> None:
        check_algorithm(config)
        if config.start_from is not None:
            first_policy(config, lambda _: 0.0)

    def cases(self, config: TrainConfig) -> Iterator[SimpleCase]:
        for game in range(config.games):  # lane and environment of each come out of the training
            yield SimpleCase(game_case(game), config.task.timing, config.task.typical_s)

    def may_grow(self, folder: Path) -> tuple[str, ...]:
        """More games can be flown where there is a checkpoint to resume from."""
        if not (folder / CHECKPOINTS).is_dir():
            return ()
        from uavaccel.rl.checkpoint import find_checkpoint

        return ("games",) if find_checkpoint(folder / CHECKPOINTS) else ()

    def prepare(self, config: TrainConfig, run: RunDirectory) -> None:
        """Bring an unfinished training back to its last checkpoint."""
        if run.is_new():
            return  # PyTorch need not be there yet
        from uavaccel.suites.training.flights import drop_games_after_checkpoint

        if trained_with(run.path).get("games") != config.games or len(run.rows()) < config.games:
            drop_games_after_checkpoint(run)

    def open(self, config: TrainConfig, timing: str, run: RunDirectory) -> AbstractContextManager[Trainer]:
        lanes = None
        if config.simulator == EXACT and timing != "wall":
            from uavaccel.rl.exact_lanes import begin_exact_lanes

            lanes = begin_exact_lanes(config.task, config.environments)
        from uavaccel.suites.training.flights import open_trainer  # loads PyTorch, as they load

        return open_trainer(config, run, lanes)

    def fly(self, config: TrainConfig, case: SimpleCase, opened: Trainer) -> GameResult:
        return opened.next_game()

    def finish(self, config: TrainConfig, run: RunDirectory) -> None:
        from uavaccel.suites.training.real_time import REAL_TIME, model_real_time

        run.write_json(REAL_TIME, model_real_time(config))

    def renders(self, config: TrainConfig) -> bool:
        return config.task.observation != "state"

    def provenance(self, config: TrainConfig) -> Mapping[str, object]:
        """Return threads and initial weights. Raises UserError for a device that this machine does not have."""
        if config.device != "cpu":
            _check_device(config.device)
        started = {} if config.start_from is None else {"start_from_sha256": policy_sha256(config.start_from)}
        return {"torch_threads": config.torch_threads, **started}

    def status(self, rows: Sequence[Row]) -> str:
        from uavaccel.suites.training.rows import RECENT

        recent = rows[-RECENT:]
        return (
            f"success of the last {len(recent)}: {sum(row['is_success'] for row in recent) / len(recent):.0%}"
        )

    def compare(self, runs: Sequence[RunDirectory]) -> list[Path]:
        from uavaccel.suites.training.report import compare_trainings

        return compare_trainings(runs)


def _check_device(device: str) -> None:
    import torch as th

    try:
        th.zeros(1, device=device)
    except (RuntimeError, AssertionError) as error:
        raise UserError(f"device = {device!r}: {str(error).splitlines()[0]}") from error
