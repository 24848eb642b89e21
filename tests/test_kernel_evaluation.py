"""Evaluations with `simulator: kernels`: the exact simulator's games where nothing is seen, said so everywhere."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch as th

from tests.host_kernels import host_kernels  # noqa: F401 - a fixture
from tests.running import configured, fly_into
from uavaccel.cli.result_commands import report
from uavaccel.config import to_yaml
from uavaccel.errors import UsageError, UserError
from uavaccel.records import RunDirectory
from uavaccel.suites.evaluation import lanes
from uavaccel.suites.evaluation.suite import Evaluation
from uavaccel.suites.runner import check_jobs

LOCKSTEP, KERNELS = "task.timing=lockstep", "simulator=kernels"
SHORT = "task.max_commands=14"


def evaluated(out: Path, *overrides: str, resume: bool = False, **options: Any) -> RunDirectory:
    config = configured("evaluate", LOCKSTEP, *overrides, **{"agent": "offset:1.5", "games": 5, **options})
    return fly_into(out, Evaluation(), config, resume)


def flown(run: RunDirectory) -> list[dict[str, Any]]:
    """Rows without who flew them, and without the paths of lost lanes, which the kernels do not keep."""
    return [
        {key: value for key, value in row.items() if key not in ("simulator", "path_m")} for row in run.rows()
    ]


def rows_of(run: RunDirectory) -> bytes:
    return (run.path / "rows.jsonl").read_bytes()


@pytest.mark.slow
def test_rows_are_the_exact_simulators_and_reports_say_who_flew(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    exact = evaluated(tmp_path / "exact", "task.difficulty.wind_m_s=3.0")
    other = evaluated(tmp_path / "kernels", KERNELS, "task.difficulty.wind_m_s=3.0")
    assert flown(other) == flown(exact)
    assert {row["simulator"] for row in other.rows()} == {"kernels"}
    assert "simulator" not in exact.rows()[0]
    for run in (exact, other):
        Evaluation().report(run).write()
    summary = other.read_json("summary.json")
    assert (summary["simulator"], summary["device"]) == ("kernels", "cpu")
    said = "modelled, simulator kernels on the CPU"
    assert said in (other.path / "report.md").read_text()
    assert "kernels" not in (exact.path / "report.md").read_text().split("## Provenance")[0]
    report([other.path, exact.path])
    assert str(other.path / "simulators.md") in capsys.readouterr().out
    page = (other.path / "simulators.md").read_text()
    assert (
        "on the 5 lanes that both flew: 5 end alike, won or lost, 5 with the same actions throughout" in page
    )
    assert page.index("mujoco (modelled)") < page.index(f"kernels ({said})")
    report([exact.path, exact.path])
    assert not (exact.path / "simulators.md").exists()


@pytest.mark.slow
def test_a_policys_games_are_the_same_whoever_flies_beside_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    keys: dict[str, Any] = {"agent": "default"}
    whole = evaluated(tmp_path / "whole", KERNELS, SHORT, "first_lane=30", games=6, **keys)
    assert len({tuple(row["actions"]) for row in whole.rows()}) > 1
    grown = evaluated(tmp_path / "grown", KERNELS, SHORT, "first_lane=30", games=2, **keys)
    monkeypatch.setattr(lanes, "MOST_LANES", 3)
    config = configured("evaluate", LOCKSTEP, KERNELS, SHORT, "first_lane=30", games=6, **keys)
    fly_into(grown.path, Evaluation(), config, resume=True)
    assert rows_of(grown) == rows_of(whole)


@pytest.mark.slow
@pytest.mark.usefixtures("host_kernels")
@pytest.mark.parametrize(
    ("agent", "keys"), [("default", []), ("offset:1.5", ["task.timing=virtual", "task.command=adsc"])]
)
def test_lanes_on_a_gpu_fly_and_decide_as_on_cores(
    agent: str, keys: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cores = evaluated(tmp_path / "cores", KERNELS, SHORT, *keys, agent=agent)
    from uavaccel.suites.evaluation import cuda

    monkeypatch.setattr(cuda, "DEVICE", "cpu")
    monkeypatch.setattr(lanes, "_open", lambda config, which: cuda.LanesOnGpu(config, which))
    th.set_num_threads(1)
    assert rows_of(evaluated(tmp_path / "gpu", KERNELS, SHORT, *keys, agent=agent)) == rows_of(cores)


def test_configurations_of_before_fly_in_the_exact_simulator() -> None:
    config = configured("evaluate", agent="straight")
    assert (config.simulator, config.device) == ("mujoco", "cpu")
    assert "simulator: mujoco\ndevice: cpu\n" in to_yaml(config)


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ([KERNELS, "task.timing=wall"], "simulator = kernels: timing wall needs a server of its own"),
        ([KERNELS, LOCKSTEP, "environments=2"], "environments needs simulator mujoco"),
        ([KERNELS, LOCKSTEP, "task.difficulty.scenery=forest"], "simulator = kernels: difficulty.scenery"),
        (["device=cuda"], "device = cuda: simulator = mujoco flies on the CPU"),
        (["simulator=airsim"], "simulator.*mujoco.*kernels"),
    ],
)
def test_what_the_kernels_do_not_fly_is_one_clear_line(
    overrides: list[str], message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(th.cuda, "is_available", lambda: False)
    with pytest.raises(UserError, match=message) as raised:
        configured("evaluate", *overrides, agent="straight")
    assert "\n" not in str(raised.value)


def test_a_gpu_that_is_not_there_is_missed_before_a_run_begins(monkeypatch: pytest.MonkeyPatch) -> None:
    """Not before: a plan for another machine can be made here."""
    monkeypatch.setattr(th.cuda, "is_available", lambda: False)
    config = configured("evaluate", KERNELS, LOCKSTEP, "device=cuda", agent="straight")
    with pytest.raises(UserError, match=r"device = cuda: (needs numba-cuda|PyTorch finds no GPU)") as raised:
        Evaluation().provenance(config)
    assert "\n" not in str(raised.value)


def test_more_processes_around_one_batch_are_refused() -> None:
    config = configured("evaluate", LOCKSTEP, KERNELS, agent="straight")
    said = "--jobs must be 1 with evaluate: simulator = kernels flies all lanes as one batch"
    with pytest.raises(UsageError, match=f"^{re.escape(said)}$"):
        check_jobs(Evaluation(), config, 2)
    assert not Evaluation().renders(configured("evaluate", LOCKSTEP, KERNELS))


def test_a_lanes_place_among_those_rated_together_depends_on_it_alone() -> None:
    ends = [32, 33, 64, 31]
    blocks = lanes.Blocks(ends).of(np.array([0, 2, 3]))
    assert [(members.tolist(), rows.tolist()) for members, rows in blocks] == [
        ([3], [31]),
        ([0], [0]),
        ([2], [0]),
    ]
