"""Work on a GPU that is recorded as a CUDA graph, without garbage collection, which would invalidate it."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache

import torch as th

EAGER = 2  # runs before recording, in which kernels are compiled and libraries choose their algorithms


@contextmanager
def recording(graph: th.cuda.CUDAGraph) -> Iterator[None]:
    """Record the launches within the context as `graph`.

    Garbage is collected before and not meanwhile: a graph or memory that is freed while another graph is recorded
    invalidates the recording (PyTorch's pull request 161037).

    What is launched afterwards waits for the stream of the recording. On it PyTorch before 2.13 sets the place in the
    sequence of random numbers, which all graphs read, to 0 (CUDAGeneratorState::capture_prologue). On a GPU that others
    keep busy this could come after the graph's own place was set, and the graph then drew the first numbers again.
    """
    th.cuda.synchronize()
    gc.collect()
    collects = gc.isenabled()
    gc.disable()
    try:
        with th.cuda.graph(graph, stream=_stream()):
            yield
        th.cuda.synchronize()
    finally:
        if collects:
            gc.enable()


@cache
def _stream() -> th.cuda.Stream:
    """Return the stream that is recorded, whose many small kernels go before the large ones of rendering beside it."""
    return th.cuda.Stream(priority=-1)


def recorded(work: Callable[[], None], device: th.device) -> Callable[[], None]:
    """Return work that makes the same calls on the same memory each time: on a GPU, once recorded as a CUDA graph."""
    if device.type != "cuda":
        return work
    eager, graph = EAGER, th.cuda.CUDAGraph()

    def replay() -> None:
        nonlocal eager
        if eager > 0:
            eager -= 1
            work()
            return
        if eager == 0:
            eager = -1
            with recording(graph):
                work()
        graph.replay()

    return replay
