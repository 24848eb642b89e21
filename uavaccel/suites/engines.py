"""Engines that fly cases in parallel: joblib's own processes (loky), and clusters of Ray and Dask.

Workers read the run's folder, so all of them must see it, and this package, under the same paths. Without a running
cluster (RAY_ADDRESS, DASK_SCHEDULER_ADDRESS) a local one of this machine's processes is started, on loopback.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from itertools import islice

from uavaccel.errors import UsageError, UserError
from uavaccel.processes.workers import LOKY, Delayed, on_this_machine
from uavaccel.resources import require
from uavaccel.suites.suite import GameResult

PACKAGES = {"ray": "ray", "dask": "distributed"}
ENGINES = (LOKY, *PACKAGES)
AHEAD = 2  # batches per worker that are submitted at once


def check_engine(engine: str) -> None:
    """Raise UsageError for an unknown engine, UserError for one whose package is missing."""
    if engine not in ENGINES:
        raise UsageError(f"--engine {engine}: is unknown; there are {', '.join(ENGINES)}")
    package = PACKAGES.get(engine)
    if package is not None:
        require(package, f"--engine {engine}", engine)


def in_parallel(
    engine: str, jobs: int, batch: int, calls: Iterable[Delayed], leave: Callable[[], None] = lambda: None
) -> Iterator[GameResult]:
    """Yield the results of joblib's delayed calls, in order, from `jobs` workers that take `batch` calls at once.

    Workers that outlive the run, Dask's on a cluster that goes on, call `leave` at its end. Raises UserError where a
    worker is lost.
    """
    if engine == LOKY:
        return on_this_machine(jobs, batch, calls)
    return _on_cluster(engine, jobs, batch, calls, leave)


def _on_cluster(
    engine: str, jobs: int, batch: int, calls: Iterable[Delayed], leave: Callable[[], None]
) -> Iterator[GameResult]:
    from joblib import Parallel, parallel_config

    clusters: dict[str, Callable[[int], AbstractContextManager[None]]] = {"ray": _ray, "dask": partial(_dask, leave)}
    waiting = iter(calls)
    with (
        clusters[engine](jobs),
        parallel_config(backend=engine, n_jobs=jobs),
        Parallel(batch_size=batch) as parallel,  # which keeps its workers, with what they opened
    ):
        while submitted := list(islice(waiting, jobs * batch * AHEAD)):
            try:
                yield from parallel(submitted)
            except Exception as error:
                if type(error).__module__.partition(".")[0] not in PACKAGES.values():
                    raise
                raise UserError(
                    f"a worker of {engine} was lost ({type(error).__name__}); go on with --resume"
                ) from error


@contextmanager
def _ray(jobs: int) -> Iterator[None]:
    """Join or start a cluster, whose worker processes are this run's own, and leave what they opened as they end."""
    import ray
    from ray.util.joblib import register_ray

    register_ray()
    own = {} if "RAY_ADDRESS" in os.environ else {"num_cpus": jobs, "_node_ip_address": "127.0.0.1"}
    try:
        ray.init(include_dashboard=False, log_to_driver=False, logging_level="error", **own)
    except Exception as error:  # Ray has no class of errors for it
        raise UserError(f"ray cannot be started or reached: {str(error).partition(chr(10))[0]}") from error
    try:
        yield
    finally:
        ray.shutdown()


@contextmanager
def _dask(leave: Callable[[], None], jobs: int) -> Iterator[None]:
    """Join a cluster, whose workers outlive the run, or start one, which ends with it."""
    from distributed import Client, LocalCluster, fire_and_forget

    if address := os.environ.get("DASK_SCHEDULER_ADDRESS"):
        with Client(address) as client:
            try:
                yield
            finally:
                for worker in client.nthreads():
                    fire_and_forget(client.submit(leave, workers=[worker], pure=False))
        return
    cluster = LocalCluster(
        n_workers=jobs, threads_per_worker=1, host="127.0.0.1", dashboard_address=None, silence_logs=50
    )
    with cluster, Client(cluster):
        yield
