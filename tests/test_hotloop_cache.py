"""Cached machine code is that of the sources that it was compiled from, in whatever file they are.

numba looks for changes in the file of an entry point, and in the values that this closes over: a number of all files
that its code comes from is one of them. Processes that start at once share the files of machine code.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from errno import ENOSPC
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from numba import njit
from numba.core.caching import IndexDataCacheFile

from uavaccel.envs.gates import Gates
from uavaccel.envs.kernel_games import GameMaker
from uavaccel.errors import UserError
from uavaccel.kernels import cpu, pictures
from uavaccel.sim.vehicle import hotloop

ENTRY_POINTS: list[Any] = [
    *(entry_point._pyfunc for entry_point in hotloop.ENTRY_POINTS),  # type: ignore[attr-defined]
    *(each.py_func for each in (cpu.run_lanes, pictures._render)),
]


def put_module(patch: pytest.MonkeyPatch, folder: Path, name: str, text: str) -> Path:
    """A module of ours that has been imported, and its file."""
    file = folder / f"{name}.py"
    file.write_text(text)
    module = ModuleType(f"uavaccel.sim.{name}")
    module.__file__ = str(file)
    patch.setitem(sys.modules, module.__name__, module)
    return file


def test_the_number_changes_with_any_file_that_is_reached(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A function of a new file, and behind it a number of another new one: no list of files knows them."""
    put_module(monkeypatch, tmp_path, "loop", "from uavaccel.sim.signed import signed\n")
    signed = put_module(monkeypatch, tmp_path, "signed", "from uavaccel.sim import sign\n")
    sign = put_module(monkeypatch, tmp_path, "sign", "SIGN = 1.0\n")
    beside = put_module(monkeypatch, tmp_path, "beside", "SIGN = 1.0\n")

    numbers = [hotloop.sources("uavaccel.sim.loop")]
    for file in (sign, signed):
        file.write_text(file.read_text() + "HALF = 0.5\n")
        numbers.append(hotloop.sources("uavaccel.sim.loop"))
    assert len({*numbers}) == 3
    assert 0 not in numbers
    beside.write_text("SIGN = -1.0\n")
    assert hotloop.sources("uavaccel.sim.loop") == numbers[-1]


def closed_over(function: Any) -> dict[str, Any]:
    cells = zip(function.__code__.co_freevars, function.__closure__, strict=True)
    return {name: cell.cell_contents for name, cell in cells}


@pytest.mark.parametrize("function", ENTRY_POINTS, ids=lambda function: function.__qualname__)
def test_every_entry_point_closes_over_it(function: Any) -> None:
    closed = closed_over(function)
    assert [closed[name] for name in ("sources", "stamp") if name in closed] == [hotloop.sources(function.__module__)]


def test_a_stamped_function_computes_the_same() -> None:
    factor = 3.0

    def times(number: float, more: float = 1.0) -> float:
        return number * factor + more

    for function in (times, hotloop.stamped(times, 7), njit(hotloop.stamped(times, 7))):
        assert (function(2.0), function(2.0, 4.0)) == (7.0, 10.0)
    assert closed_over(hotloop.stamped(times, 7)) == {"factor": 3.0, "sources": 7}


def test_every_kernel_of_a_gpu_closes_over_it() -> None:
    pytest.importorskip("numba_cuda")
    from uavaccel.kernels import cuda

    kernels = vars(cuda.compiled(GameMaker(Gates().task).nominal))
    number = hotloop.sources(cuda.__name__)
    assert {closed_over(kernel.py_func)["sources"] for kernel in kernels.values()} == {number}
    assert "uavaccel.kernels.tiles" in hotloop._reached(cuda.__name__, {})


def test_what_the_hot_loop_computes_is_reached() -> None:
    reached = hotloop._reached(hotloop.__name__, {})
    for name in ("autopilot", "free_body", "quadrotor"):
        assert f"uavaccel.sim.vehicle.{name}" in reached


def meanwhile(writer: IndexDataCacheFile, call: Callable[[], object]) -> None:
    """Let another process do something just before the writer's code is in its file."""
    save = writer._save_data
    writer._save_data = lambda name, code: (call(), save(name, code))


def test_no_code_of_older_sources_is_loaded_while_new_is_saved(tmp_path: Path) -> None:
    def opened(stamp: int) -> IndexDataCacheFile:
        return IndexDataCacheFile(str(tmp_path), "loop", stamp)

    opened(1).save("fly", "older")
    writer, seen = opened(2), []
    meanwhile(writer, lambda: seen.append(opened(2).load("fly")))
    writer.save("fly", "newer")
    assert (seen, opened(2).load("fly")) == ([None], "newer")
    assert len([*tmp_path.glob("*.nbc")]) == 1


def test_functions_saved_at_once_are_not_taken_for_each_other(tmp_path: Path) -> None:
    one, two, later = (IndexDataCacheFile(str(tmp_path), "loop", 1) for _ in range(3))
    one._load_index = two._load_index = dict  # both have looked when there was none
    meanwhile(one, lambda: two.save("rest", "code of rest"))
    one.save("fly", "code of fly")
    for name in ("fly", "rest"):
        assert later.load(name) in (None, f"code of {name}")


def test_a_full_disk_is_told_of_with_the_folder(tmp_path: Path) -> None:
    writer = IndexDataCacheFile(str(tmp_path), "loop", 1)
    writer._save_data = lambda name, code: (_ for _ in ()).throw(OSError(ENOSPC, "No space left on device"))
    with pytest.raises(UserError, match=rf"^{tmp_path}: No space left on device; make room$"):
        writer.save("fly", "code")
