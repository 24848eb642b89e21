"""The kernels of a GPU, thread by thread, in Python, on the arrays of `tests.host_kernels`.

Threads of a block run in turns, each until it waits for the others of its warp or of its block.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable, Collection
from copy import deepcopy
from functools import cache, partial
from importlib import import_module
from types import CellType, FunctionType, ModuleType, SimpleNamespace
from typing import Any, ClassVar

import numba
import numpy as np
import pytest
from greenlet import greenlet
from numba import typeof
from numba.np.numpy_support import as_dtype

import uavaccel.kernels
from tests import host_kernels

WARP, OURS = 32, ("cuda", "cuda_views")
DEALING_THREADS = 4  # fewer than a GPU's, so that each has several shapes


class Thread:
    """A thread of a block; `asked` is what it waits for, with a value of its own."""

    asked: Any = None
    answer: Any = None
    arrays = 0

    def __init__(self, number: int, work: Callable[[], None]) -> None:
        self.number, self._running = number, greenlet(work)

    def turn(self) -> bool:
        """Run on; whether it waits again."""
        self._running.switch()
        return not self._running.dead

    def wait(self, *asked: Any) -> Any:
        self.asked = asked
        self._running.parent.switch()
        return self.answer


class Gpu(ModuleType):
    """`numba.cuda` as kernels know it."""

    now: Thread

    def __init__(self) -> None:
        super().__init__("numba.cuda")
        self.atomic = SimpleNamespace(add=self._add, max=np.maximum.at)
        self.shared, self.local = SimpleNamespace(array=self._shared), SimpleNamespace(array=self._room)
        self.syncthreads = self.syncwarp = lambda *_: self.now.wait("sync", None)
        self.any_sync = lambda _, value: self.now.wait("any", bool(value))
        self.ballot_sync = lambda _, value: self.now.wait("ballot", bool(value))
        self.shfl_xor_sync = lambda _, value, distance: self.now.wait("shuffle", value, int(distance))
        self.grid = lambda _: self.blockIdx.x * self._size + self.threadIdx.x
        self.ffs = lambda bits: int(bits & -bits).bit_length()
        self.jit = lambda function=None, **_: function or (lambda function: function)

    def launch(self, kernel: Any, blocks: Any, size: int, some: Any, arguments: tuple[Any, ...]) -> None:
        """Run `some` threads of these blocks of a size."""
        for block in blocks:
            self.blockIdx, self._size, self._arrays = SimpleNamespace(x=block), size, dict[int, Any]()
            left = [Thread(number, partial(np.errstate(all="ignore")(kernel), *arguments)) for number in some]
            while left:
                left = [thread for thread in left if self._turn(thread)]
                for warp in {thread.number // WARP for thread in left}:
                    self._answer([thread for thread in left if thread.number // WARP == warp])

    def _answer(self, warp: list[Thread]) -> None:
        values: dict[int, Any] = {thread.number: thread.asked[1] for thread in warp}
        for thread in warp:
            match thread.asked:
                case "any", _:
                    thread.answer = any(values.values())
                case "ballot", _:
                    bits = sum(1 << number % WARP for number, value in values.items() if value)
                    thread.answer = bits - (bits >> 31 << 32)
                case "shuffle", _, distance:
                    thread.answer = values[thread.number ^ distance]

    def _turn(self, thread: Thread) -> bool:
        self.now, self.threadIdx, self.laneid = thread, SimpleNamespace(x=thread.number), thread.number % WARP
        return thread.turn()

    def _add(self, array: Any, place: Any, value: Any) -> Any:
        before = array[place]
        array[place] = before + value
        return before

    def _room(self, shape: Any, kind: Any) -> Any:
        return np.zeros(shape, as_dtype(kind)).view(np.recarray if as_dtype(kind).names else np.ndarray)

    def _shared(self, shape: Any, kind: Any) -> Any:
        self.now.arrays += 1
        return self._arrays.setdefault(self.now.arrays, self._room(shape, kind))


class Numbers(ModuleType):
    """NumPy, whose integers are Python's: those of kernels with 32 bits take negative constants."""

    uint32 = uintp = staticmethod(lambda value: int(value) & 0xFFFFFFFF)
    int32 = staticmethod(lambda value: (int(value) + 0x80000000 & 0xFFFFFFFF) - 0x80000000)
    __getattr__ = staticmethod(partial(getattr, np))


class Names:
    """A module of names, `__dict__`, which may still be added to."""


