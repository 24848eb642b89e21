"""`uavaccel.kernels.cuda` without a GPU: the same launches, on PyTorch's CPU tensors, by the CPU's own machine code.

So what is tensors about lanes on a GPU, and what stands on them, is tested where there is none.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from importlib import import_module
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
import pytest
import torch as th

import uavaccel.envs
import uavaccel.kernels
from uavaccel.kernels import events
from uavaccel.kernels.cpu import CPU, DVS, SAMPLE_FIELDS, STATE, Command, View
from uavaccel.kernels.fields import NO_LOOKS
from uavaccel.vision.dvs import PRESETS
from uavaccel.vision.dvs_sensor import draw_pixels

NAME, ABOVE = "uavaccel.kernels.cuda", ("cuda_lanes", "cuda_batch")
NO_PIXELS = events.pixels_of(0, PRESETS["clean"])


class Plan(NamedTuple):
    hull: Any
    texels: Any
    textures: Any
    looks: Any
    sensor: Any


class Kernels:
    """Each kernel as an attribute; `kernel[grid](flags of lanes, ...)` runs at once."""

    def __init__(self) -> None:
        self._nothing = View(
            STATE, NO_LOOKS, events.sensor_of(draw_pixels(PRESETS["clean"], (144, 256), 0)), NO_PIXELS
        )

    def __getattr__(self, name: str) -> Any:
        work: Callable[..., None] = getattr(type(self), f"run_{name}")

        class Launch:
            def __getitem__(launch, grid: Any) -> Callable[..., None]:  # noqa: N805 - `self` is the kernels
                return lambda which, *arguments: work(self, np.flatnonzero(which), *arguments)

        return Launch()

    def run_begin(self, lanes: Any, rows: Any, games: Any, now: Any) -> None:
        self._hull = np.zeros(3)
        CPU.look_at_starts(games, rows[lanes])
        CPU.begin(lanes, rows[lanes], self._nothing, games, now, self._of(0, 1))

    def run_command(self, lanes: Any, directions: Any, games: Any, now: Any) -> None:
        self._directions = directions

    def run_fly(self, lanes: Any, ticks: Any, games: Any, now: Any, hull: Any) -> None:
        self._hull = hull
        frames = np.empty((0, 1, 1, 0, 0), np.uint8)
        self._fly(lanes, self._of(int(ticks[0]), 1), self._nothing, games, now, frames)

    def run_project(self, lanes: Any, *_: Any) -> None:
        """What draws does."""

    def run_start(
        self, lanes: Any, faces: Any, shown: Any, plan: Any, games: Any, now: Any, pixels: Any
    ) -> None:
        view = View(DVS, plan.looks, plan.sensor, pixels)
        CPU.begin(lanes, now.game[lanes], view, games, now, self._of(0, 1))

    def run_see(
        self,
        lanes: Any,
        tick_ns: int,
        take: int,
        faces: Any,
        shown: Any,
        plan: Any,
        games: Any,
        now: Any,
        pixels: Any,
        frames: Any,
    ) -> None:
        assert take
        frames[lanes] = 128
        view = View(DVS, plan.looks, plan.sensor, pixels)
        self._fly(lanes, self._of(0, tick_ns), view, games, now, frames[:, None, None])

    run_find = run_project

    def run_note(self, lanes: Any, *_: Any) -> None:
        """What sees does."""

    def run_show(
        self,
        lanes: Any,
        kind: int,
        tick_ns: int,
        faces: Any,
        shown: Any,
        plan: Any,
        games: Any,
        now: Any,
        frames: Any,
    ) -> None:
        frames[lanes] = 0
        view = View(kind, plan.looks, plan.sensor, NO_PIXELS)
        self._fly(lanes, self._of(0, tick_ns), view, games, now, frames[:, None])

    def _of(self, ticks: int, tick_ns: int) -> Command:
        return Command(np.array([ticks]), 0, tick_ns, self._hull)

    def _fly(self, lanes: Any, plan: Command, view: View, games: Any, now: Any, frames: Any) -> None:
        samples = np.zeros((len(now.game), 1, SAMPLE_FIELDS))
        CPU.fly(lanes, self._directions, view, games, now, plan, frames, samples)


def shared(tensor: th.Tensor, dtype: Any = None) -> Any:
    array = tensor.numpy()
    return array if dtype is None else array.view(dtype).reshape(tensor.shape[0])


def on_device(arrays: Any, device: th.device) -> tuple[Any, Any]:
    if not isinstance(arrays, np.ndarray):
        pairs = [on_device(each, device) for each in arrays]
        return type(arrays)(*(pair[0] for pair in pairs)), type(arrays)(*(pair[1] for pair in pairs))
    if arrays.dtype.names:
        rows = np.ascontiguousarray(arrays).view(np.uint8).reshape(len(arrays), arrays.dtype.itemsize)
        tensor = th.from_numpy(rows.copy())
        return tensor, shared(tensor, arrays.dtype)
    plain = arrays.view(np.int32) if arrays.dtype == np.uint32 else arrays
    tensor = th.from_numpy(np.array(plain, order="C"))
    return tensor, shared(tensor).view(arrays.dtype)


def _size(name: str) -> int:
    """Of grids and rooms, of which nothing here makes use."""
    if not name.isupper():
        raise AttributeError(name)
    return 1


@pytest.fixture
def host_kernels(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """`CudaLanes` and `CudaBatch` on "cpu"."""
    module = ModuleType(NAME)
    functions = {"shared": shared, "on_device": on_device, "stream": lambda: None, "__getattr__": _size}
    module.__dict__.update(functions, Plan=Plan, compiled=lambda usual: Kernels())
    monkeypatch.setitem(sys.modules, NAME, module)
    monkeypatch.setattr(uavaccel.kernels, "cuda", module, raising=False)
    _forget()
    monkeypatch.setattr(import_module("uavaccel.envs.cuda_batch"), "DEVICE", "cpu")
    yield
    _forget()


def _forget() -> None:
    for name in ABOVE:
        sys.modules.pop(f"uavaccel.envs.{name}", None)
        vars(uavaccel.envs).pop(name, None)
