"""Evaluations flown side by side: the rows of single environments, in order, whatever happens on the way."""

from __future__ import annotations

import os
import re
import signal
from pathlib import Path
from typing import Any

import pytest

from tests.opengl import needs_opengl
from tests.running import configured
from uavaccel.errors import UsageError, UserError
from uavaccel.records import RunDirectory
from uavaccel.suites.evaluation.batch import GamesInBatch
from uavaccel.suites.evaluation.suite import Evaluation
from uavaccel.suites.runner import begin_run, check_jobs, run_suite


def evaluated(out: Path, *overrides: str, resume: bool = False, **options: Any) -> RunDirectory:
    """Games on a few lanes, without a report."""
    suite, config = Evaluation(), configured("evaluate", *overrides, **{"agent": "straight", **options})
    run = begin_run(suite, config, out, {}, resume)
    run_suite(suite, config, run)
    return run


def rows_of(run: RunDirectory) -> bytes:
    return (run.path / "rows.jsonl").read_bytes()


@pytest.mark.slow
@needs_opengl
def test_rows_of_a_policy_are_those_of_single_environments(tmp_path: Path) -> None:
    short, keys = "task.max_commands=12", dict[str, Any](agent="default", games=5)
    single = evaluated(tmp_path / "1", short, **keys)
    batch = evaluated(tmp_path / "3", short, "environments=3", **keys)
    assert rows_of(batch) == rows_of(single)
    assert [row["lane"] for row in batch.rows()] == [0, 1, 2, 3, 4]
    assert len({tuple(row["actions"]) for row in batch.rows()}) > 1
    assert all(entry["wall_s"] >= entry["host_wall_s"] for entry in batch.timings())


@pytest.mark.slow
def test_a_killed_process_is_one_line_and_rows_stay(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    game, games = GamesInBatch.game, 30  # so many that some are still flown when the processes die

    def killing(self: GamesInBatch, lane: int) -> Any:
        if lane == 2:
            for process in self._batch.process_ids:
                os.kill(process, signal.SIGKILL)
        return game(self, lane)

    monkeypatch.setattr(GamesInBatch, "game", killing)
    with pytest.raises(
        UserError, match=r"^the process of environment \d ended with status -9; go on with --resume$"
    ):
        evaluated(tmp_path / "run", "environments=2", games=games)
    monkeypatch.undo()
    lanes = [row["lane"] for row in RunDirectory(tmp_path / "run").rows()]
    assert lanes == list(range(len(lanes)))  # more than two: rows that were there when the processes died
    assert 2 <= len(lanes) < games
    resumed = evaluated(tmp_path / "run", "environments=2", games=games, resume=True)
    assert rows_of(resumed) == rows_of(evaluated(tmp_path / "single", games=games))


def test_more_processes_around_a_batch_are_refused() -> None:
    config = configured("evaluate", "environments=3", agent="straight")
    said = "--jobs must be 1 with evaluate: environments = 3 flies in processes of its own"
    with pytest.raises(UsageError, match=f"^{re.escape(said)}$"):
        check_jobs(Evaluation(), config, 2)
    check_jobs(Evaluation(), config, 1)
    check_jobs(Evaluation(), configured("evaluate", agent="straight"), 2)


def test_wall_takes_one_environment() -> None:
    with pytest.raises(UserError, match="environments must be 1 with timing wall"):
        configured("evaluate", "environments=2", agent="straight", timing="wall")
