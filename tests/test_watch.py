"""A flight as it is watched: tracks, the playhead, and the page in a browser that clicks."""

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.opengl import needs_opengl
from uavaccel.commands import COMMANDS, VelocityGoal
from uavaccel.commands.paths import velocities
from uavaccel.sim.camera.view import HEIGHT, WIDTH
from uavaccel.sim.profile import PROFILES
from uavaccel.sim.world import World
from uavaccel.watch import figure, pictures, trail
from uavaccel.watch.drone import Drone
from uavaccel.watch.figure import COMMANDED, THINKING, Figure
from uavaccel.watch.pictures import Eyes
from uavaccel.watch.playhead import Playhead
from uavaccel.watch.scene import Geom, ground_below
from uavaccel.watch.square import T_MOVE_S, fly_side_by_side
from uavaccel.watch.track import Track, track_of
from uavaccel.watch.trail import Trail

CHROMIUM = Path("/usr/bin/chromium")
FLAGS = ["--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync"]
FLAGS += ["--disable-background-networking", "--disable-component-update"]
FLAGS += ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
SCREENSHOTS = "UAVACCEL_SCREENSHOTS"  # a folder that keeps those of this test, as those of docs/watch.md
SCALE = (
    1.0 if SCREENSHOTS in os.environ else 0.25
)  # software WebGL draws a sixteenth of the pixels in a quarter of the time
# Without a GPU a page compiles its shaders for ten seconds, and then draws for as long as it is open.
DRAW_NOTHING = """
const made = HTMLCanvasElement.prototype.getContext
HTMLCanvasElement.prototype.getContext = function (...wanted) {
    const gl = made.apply(this, wanted)
    if (gl instanceof WebGL2RenderingContext) {
        for (const name of ["compileShader", "linkProgram", "useProgram", "drawArrays", "drawElements",
                            "drawArraysInstanced", "drawElementsInstanced"])
            gl[name] = () => {}
        gl.getShaderParameter = () => true
        gl.getProgramParameter = (program, what) => what == gl.LINK_STATUS ? true : 0
    }
    return gl
}
"""


@pytest.fixture(scope="module")
def both() -> list[Track]:
    return fly_side_by_side(50.0, think_s=0.012, rounds=1, seed=0)


def test_only_the_clock_of_tcsc_stands_while_the_client_thinks(both: list[Track]) -> None:
    adsc, tcsc = both
    returned = [float(wall) for wall in adsc.marks[1:-1:2, 0]]
    for wall_s in returned:
        assert adsc.simulated_s(wall_s + 0.011) - adsc.simulated_s(wall_s + 0.001) == pytest.approx(0.5)
    for wall_s in (float(wall) for wall in tcsc.marks[1:-1:2, 0]):
        assert tcsc.simulated_s(wall_s + 0.011) == tcsc.simulated_s(wall_s + 0.001)
    assert not tcsc.between_commands(tcsc.time_s[:-1]).any()
    assert adsc.between_commands(adsc.time_s).sum() >= 3 * 0.6 / 0.05
    for track in both:
        assert (np.diff(track.marks, axis=0) >= 0.0).all()  # neither clock runs backwards
        issued_s, returned_s = track.marks[::2, 0], track.marks[1::2, 0]
        assert issued_s[0] == 0.0  # nobody thinks before the first command
        np.testing.assert_allclose(issued_s[1:] - returned_s[:-1], 0.012, atol=1e-4)


def test_looking_on_changes_no_flight(both: list[Track]) -> None:
    from uavaccel.wire.latency import shipped_latency
    from uavaccel.wire.session import open_session

    with open_session("virtual", latency=shipped_latency()) as session:
        client = session.start_game(50.0, np.random.SeedSequence(0))
        COMMANDS["adsc"].begin(client)
        for number, velocity in enumerate(velocities("square", 1)):
            client.transport.clock.charge(12_000_000 if number else 0)
            list(COMMANDS["adsc"].fly(client, VelocityGoal(velocity), T_MOVE_S, T_MOVE_S))
        alone = client.recording().arrays()
    assert alone["position_m"].tobytes() == both[0].position_m.tobytes()
    assert alone["orientation_wxyz"].tobytes() == both[0].orientation_wxyz.tobytes()


