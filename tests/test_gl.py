"""OpenGL: contexts that come and go, processes that end quietly, and machines without it."""

from __future__ import annotations

import gc
import os
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from ctypes.util import find_library
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from numpy.linalg import lapack_lite

from benchmarks.images import frame_rates
from tests.opengl import needs_opengl
from tests.scenes import Scene
from uavaccel.errors import UserError
from uavaccel.sim.camera import gl
from uavaccel.sim.camera.camera import Camera


@needs_opengl
def test_contexts_open_and_close_many_times(lane_scene: Scene) -> None:
    model, data = lane_scene
    with Camera(model) as kept:
        wanted = kept.colour(data)
        for _ in range(5):
            other = Camera(model, 32, 18)
            assert other.colour(data).any()
            other.close()
            other.close()
            assert gl.describe_renderer() == kept.renderer
            assert np.array_equal(kept.colour(data), wanted)
    with pytest.raises(ValueError, match="closed"):
        kept.colour(data)


@needs_opengl
def test_a_camera_that_is_dropped_is_freed(lane_scene: Scene) -> None:
    model, data = lane_scene
    with patch.object(gl, "release", wraps=gl.release) as release:
        assert Camera(model, 32, 18).colour(data).any()
        gc.collect()
    release.assert_called_once()


LOOK = """
import sys
import mujoco
from uavaccel.resources import asset
from uavaccel.sim.camera.camera import Camera
from uavaccel.sim.lane import sample_layout
from uavaccel.sim.profile import NATIVE
from uavaccel.sim.world import World
world = World("lane", NATIVE)
world.set_lane(sample_layout(0))
world.advance(10)
print([name for name in sys.modules if name.startswith(("OpenGL", "mujoco.egl", "mujoco.osmesa"))])
camera = Camera(world.model)
print(camera.colour(world.data).any())
1 / 0
"""


@needs_opengl
@pytest.mark.parametrize("backend", ["", *["osmesa"] * bool(find_library("OSMesa"))])
def test_flying_needs_no_opengl_and_nothing_is_said_of_it_at_exit(backend: str) -> None:
    environment = {**os.environ, "MUJOCO_GL": backend, "PYOPENGL_PLATFORM": ""}
    done = run_python("-W", "error", "-c", LOOK, env=environment)
    assert done.stdout.endswith("True\n" if backend else "[]\nTrue\n"), "MuJoCo itself imports what is asked for"
    assert done.returncode == 1
    assert done.stderr.endswith("ZeroDivisionError: division by zero\n")
    assert done.stderr.count("Error") == 1
    assert "Exception ignored" not in done.stderr


def run_python(*arguments: str, **options: Any) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, *arguments], capture_output=True, text=True, check=False, **options)


TRITON = """
import os
import mujoco.rendering.classic.gl_context as driver
from uavaccel.sim.camera.gl import make_context
os.environ["MUJOCO_GL"], driver.GLContext = "no backend", None
try:
    make_context(8, 8)
except Exception:
    print("libtriton.so" in open("/proc/self/maps").read())
"""


@pytest.mark.skipif(sys.platform != "linux", reason="Triton is there on Linux alone")
def test_triton_comes_before_the_driver_which_fails_here(tmp_path: Path) -> None:
    """Mesa's LLVM would be taken for Triton's: stable-baselines3 crashed with PyTorch's CUDA build."""
    (tmp_path / "triton/_C").mkdir(parents=True)
    (tmp_path / "triton/__init__.py").write_text("1 / 0")
    shutil.copy(lapack_lite.__file__, tmp_path / "triton/_C/libtriton.so")
    path = f"{tmp_path}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"
    done = run_python("-c", TRITON, env={**os.environ, "PYTHONPATH": path})
    assert done.stdout == "True\n", done.stderr


WORKER = """
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

kept = []

def look(index):
    import mujoco
    from uavaccel.resources import asset
    from uavaccel.sim.camera.camera import Camera
    model = mujoco.MjModel.from_xml_path(str(asset("mjcf/lane.xml")))
    kept.append(Camera(model, 32, 18))
    return bool(kept[-1].colour(mujoco.MjData(model)).any())

if __name__ == "__main__":
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        print(*pool.map(look, range(2)))
"""


@pytest.mark.slow
@needs_opengl
def test_workers_end_without_noise(tmp_path: Path) -> None:
    (tmp_path / "look.py").write_text(WORKER)
    done = run_python("-W", "error", str(tmp_path / "look.py"))
    assert (done.stdout, done.stderr) == ("True True\n", "")


@needs_opengl
def test_a_context_is_one_threads_until_it_lets_go() -> None:
    context, renderer = gl.make_context(8, 8)
    with ThreadPoolExecutor(1) as other:
        if renderer.backend == "egl":
            with pytest.raises(UserError, match=r"^OpenGL draws in one thread at a time, and another one has drawn"):
                other.submit(gl.bind, context).result()
        gl.let_go()
        for does in (partial(gl.bind, context), gl.let_go):
            other.submit(does).result()
    gl.bind(context)
    gl.release(context)


def test_a_missing_or_wrong_opengl_is_told_in_a_line(monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        patch.delenv("MUJOCO_GL", raising=False)
        patch.setattr(gl, "_first_that_works", lambda: None)
        patch.setattr(sys, "platform", "linux")
        with pytest.raises(UserError, match=r"libegl1 libegl-mesa0 libgl1-mesa-dri, or libosmesa6 \(Debian\)$"):
            gl.make_context(8, 8)
    for word in ("off", " OFF", "Disabled", "disable", "false", "0"):
        monkeypatch.setenv("MUJOCO_GL", word)
        with pytest.raises(UserError, match=f"^MUJOCO_GL={word.lower().strip()} switches images off"):
            gl.choose_backend()
    monkeypatch.setenv("MUJOCO_GL", "egl")
    monkeypatch.setitem(sys.modules, "mujoco.egl", None)
    with pytest.raises(UserError, match=r"does not work with MUJOCO_GL=egl .*install libegl1"):
        gl.make_context(8, 8)


def test_a_probe_that_crashes_is_no_backend(monkeypatch: pytest.MonkeyPatch) -> None:
    for crashes, backend in (("True", None), ("os.environ['MUJOCO_GL'] != 'osmesa'", "osmesa")):
        monkeypatch.setattr(gl, "_PROBE", f"import os; os.abort() if {crashes} else print('a renderer')")
        gl._first_that_works.cache_clear()
        assert getattr(gl._first_that_works(), "backend", None) == backend
    gl._first_that_works.cache_clear()


@needs_opengl
def test_the_bench_measures_ours_and_the_bare_loop() -> None:
    ours, bare, ratio, renderer = frame_rates(rounds=1)
    assert ratio == pytest.approx(ours / bare)  # of one pass
    assert renderer == gl.describe_renderer()


def test_a_missing_gl_is_one_line_wherever_mujoco_is_imported() -> None:
    done = run_python("-m", "uavaccel", "run", "dp1", "--dry-run", env={**os.environ, "MUJOCO_GL": "glsl"})
    assert done.returncode == 1
    assert done.stderr.startswith("uavaccel: error: MUJOCO_GL=glsl does not work here")
    assert len(done.stderr.splitlines()) == 1
