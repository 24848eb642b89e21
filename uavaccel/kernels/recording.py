"""Recording of CUDA graphs without garbage collection, which would invalidate them."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager

import torch as th


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
