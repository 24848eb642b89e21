"""A flight as it is watched: tracks, the playhead, and the page in a browser that clicks."""

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.opengl import needs_opengl
from uavaccel.commands import COMMANDS, VelocityGoal, velocities
from uavaccel.watch.replay import T_MOVE_S, Track, fly_side_by_side

POLL_S = 16 * 0.002  # between two refreshes, in whole ticks
CHROMIUM = Path("/usr/bin/chromium")
NAMED = "all => all.every(each => each.ariaLabel || each.textContent.trim())"
FLAGS = ["--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync"]
FLAGS += ["--disable-background-networking", "--disable-component-update"]
FLAGS += ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
SCREENSHOTS = "UAVACCEL_SCREENSHOTS"  # a folder that keeps those of this test, as those of docs/watch.md
SCALE = (
    1.0 if SCREENSHOTS in os.environ else 0.25
)  # software WebGL draws a sixteenth of the pixels in a quarter of the time
# Without a GPU a page compiles its shaders for ten seconds, and then draws for as long as it is open: here ten times a
# second, and nothing.
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
window.requestAnimationFrame = draw => setTimeout(() => draw(performance.now()), 100)
window.cancelAnimationFrame = clearTimeout
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
    assert all(tcsc.command(time_s) is not None for time_s in tcsc.time_s[:-1].tolist())
    assert sum(adsc.command(time_s) is None for time_s in adsc.time_s.tolist()) >= 3 * 0.6 / 0.05
    for track in both:
        assert (np.diff(track.marks, axis=0) >= 0.0).all()  # neither clock runs backwards
        issued_s, returned_s = track.marks[::2, 0], track.marks[1::2, 0]
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
    assert alone["position_m"].tobytes() == both[0].flight.position_m.tobytes()
    assert alone["orientation_wxyz"].tobytes() == both[0].flight.orientation_wxyz.tobytes()


def test_the_faster_the_clock_the_farther_adsc_strays(both: list[Track]) -> None:
    slow, fast = (fly_side_by_side(speed, think_s=0.012, rounds=1, seed=0) for speed in (1.0, 100.0))
    apart_m = [adsc.farthest_from(tcsc) for adsc, tcsc in (slow, both, fast)]
    assert apart_m == sorted(apart_m)
    assert apart_m[0] < 0.05
    assert apart_m[1] > 0.3
    adsc, tcsc = both
    nearest = [min(np.linalg.norm(tcsc.flight.position_m - place, axis=1)) for place in adsc.flight.position_m]
    assert adsc.farthest_from(tcsc) == pytest.approx(max(nearest))


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    if not CHROMIUM.exists():
        pytest.skip("needs Debian's chromium")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright, playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS) as browser:
        yield browser


