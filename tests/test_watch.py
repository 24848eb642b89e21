"""A flight as it is watched: tracks, the playhead, and the page in a browser that clicks."""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from tests.opengl import needs_opengl
from uavaccel.commands import COMMANDS, VelocityGoal
from uavaccel.commands.paths import velocities
from uavaccel.watch.playhead import Playhead
from uavaccel.watch.square import T_MOVE_S, fly_side_by_side
from uavaccel.watch.track import Track, track_of

CHROMIUM = Path("/usr/bin/chromium")
FLAGS = ["--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync"]
FLAGS += ["--disable-background-networking", "--disable-component-update"]
FLAGS += ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
SCREENSHOTS = "UAVACCEL_SCREENSHOTS"  # a folder that keeps those of this test, as those of docs/watch.md


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
            page = browser.new_page(viewport={"width": width, "height": height})
            page.set_default_timeout(120_000)
            page.on("pageerror", lambda error: heard.append(str(error)))
            page.on("request", lambda request: heard.append(request.url))
            page.goto(address)
            clocks = page.locator(".clocks")
            page.get_by_role("button", name="Pause").click()
            page.get_by_role("button", name="Play", exact=True).wait_for()
            before = clocks.inner_text()
            page.get_by_role("button", name="Step", exact=True).click()
            page.wait_for_function(
                "before => document.querySelector('.clocks').innerText != before", arg=before
            )
            stepped = clocks.inner_text()
            assert wall_ms(stepped) - wall_ms(before) == pytest.approx(1.0, abs=0.11)
            page.wait_for_timeout(300)
            assert clocks.inner_text() == stepped
            page.screenshot(path=shots / f"watch_{width}.png", timeout=120_000)
            page.get_by_role("button", name="Replay").click()
            page.get_by_role("button", name="Pause").wait_for()
            assert page.evaluate("document.documentElement.scrollWidth") <= width
            page.close()
        browser.close()
    strangers = [each for each in heard if not each.startswith((address, "data:", "blob:"))]
    assert not strangers


def wall_ms(clocks: str) -> float:
    """The wall clock that the page shows."""
    return float(clocks.split("wall clock")[1].split("ms")[0])