def test_a_pose_between_samples_is_between_them() -> None:
    turned = [np.sqrt(0.5), 0.0, 0.0, -np.sqrt(0.5)]  # a quarter turn, by the farther of its two quaternions
    arrays = {
        "time_s": np.array([0.0, 1.0]),
        "position_m": np.array([[0.0, 0.0, -10.0], [2.0, 0.0, -10.0]]),
        "orientation_wxyz": np.array([[1.0, 0.0, 0.0, 0.0], [-value for value in turned]]),
        "command_start_s": np.array([0.25]),
        "command_end_s": np.array([0.75]),
    }
    track = track_of("TCSC", 10.0, arrays)
    place, attitude = track.pose(0.5)
    np.testing.assert_allclose(place, [1.0, 0.0, -10.0])
    np.testing.assert_allclose(attitude, [np.cos(np.pi / 8), 0.0, 0.0, -np.sin(np.pi / 8)], atol=1e-12)
    assert [track.command(time_s) for time_s in (0.0, 0.25, 0.75)] == [None, 0, None]
    assert track.simulated_s(0.05) == pytest.approx(0.5)


def test_the_playhead_pauses_steps_and_begins_anew() -> None:
    head = Playhead(end_s=0.2, slowness=50.0, step_s=0.001)
    head.pass_time(5.0)
    assert head.at_s == pytest.approx(0.1)
    head.step()
    head.pass_time(5.0)
    assert head.at_s == pytest.approx(0.101)
    assert not head.playing
    head.toggle()
    head.pass_time(60.0)
    assert (head.at_s, head.playing) == (0.2, False)
    head.toggle()
    assert (head.at_s, head.playing) == (0.0, True)
    head.step()
    head.replay()
    assert (head.at_s, head.playing) == (0.0, True)
    for at_s, there_s in ((-0.1, 0.0), (0.15, 0.15), (0.3, 0.2)):
        head.seek(at_s)
        assert (head.at_s, head.playing) == (there_s, True)


def test_a_game_without_marks_took_its_simulated_time_over_its_clock_speed() -> None:
    track = track_of("ADSC", 10.0, {**dict.fromkeys(drone_arrays(), np.zeros(1)), "time_s": np.array([1.0, 5.0])})
    assert track.wall_s == 0.4
    assert [track.simulated_s(wall_s) for wall_s in (0.0, 0.1, 9.0)] == [1.0, 2.0, 5.0]


def drone_arrays() -> dict[str, np.ndarray]:
    """Four samples a second apart: a command northwards, a second without one, and another one eastwards."""
    return {
        "time_s": np.arange(4.0),
        "position_m": np.array([[0.0, 0.0, -10.0], [1.0, 0.0, -10.0], [2.0, 0.0, -10.0], [2.0, 1.0, -10.0]]),
        "orientation_wxyz": np.tile([np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)], (4, 1)),
        "command_start_s": np.array([0.0, 2.0]),
        "command_end_s": np.array([1.0, 3.0]),
    }


def test_the_page_shows_a_drone_its_path_its_command_and_what_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    """MuJoCo's frame is north, west, up. Of 0.2 s in which the client thinks the clock is paused in the first half."""
    made: dict[str, Any] = {}

    def add(name: str, *arguments: Any, **options: Any) -> Any:
        made[name] = SimpleNamespace(name=name, arguments=arguments)
        return made[name]

    adding = ("add_frame", "add_label", "add_arrows", "add_line_segments", "add_cylinder")
    scene = SimpleNamespace(**dict.fromkeys(adding, add))
    monkeypatch.setattr(figure, "show_drone", lambda *_: None)
    monkeypatch.setattr(figure, "ground_below", lambda model, data, place, body: 1.5)
    marks = np.array([[0.0, 0.0], [0.1, 1.0], [0.2, 1.0], [0.3, 2.0], [0.4, 3.0]])
    track = track_of("TCSC", 10.0, drone_arrays(), [(2.0, 0.0, 0.0), (0.0, 2.0, 0.0)], marks)
    assert track.between_commands(np.array([0.0, 0.5, 1.0, 2.0])).tolist() == [False, False, True, False]
    server: Any = SimpleNamespace(scene=scene)
    body = Figure(server, "TCSC", *[None] * 3)  # type: ignore[arg-type]
    shown = Drone(server, track, body, np.array([0.0, 3.0, 0.0]), ideal_m=np.zeros((3, 3)))
    said = {}
    for wall_s in (0.05, 0.15, 0.25, 0.35, 0.4):
        shown.show(wall_s)
        arrow = made["/TCSC command"]
        said[wall_s] = made["/TCSC/name"].text, arrow.points.round(9).tolist() if arrow.visible else None
    assert said == {
        0.05: ("TCSC: flies its command", [[[0.5, -3.0, 10.0], [1.2, -3.0, 10.0]]]),
        0.15: ("TCSC: client thinks, clock paused", None),
        0.25: ("TCSC: client thinks, drone flies on", None),
        0.35: ("TCSC: flies its command", [[[2.0, -3.5, 10.0], [2.0, -4.2, 10.0]]]),
        0.4: ("TCSC: done", None),
    }
    line = made["/TCSC path"]
    assert line.colors[:, 0].tolist() == [[*COMMANDED], [*THINKING], [*COMMANDED]]
    assert line.points.tolist() == [[[0, -3, 10], [1, -3, 10]], [[1, -3, 10], [2, -3, 10]], [[2, -3, 10], [2, -4, 10]]]
    assert shown.height_m == 8.5
    foot = [2.0, -4.0, 1.5 + figure.LIFT_M]
    assert made["/TCSC shadow"].position.tolist() == foot
    np.testing.assert_allclose(made["/TCSC plumb line"].points, [[[2.0, -4.0, 10.0], foot]], rtol=1e-6)
    np.testing.assert_allclose(made["/TCSC"].wxyz, [np.sqrt(0.5), 0.0, 0.0, -np.sqrt(0.5)])
    for ground_m, lines in ((9.84, (True, True)), (9.86, (True, False)), (None, (False, False))):
        monkeypatch.setattr(figure, "ground_below", lambda *_, ground_m=ground_m: ground_m)
        shown.show(0.4)
        assert (made["/TCSC shadow"].visible, made["/TCSC plumb line"].visible) == lines  # none where it stands
        assert shown.height_m == (None if ground_m is None else pytest.approx(10.0 - ground_m))
    shown.show(0.05)  # half of the first second again
    assert line.points.tolist() == [[[0.0, -3.0, 10.0], [0.5, -3.0, 10.0]]]
    assert made["/TCSC ideal"].arguments[0].tolist() == [[[0, -3, 0]] * 2] * 2


