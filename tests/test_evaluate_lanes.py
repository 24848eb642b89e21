"""Evaluations in processes and in the kernels: the rows of single environments, in order, come what may."""

from __future__ import annotations

import os
import re
import signal
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch as th

from tests import made_runs as made
from tests.host_kernels import ON_A_GPU, host_kernels  # noqa: F401 - a fixture
from tests.opengl import needs_opengl
from tests.processes import descendants, left_after
from tests.running import configured, fly_into
from uavaccel.errors import UsageError, UserError
from uavaccel.records import RunDirectory
from uavaccel.suites import evaluate_lanes
from uavaccel.suites.evaluate import Evaluation
from uavaccel.suites.evaluate_lanes import GamesInBatch, blocks
from uavaccel.suites.runner import check_jobs

LOCKSTEP, KERNELS, SHORT = "task.timing=lockstep", "simulator=kernels", "task.max_commands=6"
SEEN = "task.max_commands=12", "first_lane=7"  # in whose first two lanes the policy that ships turns


def evaluated(out: Path, *overrides: str, resume: bool = False, **options: Any) -> RunDirectory:
    config = configured("evaluate", *overrides, **{"agent": "offset:1.5", "games": 3, **options})
    return fly_into(out, Evaluation(), config, resume)


def rows_of(run: RunDirectory) -> bytes:
    return (run.path / "rows.jsonl").read_bytes()


