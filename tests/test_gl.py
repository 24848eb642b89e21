"""OpenGL: contexts that come and go, processes that end quietly, and machines without it."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest

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


LOOK = """
import mujoco, sys
from uavaccel.resources import asset
from uavaccel.sim.camera.camera import Camera
model = mujoco.MjModel.from_xml_path(str(asset("mjcf/lane.xml")))
camera, dropped = Camera(model), Camera(model, 32, 18)
print(camera.colour(mujoco.MjData(model)).any())
del dropped
{end}
"""


def run_python(code: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-W", "error", "-c", code],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )


@needs_opengl
@pytest.mark.parametrize(
    ("end", "status", "said"), [("", 0, ""), ("1 / 0", 1, "ZeroDivisionError: division by zero\n")]
)
def test_nothing_is_said_at_exit(end: str, status: int, said: str) -> None:
    done = run_python(LOOK.format(end=end))
    assert done.stdout == "True\n"
    assert done.returncode == status
    assert done.stderr.endswith(said)
    assert done.stderr.count("Error") == said.count("Error")
    assert "Exception ignored" not in done.stderr


WORKERS = """
import sys
from joblib import Parallel, delayed
sys.path.insert(0, {folder!r})
from test_camera_worker import look
if __name__ == "__main__":
    print(Parallel(n_jobs=2)(delayed(look)(index) for index in range(3)))
"""
WORKER = """
import mujoco
from uavaccel.resources import asset
from uavaccel.sim.camera.camera import Camera

kept = []

def look(index):
    model = mujoco.MjModel.from_xml_path(str(asset("mjcf/lane.xml")))
    kept.append(Camera(model, 32, 18))
    return bool(kept[-1].colour(mujoco.MjData(model)).any())
"""


@pytest.mark.slow
@needs_opengl
def test_workers_end_without_noise(tmp_path: os.PathLike[str]) -> None:
    folder = os.fspath(tmp_path)
    with open(os.path.join(folder, "test_camera_worker.py"), "w", encoding="utf-8") as module:
        module.write(WORKER)
    done = run_python(WORKERS.format(folder=folder))
    assert done.stdout == "[True, True, True]\n"
    assert done.stderr == ""


def test_without_opengl_one_line_names_the_packages(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setattr(gl, "_first_that_works", lambda: None)
    monkeypatch.setattr(sys, "platform", "linux")
    with pytest.raises(UserError, match=r"libegl1 libegl-mesa0 libgl1-mesa-dri, or libosmesa6 \(Debian\)$"):
        gl.make_context(8, 8)


def test_images_that_are_switched_off(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MUJOCO_GL", "off")
    with pytest.raises(UserError, match="MUJOCO_GL=off switches images off"):
        gl.choose_backend()


def test_a_backend_that_does_not_work_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MUJOCO_GL", "egl")
    monkeypatch.setitem(sys.modules, "mujoco.egl", None)
    with pytest.raises(UserError, match=r"does not work with MUJOCO_GL=egl .*install libegl1"):
        gl.make_context(8, 8)


def test_a_probe_that_crashes_is_no_backend(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gl, "_PROBE", "import os; os.abort()")
    gl._first_that_works.cache_clear()
    assert gl._first_that_works() is None
    gl._first_that_works.cache_clear()


def test_flying_needs_no_opengl() -> None:
    code = (
        "import sys\n"
        "from uavaccel.sim.world import World\nfrom uavaccel.sim.profile import NATIVE\n"
        "from uavaccel.sim.lane import sample_layout\n"
        "world = World('lane', NATIVE); world.set_lane(sample_layout(0)); world.reset(); world.advance(10)\n"
        "assert not [name for name in sys.modules if name.startswith(('OpenGL', 'mujoco.egl', 'mujoco.osmesa'))]\n"
    )
    environment = {name: value for name, value in os.environ.items() if name != "MUJOCO_GL"}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@needs_opengl
def test_the_bench_measures_ours_and_the_bare_loop() -> None:
    ours, bare, ratio, renderer = frame_rates(rounds=1)
    assert ratio == pytest.approx(ours / bare)  # of one pass
    assert renderer == gl.describe_renderer()


def test_a_missing_gl_is_one_line_wherever_mujoco_is_imported() -> None:
    command = [sys.executable, "-m", "uavaccel", "run", "dp1", "--dry-run"]
    done = subprocess.run(command, env={**os.environ, "MUJOCO_GL": "glsl"}, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr.startswith("uavaccel: error: MUJOCO_GL=glsl does not work here")
    assert len(done.stderr.splitlines()) == 1
