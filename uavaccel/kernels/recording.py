"""Work on a GPU that is recorded as a CUDA graph, without garbage collection, which would invalidate it."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import torch as th

EAGER = 2  # runs before recording, in which kernels are compiled and libraries choose their algorithms


@contextmanager
def recording(graph: th.cuda.CUDAGraph) -> Iterator[None]:
    """Record the launches within the context as `graph`.

    Garbage is collected before and not meanwhile: a graph or memory that is freed while another graph is recorded
    invalidates the recording (PyTorch's pull request 161037).
    """
    th.cuda.synchronize()
    gc.collect()
    collects = gc.isenabled()
    gc.disable()
    try:
        with th.cuda.graph(graph):
            yield
    finally:
        if collects:
            gc.enable()


def recorded(work: Callable[[], None], device: th.device) -> Callable[[], None]:
    """Return work that is recorded on a GPU, and done as it is elsewhere."""
    return Recorded(work) if device.type == "cuda" else work


class Recorded:
    """Work that makes the same calls on the same memory each time: run directly at first, then as one CUDA graph."""

    def __init__(self, work: Callable[[], None]) -> None:
        self._work, self._eager = work, EAGER
        self._graph: th.cuda.CUDAGraph | None = None

    def __call__(self) -> None:
        if self._eager:
            self._eager -= 1
            self._work()
            return
        if self._graph is None:
            self._graph = th.cuda.CUDAGraph()
            with recording(self._graph):
                self._work()
        self._graph.replay()