class Choosers(dict[Any, Any]):
    """What kernels overload functions with, as `numba.cuda.extending` is told."""

    def overload(self, function: Any) -> Any:
        return lambda chooser: self.setdefault(function, chooser)

    def in_python(self, found: Any, known: dict[str, Any]) -> Any:
        """A compiled function, or a module of them, with all that it calls, as Python runs it."""
        function: Any = getattr(found, "py_func", found)
        name = str(getattr(found, "__name__" if isinstance(found, ModuleType) else "__module__", ""))
        if not name.startswith(("uavaccel.kernels", "uavaccel.sim", "uavaccel.vision")):
            return found
        if isinstance(found, ModuleType):
            (module := Names()).__dict__ = self.names_of(name, known)
            return module
        if not isinstance(function, FunctionType):
            return found
        if function in self:
            return lambda *of: self.in_python(self[function](*map(typeof, of)), known)(*of)
        cells = tuple(CellType(self.in_python(cell.cell_contents, known)) for cell in function.__closure__ or ())
        names = self.names_of(function.__module__, known)
        return FunctionType(function.__code__, names, function.__name__, function.__defaults__, cells)

    def names_of(self, module: str, known: dict[str, Any]) -> dict[str, Any]:
        if module not in known:
            names = known[module] = {**vars(import_module(module)), "np": Numbers("numpy")}
            names.update({name: self.in_python(each, known) for name, each in [*names.items()] if name[:2] != "__"})
        found: dict[str, Any] = known[module]
        return found


@cache
def kernels_in_python() -> tuple[Gpu, dict[str, Any]]:
    """A GPU, and the names of `uavaccel.kernels.cuda` as it runs them."""
    gpu, choosers, numbers = Gpu(), Choosers(), SimpleNamespace(fmul_rn=np.multiply, dmul_rn=np.multiply)
    caching = SimpleNamespace(caching=SimpleNamespace(IndexDataCacheFile=type("File", (), {})))
    modules = {"": gpu, ".libdevice": numbers, ".extending": choosers, ".core": caching}
    with pytest.MonkeyPatch.context() as patch:
        for name, module in {f"numba.cuda{name}": each for name, each in modules.items()}.items():
            patch.setitem(sys.modules, name, module)
        patch.setattr(numba, "cuda", gpu, raising=False)
        patch.setattr(gpu, "libdevice", numbers, raising=False)
        for name in OURS:
            patch.setitem(sys.modules, f"uavaccel.kernels.{name}", gpu)
            patch.delitem(sys.modules, f"uavaccel.kernels.{name}")
            patch.setattr(uavaccel.kernels, name, None, raising=False)
        for name in reversed(OURS):
            vars(import_module(f"uavaccel.kernels.{name}"))["DEALING_THREADS"] = DEALING_THREADS
        return gpu, choosers.names_of("uavaccel.kernels.cuda", {})


class Memory(np.ndarray):
    """An array whose last index may exceed its bounds, where the others are 0."""

    def __getitem__(self, key: Any) -> Any:
        return super().__getitem__(key) if self._is_within(key) else self.view(np.ndarray).reshape(-1)[key[-1]]

    def __setitem__(self, key: Any, value: Any) -> None:
        if self._is_within(key):
            super().__setitem__(key, value)
        else:
            self.view(np.ndarray).reshape(-1)[key[-1]] = value

    def _is_within(self, key: Any) -> bool:
        return not isinstance(key, tuple) or len(key) != self.ndim or any(key[:-1])


def leaves(tree: Any) -> list[np.ndarray]:
    """All arrays of nested tuples."""
    if isinstance(tree, np.ndarray):
        return [tree[name] for name in tree.dtype.names] if tree.dtype.names else [tree]
    return [leaf for each in tree for leaf in leaves(each)] if isinstance(tree, tuple) else []


def given(tree: Any, copies: dict[Any, Any] | None) -> Any:
    """What a kernel is given, as Python reads it: records have attributes; or copies, of shared memory one."""
    if isinstance(tree, tuple):
        parts = [given(each, copies) for each in tree]
        return type(tree)(*parts) if hasattr(tree, "_fields") else tuple(parts)
    if not isinstance(tree, np.ndarray):
        return tree
    array = tree if copies is None else copies.setdefault((tree.ctypes.data, tree.shape, tree.dtype), tree.copy())
    return array.view(np.recarray if array.dtype.names else Memory)