@pytest.mark.slow
@needs_opengl
def test_rows_in_processes_are_alike_up_to_their_death(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a policy that sees; the death of a process is one line."""
    game, games = GamesInBatch.game, 8  # so many that some are still flown when the processes die

    def killing(self: GamesInBatch, lane: int) -> Any:
        assert self._processes is not None
        if lane == 9:
            for process in self._processes.process_ids:
                os.kill(process, signal.SIGKILL)
        return game(self, lane)

    monkeypatch.setattr(GamesInBatch, "game", killing)
    said = r"^the process of environment \d ended with status -9; go on with --resume$"
    with pytest.raises(UserError, match=said):
        evaluated(tmp_path / "run", *SEEN, "environments=2", agent="default", games=games)
    monkeypatch.undo()
    run = RunDirectory(tmp_path / "run")
    flown = len(run.rows())
    assert 2 <= flown < games
    assert rows_of(run) == rows_of(evaluated(tmp_path / "single", *SEEN, agent="default", games=flown))
    assert [row["lane"] for row in run.rows()] == [*range(7, 7 + flown)]
    assert len({tuple(row["actions"]) for row in run.rows()}) > 1
    assert all(entry["wall_s"] >= entry["host_wall_s"] for entry in run.timings())


@pytest.mark.slow
def test_processes_end_where_their_agent_cannot_be_loaded() -> None:
    config = configured("evaluate", "task.observation=state", "environments=2", agent="straight")
    before = descendants(os.getpid())
    with pytest.raises(UserError, match=r"^nowhere: holds no policy"):
        GamesInBatch(config.model_copy(update={"agent": "nowhere"}), [0, 1])
    assert not left_after(descendants(os.getpid()) - before, 5.0)


@pytest.mark.slow
def test_rows_of_the_kernels_are_the_exact_simulators(tmp_path: Path) -> None:
    """Without who flew them, and without the paths of lost lanes, which the kernels do not keep."""
    exact, other = (
        evaluated(tmp_path / name, LOCKSTEP, f"simulator={name}", "task.difficulty.wind_m_s=3.0").rows()
        for name in ("mujoco", "kernels")
    )
    assert {row.pop("simulator") for row in other} == {"kernels"}
    assert all(row.pop("path_m") for row in exact if not row["is_success"])
    assert other == exact


@pytest.mark.slow
def test_a_policys_games_are_the_same_whoever_flies_beside_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    keys = LOCKSTEP, KERNELS, "task.max_commands=14", "first_lane=30"
    whole = evaluated(tmp_path / "whole", *keys, agent="default", games=6)
    assert len({tuple(row["actions"]) for row in whole.rows()}) > 1
    evaluated(tmp_path / "grown", *keys, agent="default", games=2)
    monkeypatch.setattr(evaluate_lanes, "MOST_LANES", 3)
    assert rows_of(evaluated(tmp_path / "grown", *keys, agent="default", games=6, resume=True)) == rows_of(whole)


@pytest.mark.slow
@pytest.mark.usefixtures("host_kernels")
@pytest.mark.parametrize(
    ("agent", "keys"),
    [("default", [LOCKSTEP, "task.split=test"]), ("offset:1.5", ["task.timing=virtual", "task.command=adsc"])],
)
def test_lanes_on_a_gpu_fly_and_decide_as_on_cores(
    agent: str, keys: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cores = evaluated(tmp_path / "cores", KERNELS, SHORT, *keys, agent=agent)
    monkeypatch.setattr(evaluate_lanes, "GPU", "cpu")
    monkeypatch.setattr(evaluate_lanes, "open_lanes", evaluate_lanes.LanesOnGpu)
    th.set_num_threads(1)
    assert rows_of(evaluated(tmp_path / "gpu", KERNELS, SHORT, *keys, agent=agent)) == rows_of(cores)


@pytest.mark.skipif(not ON_A_GPU, reason="UAVACCEL_TEST_GPU=1 flies it on this machine's GPU")
def test_the_bundled_policy_flies_on_a_gpu_as_on_cores(tmp_path: Path) -> None:
    """But for lanes in which a picture's last bit has decided between two actions."""
    keys = KERNELS, LOCKSTEP, "task.mediation.gap_s=0.4", "games=40"
    cores, gpu = (
        evaluated(tmp_path / device, *keys, f"device={device}", agent="default").rows() for device in ("cpu", "cuda")
    )
    alike = [(one, other) for one, other in zip(gpu, cores, strict=True) if one["actions"] == other["actions"]]
    assert len(alike) >= 36
    assert all(one["distance_m"] == pytest.approx(other["distance_m"], abs=1e-9) for one, other in alike)


def test_wall_times_count_from_where_the_games_began(monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = iter((500.0, 502.5, 504.0))
    clock = SimpleNamespace(now_ns=lambda: int(next(now_s) * 1e9))
    monkeypatch.setattr(evaluate_lanes, "MonotonicClock", lambda: clock)
    monkeypatch.setattr(evaluate_lanes, "over_arrays", lambda *_: ([*ended] for ended in ([], LATER, FIRST)))
    batch = GamesInBatch(configured("evaluate", KERNELS, LOCKSTEP, agent="straight"), [7, 8])
    games = [batch.game(lane) for lane in (7, 8)]  # the second has ended before
    batch.close()
    assert [(game.row["lane"], game.host["wall_s"]) for game in games] == [(7, 2.5), (8, 4.0)]
    assert [game.next_is_ready for game in games] == [True, False]


def test_lanes_that_are_left_alone_fly_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Those of a run that is resumed, in one batch."""
    config = configured("evaluate", KERNELS, LOCKSTEP, "first_lane=5", agent="straight", games=4)
    report = made.evaluated(tmp_path / "run", *({"lane": lane} for lane in (6, 8)))
    asked: list[Any] = []

    def batch(*told: Any) -> Any:
        asked.append(told)
        return SimpleNamespace(game=str, close=lambda: asked.append("closed"))

    monkeypatch.setattr(evaluate_lanes, "GamesInBatch", batch)
    with Evaluation().open(config, "lockstep", report.run) as fly:
        assert str(fly(5)) == "5"
    assert asked == [(config, [5, 7]), "closed"]


LATER, FIRST = ([({"lane": lane}, {"host_wall_s": 1.0})] for lane in (8, 7))


def test_a_lanes_place_among_others_depends_on_it_alone() -> None:
    found = blocks([32, 33, 64, 31], np.array([0, 2, 3]))
    assert [(members.tolist(), rows.tolist()) for members, rows in found] == [([3], [31]), ([0], [0]), ([2], [0])]


def test_a_gpu_that_is_not_there_is_missed_before_a_run_begins(monkeypatch: pytest.MonkeyPatch) -> None:
    """Not before: a plan for another machine can be made here."""
    monkeypatch.setattr(th.cuda, "is_available", lambda: False)
    config = configured("evaluate", KERNELS, LOCKSTEP, "device=cuda", agent="straight")
    with pytest.raises(UserError, match=r"device = cuda: (needs numba-cuda|PyTorch finds no GPU)") as raised:
        Evaluation().provenance(config)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        (["environments=3"], "environments = 3 flies in processes of its own"),
        ([KERNELS, LOCKSTEP], "simulator = kernels flies all lanes as one batch"),
    ],
)
def test_more_processes_around_a_batch_are_refused(keys: list[str], said: str) -> None:
    config = configured("evaluate", *keys)
    with pytest.raises(UsageError, match=f"^{re.escape(f'--jobs must be 1 with evaluate: {said}')}$"):
        check_jobs(Evaluation(), config, 2)
    check_jobs(Evaluation(), config, 1)
    check_jobs(Evaluation(), configured("evaluate", agent="straight"), 2)
    assert Evaluation().renders(config) == (KERNELS not in keys)
