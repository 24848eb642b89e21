"""Calls in parallel, in worker processes of this machine: joblib's own (loky), which is loaded where they begin."""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from uavaccel.errors import UsageError, UserError
from uavaccel.machine import usable_cores
from uavaccel.own_code import imported_code
from uavaccel.processes.lifetime import interrupts_kept_from_children, work_for_parent
from uavaccel.units import whole

LOKY = "loky"
MOST_JOBS_PER_CORE = 8  # where more would take memory, and wait for each other
Delayed = tuple[Callable[..., Any], tuple[object, ...], dict[str, object]]  # joblib's


def check_count(jobs: object, most: int | None = None) -> None:
    """Raise UsageError for a number of processes that is out of range: 1 to `most`, by default of this machine."""
    if (count := whole(jobs)) is None or count < 1:
        raise UsageError(f"--jobs {jobs}: must be 1 or more")
    if count > (most := most or MOST_JOBS_PER_CORE * usable_cores()):
        raise UsageError(f"--jobs {jobs}: must be at most {most} on this machine's {usable_cores()} cores")


def on_this_machine(jobs: int, batch: int, calls: Iterable[Delayed]) -> Iterator[Any]:
    """Yield the results of joblib's delayed calls, in order, from `jobs` processes that take `batch` calls at once.

    Raises UserError where a process is lost.
    """
    from joblib import Parallel, parallel_config
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    # workers of an earlier call serve again, unless code is another, or looked up in another folder, since
    bound = {"initializer": begin_worker, "initargs": (os.getpid(), tuple(sys.path), (Path.cwd(), imported_code()))}
    with parallel_config(backend=LOKY, inner_max_num_threads=1, **bound):
        ahead = f"{batch}*n_jobs"  # a longer queue would delay an interruption
        results: Any = None
        try:
            with interrupts_kept_from_children():  # while they import, before they leave Ctrl-C to this process
                results = Parallel(jobs, return_as="generator", pre_dispatch=ahead, batch_size=batch)(calls)
            for result in results:  # noqa: UP028  `yield from` would close them before, and loudly
                yield result
        except TerminatedWorkerError:
            raise UserError(
                "a worker process was killed, by its user or for memory; go on with --resume, perhaps with fewer --jobs"
            ) from None
        finally:
            if results is not None:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")  # of calls that an interruption cancels
                    results.close()


def begin_worker(parent: int, path: Sequence[str], state: object) -> None:
    """End with the parent from the start, before imports that take seconds, and find the modules that it finds.

    A worker of another `state` does not serve again.
    """
    work_for_parent(parent)
    sys.path[:] = path