def test_events_are_of_what_passed_since_the_last_look_and_begin_anew_after_a_jump(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    frame = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    camera = SimpleNamespace(colour=lambda _: frame)
    data = SimpleNamespace(qpos=np.zeros(9))
    eyes = Eyes(camera, data, slice(1, 8))  # type: ignore[arg-type]
    stepped: list[float] = []

    def step(sensor: Any, state: Any, image: Any, time_s: float) -> Any:
        stepped.append(time_s)
        return state, np.zeros((HEIGHT, WIDTH), int), np.zeros((HEIGHT, WIDTH), int)

    monkeypatch.setattr(pictures, "step", step)
    for time_s in (5.0, 5.0, 5.1, 5.2, 9.0, 9.125, 2.0, 2.25):
        picture = eyes.render(np.array([1.0, 2.0, 3.0]), np.array([0.5, 0.5, -0.5, -0.5]), time_s)
    assert stepped == pytest.approx([0.1, 0.2, 0.125])  # since it began: not after standing, nor after jumps
    assert picture.shape == (2 * HEIGHT, WIDTH, 3)
    assert data.qpos.tolist() == [0.0, 1.0, 2.0, 3.0, 0.5, 0.5, -0.5, -0.5, 0.0]


def test_the_faster_the_clock_the_farther_adsc_leaves_the_path_of_tcsc(both: list[Track]) -> None:
    slow, fast = (fly_side_by_side(speed, think_s=0.012, rounds=1, seed=0) for speed in (1.0, 100.0))
    apart_m = [adsc.farthest_from(tcsc) for adsc, tcsc in (slow, both, fast)]
    assert apart_m == sorted(apart_m)
    assert apart_m[0] < 0.05
    assert apart_m[1] > 0.3
    adsc, tcsc = both
    nearest = [min(np.linalg.norm(tcsc.position_m - place, axis=1)) for place in adsc.position_m]
    assert adsc.farthest_from(tcsc) == pytest.approx(max(nearest))


def test_heights_are_over_what_is_below() -> None:
    world = World("blocks", PROFILES["native"])
    boxes = [geom for geom in range(world.model.ngeom) if world.model.geom_type[geom] == Geom.mjGEOM_BOX]
    solid = next(geom for geom in boxes if world.model.geom_bodyid[geom] == 0)
    x, y, z = world.data.geom_xpos[solid].tolist()
    top = z + float(world.model.geom_size[solid][2])
    below = partial(ground_below, world.model, world.data, body=world.lead.body_id)
    assert below(place=np.array([x, y, 50.0])) == pytest.approx(top)
    assert below(place=np.array([0.0, 0.0, 10.0])) == pytest.approx(0.0)  # its own body is at 10 m
    assert below(place=np.array([0.0, 0.0, -1.0])) is None


def test_a_trail_sends_its_last_block_and_forgets_its_oldest(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trail, "BLOCK", 2)
    monkeypatch.setattr(trail, "MOST_BLOCKS", 2)
    there: dict[str, Any] = {}

    def add(name: str, *arguments: Any, **options: Any) -> Any:
        there[name] = SimpleNamespace(remove=lambda: there.pop(name))
        return there[name]

    server: Any = SimpleNamespace(scene=SimpleNamespace(add_line_segments=add))
    way = Trail(server, "a")
    for step, commanded in enumerate([True, True, True, False, False, False]):
        way.add(np.array([step, 0.0, 0.0]), commanded)
    way.add(np.array([5.0, 0.0, 0.0]), commanded=False)  # it stands
    way.draw()
    assert list(there) == ["/a path 2", "/a path 3"]
    assert [there["/a path 2"].points[:, :, 0].tolist(), there["/a path 3"].points[:, :, 0].tolist()] == [
        [[2, 3], [3, 4]],
        [[4, 5]],
    ]
    assert there["/a path 2"].colors[:, 0].tolist() == [[*THINKING], [*THINKING]]
    way.clear()
    assert not there
    for north in (9.0, 10.0):
        way.add(np.array([north, 0.0, 0.0]), commanded=True)
    way.draw()
    [begun] = there.values()
    assert begun.points[:, :, 0].tolist() == [[9, 10]]  # not from where it was


@contextmanager
def served(folder: Path) -> Iterator[str]:
    """The address of a page that the command line has opened."""
    command = [sys.executable, "-m", "uavaccel", "watch", "--port", "18080"]
    with subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            line = process.stdout.readline()
            assert line.startswith("watch at http://127.0.0.1:"), line
            yield line.split()[2].rstrip(";")
        finally:
            process.terminate()


@needs_opengl
@pytest.mark.slow
@pytest.mark.skipif(not CHROMIUM.exists(), reason="needs Debian's chromium")
def test_a_browser_pauses_steps_and_replays(tmp_path: Path) -> None:
    from playwright.sync_api import sync_playwright

    shots = Path(os.environ.get(SCREENSHOTS, tmp_path))
    with served(tmp_path) as address, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        heard: list[str] = []
        for width, height in ((1280, 720), (390, 844)):
            page = new_page(browser, viewport={"width": width, "height": height})
            page.on("pageerror", lambda error: heard.append(str(error)))
            page.on("request", lambda request: heard.append(request.url))
            page.goto(address)
            clocks = page.locator(".clocks")
            if width == 1280:  # a slow browser would miss the end, and its click on Pause begin anew
                page.get_by_role("combobox", name="Shown at").click()
                page.get_by_role("option", name="0.25x", exact=True).click()
            page.get_by_role("button", name="Replay").click()
            if SCREENSHOTS in os.environ:
                page.wait_for_timeout(12_000)  # some of the path
            page.get_by_role("button", name="Pause").click()
            page.get_by_role("button", name="Play", exact=True).wait_for()
            before = clocks.inner_text()
            page.get_by_role("button", name="Step", exact=True).click()
            page.wait_for_function("before => document.querySelector('.clocks').innerText != before", arg=before)
            stepped = clocks.inner_text()
            assert wall_ms(stepped) - wall_ms(before) == pytest.approx(1.0, abs=0.11)
            page.wait_for_timeout(300)
            assert clocks.inner_text() == stepped
            page.locator("#webgl-software-rendering button").click()
            page.wait_for_timeout(1000)
            page.screenshot(path=shots / f"watch_{width}.png", timeout=120_000)
            page.get_by_role("button", name="Replay").click()
            page.get_by_role("button", name="Pause").wait_for()
            assert page.evaluate("document.documentElement.scrollWidth") <= width
            page.close()
        page = new_page(browser)
        page.goto(address)
        clocks = page.locator(".clocks")
        apart_m = []
        for clock_speed in ("1x", "100x"):
            page.get_by_role("combobox", name="ClockSpeed").click()
            page.get_by_role("option", name=clock_speed, exact=True).click()
            clocks.get_by_text(clock_speed, exact=True).wait_for()
            apart_m.append(leaves_m(clocks.inner_text()))
        assert apart_m[0] < 0.1 * leaves_m(stepped)
        assert apart_m[1] > 1.2 * leaves_m(stepped)
        browser.close()
    strangers = [each for each in heard if not each.startswith((address, "data:", "blob:"))]
    assert not strangers


def new_page(browser: Any, **options: Any) -> Any:
    """A page whose scene is drawn for screenshots alone."""
    page = browser.new_page(device_scale_factor=SCALE, **options)
    page.set_default_timeout(120_000)
    if SCREENSHOTS not in os.environ:
        page.add_init_script(DRAW_NOTHING)
    return page


def wall_ms(clocks: str) -> float:
    """The wall clock that the page shows."""
    return float(clocks.split("wall clock")[1].split("ms")[0])


def leaves_m(clocks: str) -> float:
    """How far, as the page says, ADSC leaves the path of TCSC."""
    return float(clocks.split("by up to")[1].split("m")[0])


def simulated_s(clocks: str) -> float:
    """The simulated time of the last drone that the page shows."""
    return float(re.findall(r"([0-9.]+) s\b", clocks)[-1])
