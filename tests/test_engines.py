"""Engines: clusters fly the same bytes as one process; what is missing, lost or on the wall clock is said."""

from __future__ import annotations

import sys
from contextlib import contextmanager, nullcontext
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from joblib import delayed, register_parallel_backend
from joblib._parallel_backends import ThreadingBackend

from tests.running import configured
from uavaccel.cli.experiments import run_experiment
from uavaccel.errors import UserError
from uavaccel.suites import runner
from uavaccel.suites.dp1 import Dp1
from uavaccel.suites.runner import PACKAGES, check_engine, in_parallel, run_suite, start_run
from uavaccel.suites.session import RunRequest

SMALL = ("clock_speed=[50]", "rounds=[1]", "t_move_s=[1]", "games=3")


def flown(path: Path, jobs: int, engine: str) -> dict[str, bytes]:
    """All that a run of a few games leaves but its times and its manifest."""
    config = configured("dp1", *SMALL)
    run = start_run(Dp1(), config, path, {})
    run_suite(Dp1(), config, run, jobs, engine=engine)
    kept = [path / "rows.jsonl", *sorted((path / "arrays").iterdir())]
    return {str(file.relative_to(path)): file.read_bytes() for file in kept}


@pytest.fixture
def threads_as_ray(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ray's place taken by threads: what is ours of an engine, without one."""
    register_parallel_backend("ray", ThreadingBackend)
    monkeypatch.setattr(runner, "_ray", lambda jobs: nullcontext())
    monkeypatch.setattr(runner, "check_engine", lambda engine: None)


@pytest.mark.usefixtures("threads_as_ray")
def test_results_come_in_order_though_handed_out_in_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    """And one set of workers has all parts: to start them takes seconds each."""
    started: list[int] = []
    start = ThreadingBackend.configure

    def noted(self: ThreadingBackend, n_jobs: int = 1, *others: Any, **keys: Any) -> Any:
        started.append(n_jobs)
        return start(self, n_jobs, *others, **keys)

    monkeypatch.setattr(ThreadingBackend, "configure", noted)
    results: list[Any] = list(in_parallel("ray", 2, 2, (delayed(int)(number) for number in range(23))))
    assert (results, started) == (list(range(23)), [2])


@pytest.mark.usefixtures("threads_as_ray")
def test_cases_on_an_engine_have_the_bytes_of_one_process(tmp_path: Path) -> None:
    assert flown(tmp_path / "one", 1, "loky") == flown(tmp_path / "ray", 1, "ray")


@pytest.mark.usefixtures("threads_as_ray")
@pytest.mark.parametrize("engine", PACKAGES)
def test_workers_leave_what_they_opened_at_the_runs_end(
    engine: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Dask's outlive the run, Ray's end with it; threads of this process take the place of both."""
    entered: list[str] = []
    left: list[str] = []
    open_session = Dp1.open

    @contextmanager
    def noted(self: Dp1, config: Any, timing: str, run: Any) -> Any:
        entered.append(timing)
        with open_session(self, config, timing, run) as session:
            yield session
        left.append(timing)

    client = SimpleNamespace(nthreads=lambda: {"here": 1}, submit=lambda call, workers, pure: call())
    dask = {"Client": lambda address: nullcontext(client), "LocalCluster": None, "fire_and_forget": lambda sent: None}
    register_parallel_backend("dask", ThreadingBackend)
    monkeypatch.setitem(sys.modules, "distributed", SimpleNamespace(**dask))
    monkeypatch.setenv("DASK_SCHEDULER_ADDRESS", "tcp://there")
    monkeypatch.setattr(Dp1, "open", noted)
    ends: list[partial[None]] = []
    monkeypatch.setattr("atexit.register", lambda *call: ends.append(partial(*call)))
    flown(tmp_path / "run", 1, engine)
    for end in ends if engine == "ray" else []:
        end()
    assert set(left) == {"lockstep", "virtual"}
    assert sorted(left) == sorted(entered)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # of the engines' own
@pytest.mark.parametrize("engine", PACKAGES)
def test_a_local_cluster_flies_the_bytes_of_one_process(engine: str, tmp_path: Path) -> None:
    pytest.importorskip(PACKAGES[engine])
    assert flown(tmp_path / "one", 1, "loky") == flown(tmp_path / engine, 2, engine)


@pytest.mark.usefixtures("threads_as_ray")
def test_a_lost_worker_is_one_line_other_errors_are_raised() -> None:
    class WorkerCrashedError(Exception):
        __module__ = "ray.exceptions"

    def lost(error: Exception) -> None:
        raise error

    with pytest.raises(UserError, match=r"a worker of ray was lost .*--resume"):
        list(in_parallel("ray", 1, 1, [delayed(lost)(WorkerCrashedError())]))
    with pytest.raises(ZeroDivisionError):
        list(in_parallel("ray", 1, 1, [delayed(lost)(ZeroDivisionError())]))


def test_a_cluster_that_does_not_start_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    def init(**options: Any) -> None:
        raise Exception("The current node timed out during startup.\nMore.")

    modules = {"ray": SimpleNamespace(init=init), "ray.util.joblib": SimpleNamespace(register_ray=lambda: None)}
    for name, module in {**modules, "ray.util": SimpleNamespace()}.items():
        monkeypatch.setitem(sys.modules, name, module)
    with pytest.raises(UserError, match=r"^ray cannot be started or reached: The current node .* startup\.$"):
        list(in_parallel("ray", 1, 1, [delayed(int)(1)]))


def test_an_engine_that_is_unknown_or_missing_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    missing = r"needs distributed: pip install -e '/.*\[dask\]'"
    for engine, said in (("spark", "there are loky, ray, dask"), ("dask", missing)):
        with pytest.raises(UserError, match=said):
            check_engine(engine)


@pytest.mark.usefixtures("threads_as_ray")
def test_wall_games_are_said_to_fly_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = {"clock_speed": [50.0], "timing": "wall", "games": 1}
    run_experiment(RunRequest("dp1", options, SMALL[:3], out=tmp_path / "run", dry_run=True, engine="ray"))
    assert "on the wall clock fly alone" in capsys.readouterr().out
