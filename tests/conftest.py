"""What the tests share: Hypothesis' settings, the mark of those that draw, the lane's scene, and worlds to fly in."""

from __future__ import annotations

import gc
import json
import os
import re
import signal
import sys
import sysconfig
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

import mujoco
import pytest
import typer.main
from hypothesis import HealthCheck, settings
from xdist.remote import Producer
from xdist.scheduler import LoadScopeScheduling

from tests.scenes import Scene
from tests.scripts import Folder
from uavaccel import own_code
from uavaccel.cli import main as cli
from uavaccel.draw import style
from uavaccel.errors import UserError
from uavaccel.resources import asset
from uavaccel.sim.camera import gl
from uavaccel.sim.lane import layout_from
from uavaccel.sim.profile import NATIVE
from uavaccel.sim.world import World

# All that collection loads stays: looking through it for garbage would take a third of its time, and then as long in
# the tests.
gc.disable()

# With threads of its own for each worker PyTorch waits more than it computes, also in the programs that tests start.
os.environ.setdefault("OMP_NUM_THREADS", "1")

# What typer makes of the commands is put together once, not whenever a test runs one.
typer.main.get_command = cache(typer.main.get_command)

# How long an example takes says something about the machine's other work alone. A run has the examples of the last.
settings.register_profile("drawn", max_examples=50, deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("repeated", settings.get_profile("drawn"), derandomize=True)
settings.load_profile("repeated")
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # In the background of a shell Ctrl-C is ignored, by the programs that tests start too.
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(autouse=True, scope="session")
def own_state(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Keep what tests trust out of the user's own state, also in the programs that they start.

    Nothing of a test has to survive a loss of power, so no file waits for the disk. A figure takes longer to draw than
    most tests' flights, so a few bytes are written in its place; tests/test_draw.py calls `save` itself.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda descriptor: None)
        patch.setattr(style, "save", lay_out)
        patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        yield


LAID_OUT: set[str] = set()


def lay_out(figure: Any, path: Path) -> Path:
    """Do not draw a figure, but lay out the first of each name, so that what cannot be drawn is heard."""
    if path.stem not in LAID_OUT:
        LAID_OUT.add(path.stem)
        figure.draw_without_rendering()
    return write_no_picture(path)


def write_no_picture(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(b"a picture")
    return path


@pytest.fixture(autouse=True)
def signals_as_before() -> Iterator[None]:
    """Put the handlers of signals back after each test.

    A script's process ignores signals at its end; a test that runs it in its own process would hand that down to every
    program that a later test starts.
    """
    before = {kind: signal.getsignal(kind) for kind in (signal.SIGINT, signal.SIGTERM)}
    yield
    for kind, handler in before.items():
        signal.signal(kind, handler)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Folder:
    return Folder(tmp_path, monkeypatch, capfd)


@pytest.fixture
def without_camera(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the page begin as where nothing can be rendered."""

    def make_camera(*_: object) -> None:
        raise UserError("no OpenGL")

    monkeypatch.setattr("uavaccel.watch.page.make_camera", make_camera)


# Those that compile kernels: one process, which does it once, and begins with what others load from disk. On a fresh
# clone that takes more than a minute; who flies the kernels is not among the first.
KERNELS = re.compile(
    r"test_(device|engines_agree|evaluate_lanes|kernel_looks|navigate|own_task|ppo|realtime_vector|still_scenes)\.py"
    r"|\[docs/(extending|kernels|tutorial|reference/python)|of_the_kernels"
)
# The longest begin, or the last one would keep one core busy alone.
FIRST = (
    "kernels",
    "test_docs",
    "test_watch",
    "test_watch_live",
    "test_training",
    "test_fly_scripts",
    "test_tools",
    "test_wheel",
    "test_killed_at_random",
    "test_env",
    "test_fly_deaths",
    "test_batch",
    "test_evaluate",
    "test_python",
)


def pytest_xdist_auto_num_workers() -> int:
    """Two processes more than cores: some tests wait for a browser, a timer or another process."""
    return (os.cpu_count() or 1) + 2


def group_of(test: str) -> str:
    """Whose tests one process runs: a file's, since they share what they fly in, but for the kernels."""
    return "kernels" if KERNELS.search(test) else Path(test.partition("::")[0]).stem


class ByGroup(LoadScopeScheduling):
    """Give each process the tests of a group at a time, in the order of their collection."""

    def _split_scope(self, nodeid: str) -> str:
        return group_of(nodeid)


def pytest_xdist_make_scheduler(config: pytest.Config, log: Producer) -> ByGroup:
    return ByGroup(config, log)


@pytest.hookimpl(wrapper=True)
def pytest_collection(session: pytest.Session) -> Iterator[None]:
    """Of the workers and of the process that starts them, which collects no tests.

    If all tests run, each worker begins with other modules, so that one of them rewrites a module's asserts, on a fresh
    clone, and the others load them.
    """
    worker: dict[str, Any] = getattr(session.config, "workerinput", {})
    if worker and session.config.args == session.config.getini("testpaths"):
        modules = sorted(file.stem for file in Path(__file__).parent.glob("test_*.py"))
        first = len(modules) * int(worker["workerid"].removeprefix("gw")) // worker["workercount"]
        for module in modules[first:] + modules[:first]:
            with suppress(Exception, pytest.skip.Exception):  # which collection meets again
                import_module(f"tests.{module}")
    found = yield
    gc.freeze()
    gc.enable()
    return found


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the longest groups first, and skip what draws where OpenGL is missing."""
    order = {group: place for place, group in enumerate(FIRST)}
    items.sort(key=lambda item: order.get(group_of(item.nodeid), len(FIRST)))
    skip_what_cannot_draw(items)


def skip_what_cannot_draw(items: list[pytest.Item]) -> None:
    """The probe is a process, so it starts only if something draws."""
    drawing = [item for item in items if item.get_closest_marker("opengl")]
    if drawing and not _opengl_works():
        for item in drawing:
            item.add_marker(pytest.mark.skip(reason="no OpenGL on this machine"))


def _opengl_works() -> bool:
    try:
        return bool(gl.choose_backend())
    except UserError:
        return False


@pytest.fixture(scope="session")
def lane_scene() -> Scene:
    """The lane's model and data, shared: each test lays out its own lane."""
    model = mujoco.MjModel.from_xml_path(str(asset("mjcf/lane.xml")))
    return model, mujoco.MjData(model)


@pytest.fixture(scope="session")
def _lane_world() -> Iterator[World]:
    world = World("lane", NATIVE)
    yield world
    world.close()


@pytest.fixture
def lane_world(_lane_world: World) -> World:
    """A settled hover at the start of an empty lane without wind."""
    _lane_world.set_lane(layout_from({"obstacles": []}, "test"))
    _lane_world.reset()
    return _lane_world


@pytest.fixture(scope="module")
def trainings_here() -> Iterator[None]:
    """Small trainings are quick."""
    from tests.learning import fly_here  # which loads all that learns

    with pytest.MonkeyPatch.context() as patch:
        fly_here(patch.setattr)
        yield


# --- what mistakes are told ---------------------------------------------------------------------------------------

MESSAGES = Path(__file__).parent / "data/messages.json"
# What another run has otherwise.
ELSEWHERE = re.compile(
    r"0x[0-9a-f]{6,}|(?<=127\.0\.0\.1:)\d+|\d+(?= on this machine| cores)|(?<=the connection)(?:: .*)?$"
)
_told: list[str] = []  # in the present test


@cache
def recorded_messages() -> dict[str, dict[str, list[str]]]:
    """By test function, and by what stands in brackets after it."""
    return dict(json.loads(MESSAGES.read_text(encoding="utf-8")))


@pytest.fixture
def whole_messages(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[None]:
    """Hold what mistakes are told in a test, of which it looks for a part, whole, as recorded."""
    _told.clear()
    raises = type(pytest.raises(UserError))
    leave = raises.__exit__

    def left(raised: Any, kind: Any, value: Any, trace: Any) -> bool:
        _told.extend([str(value)] * isinstance(value, UserError))
        return leave(raised, kind, value, trace)

    monkeypatch.setattr(raises, "__exit__", left)
    yield
    places = {str(tmp_path): "HERE", str(tmp_path.parent): "THERE", str(Path(__file__).parents[1]): "ROOT"}
    places |= {sysconfig.get_path("stdlib"): "PYTHON"}
    of_places = re.compile("|".join(map(re.escape, places)))
    told = [ELSEWHERE.sub("N", of_places.sub(lambda place: places[place[0]], said)) for said in _told]
    if hasattr(request.function, "hypothesis"):
        return
    test, _, case = request.node.name.partition("[")
    test, recorded = f"{request.module.__name__.rpartition('.')[2]}.{test}", recorded_messages()
    if os.environ.get("RECORD") and told:
        recorded.setdefault(test, {})[case] = told
        lines = (f"{json.dumps(name)}: {json.dumps(recorded[name], ensure_ascii=False)}" for name in sorted(recorded))
        MESSAGES.write_text("{" + ",\n".join(lines) + "}\n", encoding="utf-8")
    assert recorded.get(test, {}).get(case, []) == told


# --- code of one's own ------------------------------------------------------------------------------------------


def forget_own_code(monkeypatch: pytest.MonkeyPatch) -> None:
    """As in a process of its own: nothing is trusted or imported yet."""
    for name, nothing in (("_here", {}), ("_imported", {}), ("_noted", []), ("_projects", {})):
        monkeypatch.setattr(own_code, name, nothing)


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A working directory whose own code is forgotten at the end, as that of other tests is here."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    forget_own_code(monkeypatch)
    for name in modules_below(tmp_path.parent):
        monkeypatch.delitem(sys.modules, name)
    yield tmp_path
    for name in modules_below(tmp_path):
        del sys.modules[name]


def modules_below(folder: Path) -> list[str]:
    """The names of the modules that were imported from there."""
    files = {name: str(getattr(module, "__file__", None) or "") for name, module in sys.modules.items()}
    return [name for name, file in files.items() if file.startswith(f"{folder}/")]


@pytest.fixture
def said(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[[str], str]:
    """What a command line complains about, in one line, when it ends."""

    def run(line: str) -> str:
        own_code._here.clear()
        monkeypatch.setattr(sys, "argv", ["uavaccel", *line.split()])
        with pytest.raises(SystemExit):
            cli.main()
        error = capsys.readouterr().err
        assert error.count("\n") <= 1, error
        _told.append(error.removeprefix("uavaccel: error: ").strip())
        return _told[-1]

    return run
