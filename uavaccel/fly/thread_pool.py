"""multiprocessing's ThreadPool on a simulated clock: its calls, on an executor whose threads take turns.

Python's own waits for its threads by pipes of the system, for which no simulated clock stops.
"""

from __future__ import annotations

import concurrent.futures
import multiprocessing
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from typing import Self

Options = Mapping[str, object] | None


class Result:
    """What calls come to: a list of them, or the only one's. Times are seconds of the script."""

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
        """Raises what a call raised, multiprocessing.TimeoutError where they take longer."""
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


class ThreadPool:
    """`multiprocessing.pool.ThreadPool`, for threads that take turns."""

    def __init__(
        self,
        processes: int | None = None,
        initializer: Callable[..., object] | None = None,
        initargs: Iterable[object] = (),
    ) -> None:
        begin = None if initializer is None else partial(initializer, *initargs)
        self._executor = concurrent.futures.ThreadPoolExecutor(
            processes or os.cpu_count() or 1, "ThreadPool", begin
        )

    def apply(
        self,
        func: Callable[..., object],
        args: Iterable[object] = (),
        kwds: Options = None,
    ) -> object:
        return self.apply_async(func, args, kwds).get()

    def apply_async(
        self,
        func: Callable[..., object],
        args: Iterable[object] = (),
        kwds: Options = None,
        callback: Callable[[object], object] | None = None,
        error_callback: Callable[[BaseException], object] | None = None,
    ) -> Result:
        future = self._executor.submit(func, *args, **(kwds or {}))
        return Result([future], True, callback, error_callback)

    def map(
        self, func: Callable[..., object], iterable: Iterable[object], chunksize: int | None = None
    ) -> object:
        return self.map_async(func, iterable).get()

    def map_async(
        self,
        func: Callable[..., object],
        iterable: Iterable[object],
        chunksize: int | None = None,
        callback: Callable[[object], object] | None = None,
        error_callback: Callable[[BaseException], object] | None = None,
    ) -> Result:
        return self.starmap_async(func, ((item,) for item in iterable), chunksize, callback, error_callback)

    def starmap(
        self, func: Callable[..., object], iterable: Iterable[Iterable[object]], chunksize: int | None = None
    ) -> object:
        return self.starmap_async(func, iterable).get()

    def starmap_async(
        self,
        func: Callable[..., object],
        iterable: Iterable[Iterable[object]],
        chunksize: int | None = None,
        callback: Callable[[object], object] | None = None,
        error_callback: Callable[[BaseException], object] | None = None,
    ) -> Result:
        futures = [self._executor.submit(func, *items) for items in iterable]
        return Result(futures, False, callback, error_callback)

    def imap(
        self, func: Callable[..., object], iterable: Iterable[object], chunksize: int = 1
    ) -> Iterator[object]:
        return self._executor.map(func, iterable)

    def imap_unordered(
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

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.terminate()
