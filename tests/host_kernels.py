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
from uavaccel.kernels import cpu, lanes
from uavaccel.kernels.fields import COLUMNS, ROWS
from uavaccel.kernels.spans import make_desk

NAME = "uavaccel.kernels.cuda"
ABOVE = ("envs.cuda_lanes", "envs.cuda_batch", "rl.device_replay", "rl.device_dqn")


class Plan(NamedTuple):
    hull: Any
    texels: Any
    textures: Any
    looks: Any
    sensor: Any


class Kernels:
    """Each kernel as an attribute; `kernel[grid](flags of lanes, ...)` runs at once."""

    def __init__(self) -> None:
        self._desk, self._picture = make_desk(), np.empty((ROWS, COLUMNS), np.uint8)

    def __getattr__(self, name: str) -> Any:
        work: Callable[..., None] = getattr(type(self), f"run_{name}")

        class Launch:
            def __getitem__(launch, grid: Any) -> Callable[..., None]:  # noqa: N805 - `self` is the kernels
                return lambda which, *arguments: work(self, np.flatnonzero(which).tolist(), *arguments)

        return Launch()

    def run_begin(self, which: Any, rows: Any, games: Any, now: Any) -> None:
        for lane in which:
            lanes.begin(lane, rows[lane], games, now)
            lanes.look(games.parameters[rows[lane]], now.state[lane], now.body[lane])

    def run_command(self, which: Any, directions: Any, games: Any, now: Any) -> None:
        for lane in which:
            lanes.command(lane, directions, games, now)

    def run_fly(self, which: Any, ticks: Any, games: Any, now: Any, hull: Any) -> None:
        for lane in which:
            lanes.fly(lane, int(ticks[lane]), games, now, hull)

    def run_start(
        self, which: Any, faces: Any, shown: Any, plan: Any, games: Any, now: Any, pixels: Any
    ) -> None:
        for lane in which:
            cpu.draw_gray(lane, plan.looks, games, now, 1, self._desk, self._picture)
            cpu.start_single(lane, self._picture, pixels, plan.sensor, games.cameras[now.game[lane]])

    def run_see_noise(
        self, which: Any, tick_ns: int, take: int, faces: Any, shown: Any, plan: Any, *of_lanes: Any
    ) -> None:
        games, now, pixels, frames = of_lanes
        assert take
        for lane in which:
            frames[lane] = 128
            if lanes.touched(lane, now):
                continue
            game = now.game[lane]
            cpu.draw_gray(lane, plan.looks, games, now, tick_ns, self._desk, self._picture)
            time_s = cpu.moment_ns(lane, now, tick_ns) * cpu.NS
            seed = games.seeds[game, lanes.EVENT_SEED]
            cpu.see_single(lane, self._picture, time_s, pixels, plan.sensor, games.cameras[game], seed)
            cpu.take_events(lane, pixels, frames[lane][None])

    def run_show(
        self, which: Any, kind: int, tick_ns: int, faces: Any, shown: Any, plan: Any, *of_lanes: Any
    ) -> None:
        games, now, frames = of_lanes
        for lane in which:
            frames[lane] = 0
            if lanes.touched(lane, now):
                continue
            if kind == cpu.COLOUR:
                cpu.draw_colour(lane, plan.looks, games, now, tick_ns, self._desk, frames[lane])
            else:
                cpu.draw_depth(lane, plan.looks, games, now, self._desk, frames[lane])

    def run_nothing(self, which: Any, *_: Any) -> None:
        """What draws, or sees, does."""

    run_project = run_find = run_note = run_see = run_nothing


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
        room, _, module = f"uavaccel.{name}".rpartition(".")
        sys.modules.pop(f"{room}.{module}", None)
        vars(sys.modules.get(room, uavaccel.envs)).pop(module, None)
