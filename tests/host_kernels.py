"""`uavaccel.kernels.cuda` without a GPU: the same launches, on PyTorch's CPU tensors, by the CPU's own machine code.

So what is tensors about lanes on a GPU, and what stands on them, is tested where there is none.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from importlib import import_module
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import torch as th

import uavaccel.envs
import uavaccel.kernels
from tests.compiling import Alone, alone, kept
from uavaccel.envs.arrays import mapped
from uavaccel.kernels import clutter_games as _clutter_games
from uavaccel.kernels import cpu as _cpu
from uavaccel.kernels import events, lane_games
from uavaccel.kernels import lanes as _lanes
from uavaccel.kernels.clutter_games import put_clutter
from uavaccel.kernels.fields import COLOUR, COLUMNS, ROWS
from uavaccel.kernels.lane_clocks import LAUNCHED
from uavaccel.kernels.pictures import make_scratch
from uavaccel.sim.clutter import sample_clutter

SIZE = ROWS, COLUMNS
ON_A_GPU = bool(os.environ.get("UAVACCEL_TEST_GPU"))
SIGNED: dict[Any, Any] = {np.dtype(np.uint32): np.int32, np.dtype(np.uint64): np.int64}
NAME = "uavaccel.kernels.cuda"
ABOVE = {
    "uavaccel.envs": ("cuda_clocks", "cuda_games", "cuda_view", "cuda_lanes", "cuda_batch"),
    "uavaccel.rl": ("patches",),
}


class Late:
    """`SideStream` of a device that does nothing on it before the current one waits for it: as late as one can be."""

    current: list[Callable[[], None]] | None = None

    def __init__(self, priority: int = 0) -> None:
        self._left: list[Callable[[], None]] = []

    @contextmanager
    def following(self) -> Iterator[None]:
        Late.current = self._left
        yield
        Late.current = None

    def join(self) -> None:
        for run in self._left:
            run()
        self._left.clear()


class Immediate:
    """An event of a device that does at once what it is told."""

    def __getattr__(self, name: str) -> Any:
        return lambda *_: None


def launch(run: Callable[..., None]) -> Any:
    """`kernel[grid](...)` runs, on the present stream."""

    def start(*arguments: Any) -> None:
        if Late.current is None:
            run(*arguments)
        else:
            Late.current.append(partial(run, *arguments))

    class Launch:
        def __getitem__(self, grid: Any) -> Callable[..., None]:
            return start

    return Launch()


clutter_games, cpu, lanes = Alone(_clutter_games), Alone(_cpu), Alone(_lanes)


def _each_lane(part: Callable[..., None], which: Any, arguments: Any) -> None:
    for lane in np.flatnonzero(which):
        part(lane, *arguments)


@kept(error_model="numpy")
def paint(lane: int, looks: Any, games: Any, now: Any, scratch: Any, gray: Any) -> None:
    _cpu.paint(lane, looks, games, now, scratch, gray)


class Kernels:
    """Each kernel as an attribute; `kernel[grid](flags of lanes, ...)` runs at once."""

    def __init__(self) -> None:
        self._scratch, self._picture = alone(make_scratch)(), np.empty((ROWS, COLUMNS), np.uint8)
        self._levels: dict[int, Any] = {}  # sums of the colours that a lane has shown last
        self._seen: Any = None  # what the lane's pictures are drawn of next

    def __getattr__(self, name: str) -> Any:
        work: Any = getattr(type(self), f"run_{name}", None)
        if work is None:
            return launch(partial(_each_lane, alone(LAUNCHED[name])))
        return launch(lambda which, *arguments: work(self, np.flatnonzero(which).tolist(), *arguments))

    def run_deal_clutter(self, which: Any, distribution: Any, deals: Any, games: Any) -> None:
        for lane in which:
            clutter_games.deal(lane, distribution, deals, games)
            stream, goal = deals.streams[lane, lane_games.OF_LAYOUT], deals.goals[lane]
            alone(sample_clutter)(distribution.clutter, stream, goal[0], -goal[1], deals.layouts[lane])
            put_clutter(deals.layouts[lane], games.solids, games.scenes, lane)

    def run_fly(self, which: Any, ticks: Any, games: Any, now: Any, hull: Any, threads: int) -> None:
        for lane in which:
            lanes.fly(lane, int(ticks[lane]), games, now, hull)

    def run_project(self, which: Any, sky: bool, looks: Any, games: Any, now: Any, faces: Any) -> None:
        self._seen = looks, games, now._replace(state=now.state.copy())

    def run_draw_gray(self, which: Any, faces: Any, shown: Any, looks: Any, gray: Any) -> None:
        looks, games, now = self._seen
        self.run_cast_gray(which, looks, games, now, None, gray)

    def run_see(self, which: Any, take: int, faces: Any, shown: Any, looks: Any, sensor: Any, *of_lanes: Any) -> None:
        games, now, pixels, frames = of_lanes
        for lane in which:
            assert events.is_plain(games.cameras[now.game[lane]], pixels.filtered.size)
            cpu.render_gray(lane, looks, games, now, 1, self._scratch, self._picture)
            self._see(lane, self._picture, 1, sensor, games, now, pixels)
        if take:
            self.run_take_frames(which, now, pixels, frames)

    def _see(self, lane: int, gray: Any, tick_ns: int, sensor: Any, games: Any, now: Any, pixels: Any) -> None:
        if not lanes.touched(lane, now):
            game, time_s = now.game[lane], cpu.moment_ns(lane, now, tick_ns) * events.NS
            cpu.see(lane, gray, time_s, pixels, sensor, games.cameras[game], games.seeds[game, lanes.EVENT_SEED])

    def run_show(self, which: Any, kind: int, tick_ns: int, faces: Any, shown: Any, looks: Any, *of_lanes: Any) -> None:
        games, now, frames = of_lanes
        for lane in which:
            frames[lane] = 0
            if lanes.touched(lane, now):
                continue
            if kind == COLOUR:
                cpu.render_colour(lane, looks, games, now, tick_ns, self._scratch, SIZE, frames[lane])
                self._levels[lane] = self._scratch.channels.sum(axis=(1, 2))
            else:
                cpu.render_depth(lane, looks, games, now, self._scratch, SIZE, frames[lane])

    def run_add_colours(self, which: Any, faces: Any, shown: Any, looks: Any, sums: Any) -> None:
        for lane in which:
            sums[lane] = self._levels[lane]

    def run_cast_depth(self, which: Any, side: int, looks: Any, *of_lanes: Any) -> None:
        games, now, _, frames = of_lanes
        size = side * frames.shape[2], side * frames.shape[3]
        for lane in which:
            frames[lane] = 0
            if not lanes.touched(lane, now):
                cpu.render_depth(lane, looks, games, now, self._scratch, size, frames[lane])

    def run_cast_colour(self, which: Any, tick_ns: int, side: int, looks: Any, *of_lanes: Any) -> None:
        games, now, _, frames = of_lanes
        size = side * frames.shape[2], side * frames.shape[3]
        for lane in which:
            frames[lane] = 0
            if not lanes.touched(lane, now):
                cpu.render_colour(lane, looks, games, now, tick_ns, self._scratch, size, frames[lane])

    def run_cast_gray(self, which: Any, looks: Any, games: Any, now: Any, eyes: Any, gray: Any) -> None:
        for lane in which:
            paint(lane, looks, games, now, self._scratch, gray[lane])

    def run_start_events(self, which: Any, gray: Any, sensor: Any, games: Any, now: Any, pixels: Any) -> None:
        for lane in which:
            cpu.add_camera_noise(lane, games, now, 1, gray[lane])
            cpu.start(lane, gray[lane], pixels, sensor, games.cameras[now.game[lane]])

    def run_see_gray(self, which: Any, tick_ns: int, gray: Any, sensor: Any, *of_lanes: Any) -> None:
        games, now, pixels, rest = of_lanes
        for lane in which if rest == () or not rest.counting else ():  # it counts beforehand
            cpu.add_camera_noise(lane, games, now, tick_ns, gray[lane])
            self._see(lane, gray[lane], tick_ns, sensor, games, now, pixels)

    def run_take_frames(self, which: Any, now: Any, pixels: Any, frames: Any) -> None:
        for lane in which:
            frames[lane] = 128
            if not lanes.touched(lane, now):
                cpu.pop_events(lane, pixels, frames[lane][None])

    def run_nothing(self, which: Any, *_: Any) -> None:
        """What draws, or sees, does."""

    run_find = run_finish = run_look = run_nothing


def shared(tensor: th.Tensor, dtype: Any = None) -> Any:
    array = tensor.numpy()
    return array if dtype is None else array.view(dtype).reshape(tensor.shape[0])


def in_each_lane(kernel: Any, which: th.Tensor, *arguments: Any) -> None:
    kernel[()](shared(which), arguments)


def on_device(arrays: Any, device: th.device) -> tuple[Any, Any]:
    if not isinstance(arrays, np.ndarray):
        pairs = [on_device(array, device) for array in arrays]
        return type(arrays)(*(pair[0] for pair in pairs)), type(arrays)(*(pair[1] for pair in pairs))
    if arrays.dtype.names:
        rows = np.ascontiguousarray(arrays).view(np.uint8).reshape(len(arrays), arrays.dtype.itemsize)
        tensor = th.from_numpy(rows.copy())
        return tensor, shared(tensor, arrays.dtype)
    plain = arrays.view(SIGNED.get(arrays.dtype, arrays.dtype))
    tensor = th.from_numpy(np.array(plain, order="C"))
    return tensor, shared(tensor).view(arrays.dtype)


def _size(name: str) -> Any:
    """Of grids and rooms, of which nothing here makes use."""
    if name == "grid":
        return lambda threads, per_block: (1, 1)
    if name == "threads_a_lane":
        return lambda lanes, device: 1
    if not name.isupper():
        raise AttributeError(name)
    return 1


def stand_in(patch: pytest.MonkeyPatch) -> None:
    """Let `CudaLanes` and `CudaBatch` fly on "cpu"."""
    module = ModuleType(NAME)
    functions = {each.__name__: each for each in (shared, on_device, in_each_lane)}
    module.__dict__.update(functions, SideStream=Late, compiled=lambda nominal: Kernels(), __getattr__=_size)
    patch.setitem(sys.modules, NAME, module)
    patch.setattr(uavaccel.kernels, "cuda", module, raising=False)
    patch.setattr(th.cuda, "Event", Immediate)
    _forget()
    patch.setattr(import_module("uavaccel.envs.cuda_batch"), "DEVICE", "cpu")
    lanes_of_a_gpu: Any = import_module("uavaccel.envs.cuda_lanes").CudaLanes
    finish = lanes_of_a_gpu._finish_commands

    def finish_in_place(self: Any, states: Any) -> None:
        """Into the memory of the first flight, as a graph does."""
        first = self.final_info
        finish(self, states)
        self.final_info = mapped(th.Tensor.copy_, first, self.final_info) if first else self.final_info

    patch.setattr(lanes_of_a_gpu, "_finish_commands", finish_in_place)


@pytest.fixture
def host_kernels(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    stand_in(monkeypatch)
    yield
    _forget()


@pytest.fixture
def a_gpu(request: pytest.FixtureRequest) -> None:
    """This machine's GPU, where UAVACCEL_TEST_GPU asks for it, or `host_kernels`."""
    if not ON_A_GPU:
        request.getfixturevalue("host_kernels")


def _forget() -> None:
    for room, names in ABOVE.items():
        for name in names:
            sys.modules.pop(f"{room}.{name}", None)
            vars(import_module(room)).pop(name, None)