class Twice:
    """Launches of `host_kernels`, each of which the GPU's threads make on a copy first; what comes of it is compared.

    Of pictures they make a part: a thread block of each lane. A GPU has no clock, and no noise in a picture, yet where
    an event camera's threads have seen it.
    """

    PARTS: ClassVar = {  # of a lane's thread blocks, that which is run
        "find": (4, 1), "draw_gray": (36, 17), "see": (36, 17), "show": (18, 8),
        "start_events": (288, 133), "cast_depth": (288, 133),
    }  # fmt: skip
    SMALL: ClassVar = dict.fromkeys(("cast_colour", "cast_gray"), (3, 1))
    LOOKING = ("cast_colour", "cast_depth", "see_gray", "take_frames", "see", "show")
    compared: Counter[str]

    def __init__(self, nominal: Any, large: bool, left_out: Collection[str]) -> None:
        self._parts, self._left_out = self.PARTS if large else self.SMALL, {"add_colours", *left_out} - {"show"}
        self.gpu, names = kernels_in_python()
        self._sizes = {name: value for name, value in names.items() if name.isupper() and isinstance(value, int)}
        self._kernels = {"fly": names["flying"](nominal), "deal_clutter": names["deal_clutter"], **vars(names["views"])}
        self.compared = Counter()

    def put_into(self, patch: pytest.MonkeyPatch) -> None:
        """In place of the host's kernels, which still run."""
        module, made = sys.modules[host_kernels.NAME], host_kernels.Kernels.__getattr__
        others = {"grid": lambda threads, each: (-(-threads // each), each), "threads_a_lane": lambda *_: 4}
        for name, value in {**self._sizes, **others}.items():
            patch.setattr(module, name, value, raising=False)
        host_kernels._forget()  # what has read them
        patch.setattr(import_module("uavaccel.envs.cuda_batch"), "DEVICE", "cpu")

        class Launch(SimpleNamespace):
            def __getitem__(self, grid: Any) -> Any:
                return host_kernels.launch(partial(self.run, grid))[()]

        kernel = lambda host, name: Launch(run=partial(self._run, name, made(host, name)[()]))  # noqa: E731
        patch.setattr(host_kernels.Kernels, "__getattr__", kernel)

    def _run(self, name: str, on_host: Any, grid: Any, *arguments: Any) -> None:
        if name not in self._kernels or not grid or name in self._left_out:
            on_host(*arguments)
            return
        if name == "see":  # between samples, where events add up
            going, take, *rest = deepcopy(arguments)
            rest[-2].gathered[...] += 3
            self._compare(name, on_host, grid, (going, 1 - take, *rest))
        if name in self.LOOKING:  # one lane does not go, others have touched something and left events unread
            others = deepcopy(arguments)
            others[0][0] = 0
            for part in others:
                getattr(part, "gathered", np.zeros(0))[...] += 3
                getattr(part, "state", {})["collision_tick"] = 0
            self._compare(name, on_host, grid, others)
        if name == "start_events":
            for left in arguments[-1]:  # by a game before
                left[arguments[0] > 0, ...] += 3
        self._compare(name, on_host, grid, arguments)

    def _compare(self, name: str, on_host: Any, grid: Any, arguments: Any) -> None:
        counts = name == "see_gray" and arguments[-1] != () and arguments[-1].counting
        alone = counts or name in ("project", "find", "look")  # which the host leaves out
        before, mine = given(arguments, {}), given(arguments, None if alone else {})
        every, part = self._parts.get(name, (1, 0))
        some = [each for each in range(grid[1]) if name != "show" or each % 64 in range(16, 32)]
        self.gpu.launch(self._kernels[name], range(part, grid[0], every), grid[1], some, mine)
        on_host(*arguments)
        for was, ours, theirs in zip(*map(leaves, (before, mine, arguments)), strict=True):
            seen = name in ("see", "see_gray", "finish") and ours.ndim == 1
            seen |= name in ("see_gray", "start_events") and ours.dtype == np.uint8
            if alone or seen or ours.dtype == np.uint64:  # a stream, of which each thread has its own
                continue
            kept = np.index_exp[:, :13] if name == "fly" and ours.shape[1:] == (25,) else ()  # no force, acceleration
            there = (ours != was)[kept] | ((theirs != was)[kept] & (every == 1))
            ours, theirs = ours[kept][there].astype(float), theirs[kept][there].astype(float)
            apart = np.abs(ours - theirs) > (1e-4 * (1.0 + np.abs(theirs)) if was.dtype.kind == "f" else 1.0)
            assert np.count_nonzero(apart) <= 0.02 * apart.size, (name, ours, theirs)
            self.compared[name] += apart.size
