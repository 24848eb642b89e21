"""The assignment of GPUs to processes: each takes one, and its share of the cores, whichever run started it."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TextIO, TypeVar

from uavaccel.config import MOST_PROCESSES

VISIBLE, EGL_DEVICE = "CUDA_VISIBLE_DEVICES", "MUJOCO_EGL_DEVICE_ID"

Opened = TypeVar("Opened")

_place: TextIO | None = None  # held as long as this process lives


def acquire_gpu(device: str) -> None:
    """Assign a free GPU to this process and those that it starts, where `device` is `cuda` and there are several.

    GPUs are claimed by locks on files in the temporary folder, so that processes of different runs share them, and a
    GPU is free again however its process ended. Call it before CUDA's first use, which fixes the visible GPUs.
    """
    import torch as th

    if device != "cuda" or _place is not None or th.cuda.is_initialized():
        return
    visible = visible_gpus()
    if len(visible) < 2:
        return
    place = _acquire_slot() % len(visible)
    gpu = visible[place]
    os.environ[VISIBLE] = gpu
    _stay_on_cores(place, len(visible))
    if gpu.isdigit():
        os.environ.setdefault(EGL_DEVICE, gpu)


@contextmanager
def on_own_gpu(opened: Opened, device: str) -> Iterator[Opened]:
    """Yield what `Suite.open` opens, in a process that has a GPU of its own from now on, as `acquire_gpu` says."""
    acquire_gpu(device)
    yield opened


def _stay_on_cores(share: int, shares: int) -> None:
    """Restrict this process to its share of the cores, so that it does not slow the other GPUs' processes down."""
    if not hasattr(os, "sched_setaffinity"):  # Linux alone has it
        return
    cores = sorted(os.sched_getaffinity(0))
    if len(cores) >= 2 * shares:
        size = len(cores) // shares
        os.sched_setaffinity(0, cores[share * size : (share + 1) * size])


def visible_gpus() -> list[str]:
    """Return the GPUs of this process, as CUDA_VISIBLE_DEVICES names them."""
    if named := os.environ.get(VISIBLE):
        return [name.strip() for name in named.split(",") if name.strip()]
    import torch as th

    return [str(number) for number in range(th.cuda.device_count())]


def _acquire_slot() -> int:
    """Return the first place that no other process holds."""
    import fcntl  # not on Windows

    global _place
    folder = Path(tempfile.gettempdir()) / f"uavaccel-gpus-{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    for number in range(MOST_PROCESSES):
        _place = (folder / str(number)).open("a")
        with suppress(BlockingIOError):
            fcntl.flock(_place, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return number
        _place.close()
    _place = None
    return 0