@contextmanager
def served(folder: Path, *command: str) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """The address of a page that the command line has opened, and its process."""
    words = [sys.executable, "-m", "uavaccel", *command]
    with subprocess.Popen(words, cwd=folder, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            line = process.stdout.readline()
            assert line.startswith("watch at http://127.0.0.1:"), line
            yield line.split()[2].rstrip(";"), process
        finally:
            process.terminate()


@needs_opengl
@pytest.mark.slow
def test_a_browser_pauses_steps_and_scrubs(tmp_path: Path, browser: Any) -> None:
    with served(tmp_path, "watch") as (address, _):
        heard: list[str] = []
        page = new_page(browser, viewport={"width": 390, "height": 844})
        page.on("pageerror", lambda error: heard.append(str(error)))
        page.on("request", lambda request: heard.append(request.url))
        page.goto(address)
        clocks = page.locator(".clocks")
        choose(page, "Shown at", "0.25x")  # a slow browser would miss the end, and its click on Pause begin anew
        assert page.title() == "ADSC and TCSC fly one square – uavaccel"
        page.get_by_role("main").get_by_role("slider", name="Time, s").wait_for()
        assert page.get_by_role("heading", level=1).inner_text() == page.title()
        assert page.locator("button, img").evaluate_all(NAMED), "all have names for who hears the page"
        page.locator(".mantine-Slider-track").click(position={"x": 3, "y": 1})
        if SCREENSHOTS in os.environ:
            page.wait_for_timeout(12_000)  # some of the path
        before, stepped = pause_and_step(page)
        assert wall_ms(stepped) - wall_ms(before) == pytest.approx(1.0, abs=0.11)
        page.wait_for_timeout(300)
        assert clocks.inner_text() == stepped
        page.locator("#webgl-software-rendering button").click()
        button, playing = (page.get_by_role("button", name=name, exact=True) for name in ("Step", "Play"))
        scene, panel = (page.locator(name).first.bounding_box() for name in ("canvas", ".mantine-Paper-root"))
        assert scene is not None
        assert panel is not None
        assert scene["y"] + scene["height"] == pytest.approx(panel["y"], abs=1.0) == 844 / 2
        assert panel["width"] == 390
        choose(page, "Shown at", "as fast as it flies")
        for width, height in ((390, 844), (1280, 720)):
            page.set_viewport_size({"width": width, "height": height})
            if SCREENSHOTS in os.environ:
                page.wait_for_timeout(1000)
                page.screenshot(path=Path(os.environ[SCREENSHOTS]) / f"watch_{width}.png", timeout=120_000)
            before_that = None
            for _ in range(100):  # until it is laid out anew, and stays so
                step, scrub = button.bounding_box(), page.locator(".mantine-Slider-track").bounding_box()
                assert step is not None
                assert scrub is not None
                if before_that == (step, scrub) and scrub["y"] < step["y"] + step["height"]:
                    break
                before_that = step, scrub
                page.wait_for_timeout(100)
            assert step["y"] < scrub["y"] < step["y"] + step["height"]  # one row
            assert page.evaluate("document.documentElement.scrollWidth") <= width
        playing.click()
        page.wait_for_function("words => document.querySelector('.clocks').innerText.includes(words)", arg="done")
        assert button.bounding_box() == step  # whatever the clocks say
        apart_m = []
        for clock_speed in ("1x", "100x"):
            choose(page, "ClockSpeed", clock_speed)
            clocks.get_by_text(clock_speed, exact=True).wait_for()
            apart_m.append(leaves_m(clocks.inner_text()))
        assert apart_m[0] < 0.1 * leaves_m(stepped)
        assert apart_m[1] > 1.2 * leaves_m(stepped)
        page.close()
    strangers = [each for each in heard if not each.startswith((address, "data:", "blob:"))]
    assert not strangers


SCRIPT = """
import airsim
client = airsim.MultirotorClient()
client.enableApiControl(True)
client.moveByVelocityAsync(2, 0, 0, 120).join()
"""


@pytest.mark.slow
def test_a_browser_holds_a_flight_and_lets_it_go(tmp_path: Path, browser: Any) -> None:
    (tmp_path / "script.py").write_text(SCRIPT)
    command = ["fly", "--no-settings", "--watch", "--out", "flight", "script.py"]
    with served(tmp_path, *command) as (address, process):
        page = new_page(browser, viewport={"width": 1280, "height": 720})
        page.goto(address)
        before, stepped = pause_and_step(page, "Paused.")
        assert simulated_s(stepped) - simulated_s(before) == pytest.approx(POLL_S, abs=0.011)
        choose(page, "Shown at", "as fast as it flies")
        page.get_by_role("button", name="Play", exact=True).click()
        said, _ = process.communicate(timeout=300)
        page.close()
    assert "2 calls" in said
    assert (tmp_path / "flight" / "trajectory.npz").exists()


def new_page(browser: Any, **options: Any) -> Any:
    """A page whose scene is drawn for screenshots alone."""
    page = browser.new_page(device_scale_factor=SCALE, **options)
    page.set_default_timeout(120_000)
    if SCREENSHOTS not in os.environ:
        page.add_init_script(DRAW_NOTHING)
    return page


def pause_and_step(page: Any, note: str = "") -> tuple[str, str]:
    """What the page says of a flight that it holds, with a note, and after a step of it."""
    clocks = page.locator(".clocks")
    page.get_by_role("button", name="Pause").click()
    page.get_by_role("button", name="Play", exact=True).wait_for()
    clocks.get_by_text(note).first.wait_for()
    before = ""
    while before != (before := clocks.inner_text()):  # what was clicked before may still be under way
        page.wait_for_timeout(300)
    page.get_by_role("button", name="Step", exact=True).click()
    page.wait_for_function("before => document.querySelector('.clocks').innerText != before", arg=before)
    clocks.get_by_text(note).first.wait_for()
    return before, clocks.inner_text()


def choose(page: Any, menu: str, value: str) -> None:
    page.get_by_role("combobox", name=menu).click()
    page.get_by_role("option", name=value, exact=True).click()


def wall_ms(clocks: str) -> float:
    """The wall clock that the page shows."""
    return float(clocks.split("wall clock")[1].split("ms")[0])


def leaves_m(clocks: str) -> float:
    """How far, as the page says, ADSC leaves the path of TCSC."""
    return float(clocks.split("by up to")[1].split("m")[0])


def simulated_s(clocks: str) -> float:
    """The simulated time of the last drone that the page shows."""
    return float(re.findall(r"([0-9.]+) s\b", clocks)[-1])
