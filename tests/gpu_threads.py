"""The kernels of a GPU, thread by thread, in Python: what they read and write are the arrays of `tests.host_kernels`.

Threads of a block run in turns, each until it waits for the others of its warp or of its block.
"""

from __future__ import annotations

import sys
import threading
from collections import Counter
from collections.abc import Callable, Collection
from functools import cache, partial
from importlib import import_module
from types import CellType, FunctionType, ModuleType, SimpleNamespace
from typing import Any, ClassVar

import numba
import numpy as np
import pytest
from numba import typeof
from numba.np.numpy_support import as_dtype

import uavaccel.kernels
from tests import host_kernels

WARP = 32
OURS = ("cuda", "cuda_views")


class Thread:
    """One thread of a block, which runs while `turn` lets it; `asked` is what it waits for, with its own value."""

    def __init__(self, number: int, work: Callable[[], None], back: threading.Semaphore) -> None:
        self.number, self.asked, self.answer, self.arrays = number, (), None, 0  # type: ignore[var-annotated]
        self.over, self._back, self._go = False, back, threading.Semaphore(0)
        self.error: BaseException | None = None
        self._thread = threading.Thread(target=self._run, args=(work,), daemon=True)
        self._thread.start()

    def _run(self, work: Callable[[], None]) -> None:
        self._go.acquire()
        try:
            with np.errstate(all="ignore"):
                work()
        except BaseException as error:  # which the test raises
            self.error = error
        self.over = True
        self._back.release()

    def turn(self) -> None:
        self._go.release()
        self._back.acquire()
        if self.error is not None:
            raise self.error

    def wait(self, *asked: Any) -> Any:
        self.asked = asked
        self._back.release()
        self._go.acquire()
        return self.answer


