"""multiprocessing's ThreadPool on a simulated clock: a pool that submits its calls to an executor.

Python's own ThreadPool waits for its threads through pipes, which do not follow a simulated clock.
"""

from __future__ import annotations

import concurrent.futures
import multiprocessing.pool
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from typing import Any


class PoolResult:
    """The asynchronous result of a pool: the list of its calls' values, or the value of a `single` call.

    Time-outs are in seconds of the script's clock.
    """

    def __init__(
        self,
        futures: list[concurrent.futures.Future[object]],
        single: bool = False,
        callback: Callable[[object], object] | None = None,
        error_callback: Callable[[BaseException], object] | None = None,
    ) -> None:
        self._futures, self._single = futures, single
        self._tell, self._tell_error, self._left = callback, error_callback, len(futures)
        for future in futures:
            future.add_done_callback(self._done)

    def _done(self, future: concurrent.futures.Future[object]) -> None:
        self._left -= 1
        if self._left:
            return
        failed = next((error for each in self._futures if (error := each.exception())), None)
        if failed is None and self._tell is not None:
            self._tell(self.get())
        if failed is not None and self._tell_error is not None:
            self._tell_error(failed)

    def get(self, timeout: float | None = None) -> object:
        """Wait for the result. Raises a call's exception, or multiprocessing.TimeoutError after `timeout`."""
        self.wait(timeout)
        if not self.ready():
            raise multiprocessing.TimeoutError
        values = [future.result() for future in self._futures]
        return values[0] if self._single else values

    def wait(self, timeout: float | None = None) -> None:
        concurrent.futures.wait(self._futures, timeout)

    def ready(self) -> bool:
        return all(future.done() for future in self._futures)

    def successful(self) -> bool:
        if not self.ready():
            raise ValueError(f"{self!r} not ready")
        return not any(future.exception() for future in self._futures)


class ThreadPool(multiprocessing.pool.Pool):
    """`multiprocessing.pool.ThreadPool` on an executor; what a pool derives from these methods is Python's own."""

    def __init__(
        self,
        processes: int | None = None,
        initializer: Callable[..., object] | None = None,
        initargs: Iterable[object] = (),
    ) -> None:
        begin = None if initializer is None else partial(initializer, *initargs)
        self._executor = concurrent.futures.ThreadPoolExecutor(processes or os.cpu_count() or 1, "ThreadPool", begin)
        self._state, self._pool = multiprocessing.pool.CLOSE, ()  # it has no workers of its own to end

    def _check_running(self) -> None:
        pass

    def apply_async(  # type: ignore[override]
        self,
        func: Callable[..., object],
        args: Iterable[object] = (),
        kwds: Mapping[str, object] | None = None,
        callback: Callable[[object], object] | None = None,
        error_callback: Callable[[BaseException], object] | None = None,
    ) -> PoolResult:
        future = self._executor.submit(func, *args, **(kwds or {}))
        return PoolResult([future], True, callback, error_callback)

    def _map_async(
        self,
        func: Callable[..., object],
        iterable: Iterable[Any],
        mapper: object,
        chunksize: int | None = None,
        callback: Callable[[object], object] | None = None,
        error_callback: Callable[[BaseException], object] | None = None,
    ) -> PoolResult:
        """Submit the calls of map, starmap and their asynchronous variants."""
        starred = mapper is vars(multiprocessing.pool)["starmapstar"]
        futures = [self._executor.submit(func, *(item if starred else (item,))) for item in iterable]
        return PoolResult(futures, False, callback, error_callback)

    def imap(  # type: ignore[override]
        self, func: Callable[..., object], iterable: Iterable[object], chunksize: int = 1
    ) -> Iterator[object]:
        return self._executor.map(func, iterable)

    def imap_unordered(  # type: ignore[override]
        self, func: Callable[..., object], iterable: Iterable[object], chunksize: int = 1
    ) -> Iterator[object]:
        futures = [self._executor.submit(func, item) for item in iterable]
        return (future.result() for future in concurrent.futures.as_completed(futures))

    def close(self) -> None:
        self._executor.shutdown(wait=False)

    def terminate(self) -> None:
        self._executor.shutdown(wait=False, cancel_futures=True)

    def join(self) -> None:
        self._executor.shutdown(wait=True)
