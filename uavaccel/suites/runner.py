"""Flies the cases of a suite into a run directory: in order, over processes where the timing allows, resumable."""

from __future__ import annotations

import os
import signal
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from joblib import Parallel, delayed, parallel_config

from uavaccel.clock import MonotonicClock
from uavaccel.records import RunDirectory
from uavaccel.suites.experiment import Experiment
from uavaccel.units import NS_PER_S
from uavaccel.wire.session import Session, open_session


class AnyCase(Protocol):
    """What the runner needs of a case."""

    @property
    def id(self) -> str: ...

    @property
    def timing(self) -> str: ...

    def simulated_s(self) -> float: ...


Row = dict[str, Any]
Arrays = dict[str, np.ndarray]
RunCase = Callable[[Any, Any, Session], tuple[Row, Arrays]]


class Suite(NamedTuple):
    """A suite: where its games take place, and how one is flown."""

    scene: str
    run_case: RunCase


class Flown(NamedTuple):
    """A finished game, and what it took on this machine."""

    row: Row
    arrays: Arrays
    host: dict[str, Any]


OnFlown = Callable[[AnyCase, Row], None]


def run_cases(
    suite: Suite,
    config: Experiment,
    cases: Sequence[AnyCase],
    run: RunDirectory,
    jobs: int,
    on_flown: OnFlown,
) -> None:
    """Fly the cases that have no row yet and append their rows in the order of `cases`.

    Games on the machine's own clock are flown one by one, whatever `jobs`, since neighbours would spoil them.
    """
    done = run.done_cases()
    left = [case for case in cases if case.id not in done]
    for timing, group in _by_timing(left):
        flown = _fly_one_by_one if timing == "wall" or jobs == 1 else _fly_in_parallel
        for case, game in zip(group, flown(suite, config, group, timing, jobs), strict=True):
            game.row["arrays"] = run.save_arrays(case.id, game.arrays)
            run.append_row(game.row)
            run.append_timing({"case": case.id, **game.host})
            on_flown(case, game.row)


def _by_timing(cases: Iterable[AnyCase]) -> Iterator[tuple[str, list[AnyCase]]]:
    """Runs of neighbours that share a timing, so that order is kept."""
    group: list[AnyCase] = []
    for case in cases:
        if group and group[-1].timing != case.timing:
            yield group[0].timing, group
            group = []
        group.append(case)
    if group:
        yield group[0].timing, group


def _fly_one_by_one(
    suite: Suite, config: Experiment, cases: Sequence[AnyCase], timing: str, jobs: int
) -> Iterator[Flown]:
    with open_session(timing, config.profile, suite.scene, config.latency) as session:
        for case in cases:
            yield fly_case(suite, config, case, session)


def _fly_in_parallel(
    suite: Suite, config: Experiment, cases: Sequence[AnyCase], timing: str, jobs: int
) -> Iterator[Flown]:
    with parallel_config(backend="loky", inner_max_num_threads=1):
        parallel = Parallel(n_jobs=jobs, return_as="generator", pre_dispatch="4*n_jobs", batch_size=4)
        games = parallel(delayed(_fly_in_worker)(suite, config, case, timing) for case in cases)
        try:
            for game in games:  # noqa: UP028  `yield from` would close them before, and loudly
                yield game
        finally:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # of games that an interruption cancels
                games.close()


_SESSIONS: dict[tuple[str, str, str], Session] = {}


def _fly_in_worker(suite: Suite, config: Experiment, case: AnyCase, timing: str) -> Flown:
    """Fly a case in this worker process, which keeps its session; Ctrl-C is the parent's to handle."""
    key = (timing, config.profile, suite.scene)
    if key not in _SESSIONS:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        _SESSIONS[key] = open_session(*key, config.latency)
    return fly_case(suite, config, case, _SESSIONS[key])


def fly_case(suite: Suite, config: Experiment, case: AnyCase, session: Session) -> Flown:
    """Fly one case and note the host's time and load, which are never the same twice."""
    clock = MonotonicClock()
    start_ns = clock.now_ns()
    row, arrays = suite.run_case(config, case, session)
    host = {"host_wall_s": (clock.now_ns() - start_ns) / NS_PER_S, "load": os.getloadavg()[0]}
    return Flown(row, arrays, host)