class Gpu(ModuleType):
    """`numba.cuda` as kernels know it."""

    def __init__(self) -> None:
        super().__init__("numba.cuda")
        self.now: Any = None
        self.atomic = SimpleNamespace(add=self._add, max=self._max)
        self.shared, self.local = SimpleNamespace(array=self._shared), SimpleNamespace(array=self._room)
        self.libdevice = SimpleNamespace(fmul_rn=np.multiply, dmul_rn=np.multiply)

    def jit(self, function: Any = None, **options: Any) -> Any:
        return function or (lambda function: function)

    def launch(self, kernel: Any, blocks: Any, threads: int, arguments: tuple[Any, ...], some: Any = None) -> None:
        """Run these blocks, of so many threads; with `some`, only those threads of each."""
        for block in blocks:
            back, self.blockIdx, self._arrays = threading.Semaphore(0), SimpleNamespace(x=block), {}
            self._size, work = threads, lambda: kernel(*arguments)
            left = [Thread(number, work, back) for number in (range(threads) if some is None else some)]
            while left:
                for thread in left:
                    self.now, self.threadIdx = thread, SimpleNamespace(x=thread.number)
                    self.laneid = thread.number % WARP
                    thread.turn()
                left = [thread for thread in left if not thread.over]
                for warp in {thread.number // WARP for thread in left}:
                    self._answer([thread for thread in left if thread.number // WARP == warp])

    def _answer(self, warp: list[Thread]) -> None:
        (kind,) = {thread.asked[0] for thread in warp}
        values = {thread.number: thread.asked[1] for thread in warp}
        for thread in warp:
            if kind == "ballot":
                bits = sum(1 << number % WARP for number, value in values.items() if value)
                thread.answer = bits - (bits >> 31 << 32)
            elif kind == "any":
                thread.answer = any(values.values())
            elif kind == "shuffle":
                thread.answer = values[thread.number ^ thread.asked[2]]

    def grid(self, axes: int) -> int:
        return int(self.blockIdx.x * self._size + self.threadIdx.x)

    def syncthreads(self, *_: Any) -> None:
        self.now.wait("sync", None)

    syncwarp = syncthreads

    def ballot_sync(self, mask: int, value: Any) -> Any:
        return self.now.wait("ballot", bool(value))

    def any_sync(self, mask: int, value: Any) -> Any:
        return self.now.wait("any", bool(value))

    def shfl_xor_sync(self, mask: int, value: Any, distance: int) -> Any:
        return self.now.wait("shuffle", value, int(distance))

    def ffs(self, bits: Any) -> int:
        return (int(bits) & -int(bits)).bit_length()

    def _add(self, array: Any, place: Any, value: Any) -> Any:
        before = array[place]
        array[place] = before + value
        return before

    def _max(self, array: Any, place: Any, value: Any) -> None:
        array[place] = max(array[place], value)

    def _room(self, shape: Any, kind: Any) -> Any:
        return np.zeros(shape, as_dtype(kind)).view(np.recarray if as_dtype(kind).names else np.ndarray)

    def _shared(self, shape: Any, kind: Any) -> Any:
        self.now.arrays += 1
        return self._arrays.setdefault(self.now.arrays, self._room(shape, kind))


class Numbers(ModuleType):
    """NumPy, whose integers are Python's: those of kernels with 32 bits take negative constants."""

    uint32 = uintp = staticmethod(lambda value: int(value) & 0xFFFFFFFF)
    int32 = staticmethod(lambda value: (int(value) + 0x80000000 & 0xFFFFFFFF) - 0x80000000)

    def __getattr__(self, name: str) -> Any:
        return getattr(np, name)


class Names:
    """A module of these names, which may still be added to."""

    def __init__(self, names: dict[str, Any]) -> None:
        self.__dict__ = names


class Choosers(dict[Any, Any]):
    """What kernels overload functions with, as `numba.cuda.extending` is told."""

    def overload(self, function: Any) -> Any:
        return lambda chooser: self.setdefault(function, chooser)

    def as_chosen(self, function: Any, known: dict[str, Any]) -> Any:
        def run(*arguments: Any) -> Any:
            chosen = self[function](*map(typeof, arguments))
            return self.in_python(chosen, known)(*arguments)

        return run

    def in_python(self, found: Any, known: dict[str, Any]) -> Any:
        """A compiled function, or a module of them, with all that it calls, as Python runs it."""
        function: Any = getattr(found, "py_func", found)
        name = str(getattr(found, "__name__" if isinstance(found, ModuleType) else "__module__", ""))
        if not name.startswith(("uavaccel.kernels", "uavaccel.sim", "uavaccel.vision")):
            return found
        if isinstance(found, ModuleType):
            return Names(self.names_of(name, known))
        if not isinstance(function, FunctionType):
            return found
        if function in self:
            return self.as_chosen(function, known)
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
    gpu, choosers = Gpu(), Choosers()
    with pytest.MonkeyPatch.context() as patch:
        stub = SimpleNamespace(IndexDataCacheFile=type("File", (), {}))
        made = {"": gpu, ".libdevice": gpu.libdevice, ".extending": choosers, ".core": SimpleNamespace(caching=stub)}
        for name, module in made.items():
            patch.setitem(sys.modules, f"numba.cuda{name}", module)
        patch.setattr(numba, "cuda", gpu, raising=False)
        for name in OURS:
            patch.setitem(sys.modules, f"uavaccel.kernels.{name}", gpu)
            patch.delitem(sys.modules, f"uavaccel.kernels.{name}")
            patch.setattr(uavaccel.kernels, name, None, raising=False)
        for name in reversed(OURS):
            import_module(f"uavaccel.kernels.{name}")
        return gpu, choosers.names_of("uavaccel.kernels.cuda", {})


def leaves(tree: Any) -> list[np.ndarray]:
    """All arrays of nested tuples."""
    if isinstance(tree, np.ndarray):
        names = tree.dtype.names
        return [tree[name] for name in names] if names else [tree]
    return [leaf for each in tree for leaf in leaves(each)] if isinstance(tree, tuple) else []


class Memory(np.ndarray):
    """An array whose last index may exceed its bounds, where the others are 0."""

    def __getitem__(self, key: Any) -> Any:
        return self._flat()[key[-1]] if self._is_place(key) else super().__getitem__(key)

    def __setitem__(self, key: Any, value: Any) -> None:
        if self._is_place(key):
            self._flat()[key[-1]] = value
        else:
            super().__setitem__(key, value)

    def _is_place(self, key: Any) -> bool:
        return isinstance(key, tuple) and len(key) == self.ndim and not any(key[:-1])

    def _flat(self) -> Any:
        return self.view(np.ndarray).reshape(-1)


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

    Of pictures they make a part: a thread block of each lane.
    """

    ALONE = ("project", "find", "look")  # whose work the host leaves out
    PARTS: ClassVar = {  # of a lane's thread blocks, and the first and the last that are run
        "find": (4, 1, 1), "draw_gray": (36, 17, 17), "see": (36, 17, 17), "show": (18, 8, 8),
        "start_events": (288, 133, 133), "cast_depth": (288, 133, 133),
    }  # fmt: skip
    SMALL: ClassVar = dict.fromkeys(("cast_colour", "cast_gray", "start_events"), (3, 1, 1))
    OTHERS: ClassVar = {"see", "see_gray", "start_events", "finish"}  # here also the clock, or noise in the picture

    def __init__(self, nominal: Any, large: bool, left_out: Collection[str]) -> None:
        self._parts, self._left_out = self.PARTS if large else self.SMALL, {"add_colours", *left_out} - {"show"}
        self.gpu, names = kernels_in_python()
        self._sizes = {name: value for name, value in names.items() if name.isupper() and isinstance(value, int)}
        self._kernels = {"fly": names["flying"](nominal), "deal_clutter": names["deal_clutter"], **vars(names["views"])}
        self.compared: Counter[str] = Counter()

    def put_into(self, patch: pytest.MonkeyPatch) -> None:
        """In place of the host's kernels, which still run."""
        module, made = sys.modules[host_kernels.NAME], host_kernels.Kernels.__getattr__
        others = {"grid": lambda threads, each: (-(-threads // each), each), "threads_a_lane": lambda *_: 4}
        for name, value in {**self._sizes, **others}.items():
            patch.setattr(module, name, value, raising=False)
        host_kernels._forget()  # what has read them
        patch.setattr(import_module("uavaccel.envs.cuda_batch"), "DEVICE", "cpu")

        class Launch:
            def __init__(self, run: Any) -> None:
                self._run = run

            def __getitem__(self, grid: Any) -> Any:
                return host_kernels.launch(partial(self._run, grid))[()]

        kernel = lambda host, name: Launch(partial(self._run, name, made(host, name)[()]))  # noqa: E731
        patch.setattr(host_kernels.Kernels, "__getattr__", kernel)

    def _run(self, name: str, on_host: Any, grid: Any, *arguments: Any) -> None:
        if name not in self._kernels or not grid or name in self._left_out:
            on_host(*arguments)
            return
        before, mine = given(arguments, {}), given(arguments, None if name in self.ALONE else {})
        every, first, last = self._parts.get(name, (1, 0, 0))
        blocks = [block for block in range(grid[0]) if first <= block % every <= last]
        some = [each for each in range(grid[1]) if each % 64 in range(16, 32)] if name == "show" else None
        self.gpu.launch(self._kernels[name], blocks, grid[1], mine, some)
        on_host(*arguments)
        if name in self.ALONE:
            return
        for was, ours, theirs in zip(*map(leaves, (before, mine, arguments)), strict=True):
            if ours.dtype == np.uint64 or (name in self.OTHERS and (ours.ndim == 1 or ours.dtype == np.uint8)):
                continue  # a stream, of which each thread has its own
            if name == "fly" and ours.shape[1:] == (25,):  # forces and accelerations are not kept
                was, ours, theirs = (each[:, :13] for each in (was, ours, theirs))
            there = (ours != was) | ((theirs != was) & (every == 1))
            apart = np.abs(ours[there].astype(float) - theirs[there])
            least = 1e-4 * (1.0 + np.abs(theirs[there])) if ours.dtype.kind == "f" else 1
            assert not np.any(apart > least) or np.mean(apart > least) <= 0.02, (name, ours[there], theirs[there])
            self.compared[name] += apart.size
