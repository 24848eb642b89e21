"""Engines that fly cases in parallel, beside joblib's own processes: clusters of Ray and Dask.

Workers read the run's folder, so all of them must see it, and this package, under the same paths. Without a running
cluster (RAY_ADDRESS, DASK_SCHEDULER_ADDRESS) a local one of this machine's processes is started, on loopback.
"""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager

from uavaccel.errors import UsageError, UserError
from uavaccel.suites.suite import GameResult

LOKY = "loky"
PACKAGES = {"ray": "ray", "dask": "distributed"}
ENGINES = (LOKY, *PACKAGES)
Delayed = tuple[Callable[..., GameResult], tuple[object, ...], dict[str, object]]  # joblib's
AHEAD = 2  # batches per worker that are submitted at once


def check_engine(engine: str) -> None:
    """Raise UsageError for an unknown engine, UserError for one whose package is missing."""
    if engine not in ENGINES:
        raise UsageError(f"--engine {engine}: is unknown; there are {', '.join(ENGINES)}")
    package = PACKAGES.get(engine)
    if package is not None and importlib.util.find_spec(package) is None:
        raise UserError(f"--engine {engine}: needs the package {package}: pip install 'uavaccel[{engine}]'")


def on_cluster(engine: str, jobs: int, batch: int, calls: Sequence[Delayed]) -> Iterator[GameResult]:
    """Yield the results of joblib's delayed calls, in order, from `jobs` workers that take `batch` calls at once.

    Raises UserError where a worker is lost.
    """
    from joblib import Parallel, parallel_config

    clusters: dict[str, Callable[[int], AbstractContextManager[None]]] = {"ray": _ray, "dask": _dask}
    most = jobs * batch * AHEAD
    with (
        clusters[engine](jobs),
        parallel_config(backend=engine, n_jobs=jobs),
        Parallel(batch_size=batch) as parallel,  # which keeps its workers, with what they opened
    ):
        for first in range(0, len(calls), most):
            try:
                yield from parallel(calls[first : first + most])
            except Exception as error:
                if type(error).__module__.partition(".")[0] not in PACKAGES.values():
                    raise
                raise UserError(
                    f"a worker of {engine} was lost ({type(error).__name__}); go on with --resume"
                ) from error


@contextmanager
def _ray(jobs: int) -> Iterator[None]:
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
def _dask(jobs: int) -> Iterator[None]:
    from distributed import Client, LocalCluster

    if address := os.environ.get("DASK_SCHEDULER_ADDRESS"):
        with Client(address):
            yield
        return
    cluster = LocalCluster(
        n_workers=jobs, threads_per_worker=1, host="127.0.0.1", dashboard_address=None, silence_logs=50
    )
    with cluster, Client(cluster):
        yield
