"""--watch: a running flight on a page: it is shown, held, let go, and not changed by any of that."""

from __future__ import annotations

import contextlib
import json
import os
import select
import socket
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.flying import STRAIGHT, call, go_on, hovering, point, pose
from tests.learning import tiny_config
from tests.running import configured, fly_into
from tests.scripts import fly_here
from tests.serving import running_server
from uavaccel.cli.experiments import run_experiment
from uavaccel.clock import VirtualClock
from uavaccel.commands import COMMANDS, VelocityGoal
from uavaccel.envs.obstacle_lane import ObstacleLane
from uavaccel.errors import UsageError
from uavaccel.fly.options import FlightOptions
from uavaccel.records import RunDirectory
from uavaccel.sim.profile import NATIVE
from uavaccel.sim.simulation import Simulation
from uavaccel.sim.world import World
from uavaccel.suites.dp1 import Dp1
from uavaccel.suites.evaluate import Evaluation
from uavaccel.suites.session import RunRequest
from uavaccel.suites.train import Training
from uavaccel.units import NS_PER_S
from uavaccel.watch import beside
from uavaccel.watch.beside import page_beside
from uavaccel.watch.page import Moment
from uavaccel.watch.sources import Live, Told
from uavaccel.wire import broadcast
from uavaccel.wire.api import Api
from uavaccel.wire.broadcast import FREE, PAGE, REFRESH_NS, Broadcast, heading, show_on_page
from uavaccel.wire.session import open_session

POLL_S = 16 * 0.002  # 16 ticks, the whole number nearest to REFRESH_NS
SCRIPT = """
import airsim
client = airsim.MultirotorClient()
client.enableApiControl(True)
client.moveByVelocityAsync(2, 0, 0, 3).join()
client.reset()
client.enableApiControl(True)
client.moveByVelocityAsync(0, 2, -1, 3).join()
"""


@pytest.fixture
def feed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Live]:
    """The page's ear, to which every simulation of this process speaks."""
    path = tmp_path / "page"
    listening = Live(path)
    monkeypatch.setenv(PAGE, str(path))
    yield listening
    listening.close()


def flown() -> dict[str, np.ndarray]:
    """Two commands of 2 s each."""
    with open_session("lockstep") as session:
        client, command = session.start_game(10.0), COMMANDS["tcsc"]
        command.begin(client)
        for velocity in ((2.0, 0.0, 0.0), (0.0, 2.0, -1.0)):
            list(command.fly(client, VelocityGoal(velocity), 2.0, 2.0))
        return client.recording().arrays()


class Flight:
    """A flight in a thread, held from its first refresh on, and what the page has heard of it."""

    def __init__(self, feed: Live) -> None:
        self.feed, self.arrays = feed, dict[str, np.ndarray]()
        feed.held = True
        self._thread = threading.Thread(target=lambda: self.arrays.update(flown()))
        self._thread.start()
        while not feed.worlds:
            feed.update(0.0, seen=True)
        self.world: Told = feed.worlds[0]
        self.last: Moment | None = None

    def heard(self, until_s: float) -> list[float]:
        """The simulated times of the moments up to this one, after which none may come for a while."""
        times: list[float] = []
        silent, left = threading.Event(), 10
        while left:
            silent.wait(0.005)
            moments = self.feed.update(0.005, seen=True)
            times += [moment.drones[0].time_s for moment in moments]
            self.last = moments[-1] if moments else self.last
            left -= bool(times) and times[-1] > until_s - 1e-6
        return times

    def end(self) -> dict[str, np.ndarray]:
        self.world.order(FREE)
        self._thread.join()
        return self.arrays


def test_a_held_flight_steps_and_goes_on_to_the_same_bytes(feed: Live) -> None:
    """And tells clocks, pose and command."""
    assert round(REFRESH_NS / 2_000_000) * 0.002 == POLL_S
    flight = Flight(feed)
    assert flight.heard(POLL_S) == [POLL_S]
    for _ in range(8):
        feed.step()
    assert flight.heard(9 * POLL_S)[-1] == pytest.approx(9 * POLL_S)
    arrays, moment = flight.end(), flight.last
    assert moment is not None
    row = int(np.searchsorted(arrays["time_s"], moment.drones[0].time_s))
    between = arrays["position_m"][row - 1 : row + 1, 0]
    assert between.min() <= moment.drones[0].pose[0] <= between.max()
    assert (moment.may_pause, moment.clock_speed, moment.wall) == (True, 10.0, f"{0.9 * POLL_S:.3f} s, simulated")
    assert moment.drones[0][2:4] == (True, (2.0, 0.0, 0.0))
    assert flight.world.scene is not None
    assert list(flight.world.scene.bodies) == ["SimpleFlight"]
    feed.close()
    alone = flown()
    assert {name: array.tobytes() for name, array in arrays.items()} == {
        name: array.tobytes() for name, array in alone.items()
    }


@pytest.mark.parametrize(
    ("method", "params", "towards"),
    [  # at 2 m north and 1 m east of where the command found it, and 10 m up
        ("moveByVelocity", [1.0, -2.0, 0.5, 9.0, 0, STRAIGHT], (1.0, -2.0, 0.5)),
        ("moveByVelocityZ", [1.0, -2.0, -14.0, 9.0, 0, STRAIGHT], (1.0, -2.0, -4.0)),
        ("rotateByYawRate", [10.0, 9.0], (-2.0, -1.0, 0.0)),
        ("moveByRollPitchYawZ", [0.1, 0.0, 0.0, -14.0, 9.0], None),
        ("moveByAngleRatesThrottle", [0.1, 0.0, 0.0, 0.6, 9.0], None),
        ("moveByMotorPWMs", [0.6, 0.6, 0.6, 0.6, 9.0], None),
    ],
)
def test_a_command_leads_by_its_velocity_or_to_its_place(
    method: str, params: list[Any], towards: tuple[float, ...] | None
) -> None:
    api = hovering()
    call(api, method, *params)
    call(api, "simSetVehiclePose", pose(2.0, 1.0, -10.0), True)
    assert heading(api.simulation.world.lead) == (None if towards is None else pytest.approx(towards))


def test_a_flight_goes_on_when_the_page_has_gone(feed: Live) -> None:
    flight = Flight(feed)
    flight.heard(POLL_S)
    feed.close()
    assert len(flight.end()["time_s"]) > 80


def test_a_lanes_obstacles_and_a_further_game_are_told(feed: Live) -> None:
    keys: dict[str, Any] = {"observation": "state", "timing": "lockstep"}
    shown = threading.Event()

    def fly_lanes() -> None:
        with contextlib.closing(ObstacleLane(**keys)) as environment:
            for lane in (3, 4):
                environment.reset(seed=lane, options={"lane": lane})
                environment.step(2)
                shown.wait(60.0)  # both scenes at once would be one to a page that listens late
                shown.clear()

    thread = threading.Thread(target=fly_lanes)
    thread.start()
    flights: set[Any] = set()
    scenes: list[Any] = []
    while thread.is_alive() or len(flights) < 2:  # the last moments may come after the flights' end
        feed.pace = 20.0
        flights |= {moment.flight for moment in feed.update(0.0, seen=True)}
        if feed.scene is not None and feed.scene not in scenes:
            scenes.append(feed.scene)
            shown.set()
    thread.join()
    assert len(flights) == 2
    places = {scene.data.geom_xpos.tobytes() for scene in scenes}
    assert len(places) >= 2  # each lane has its own obstacles


def test_an_object_that_a_script_spawns_is_shown(feed: Live, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("uavaccel.wire.broadcast.SCENE_NS", 0)
    monkeypatch.setattr("uavaccel.wire.broadcast.UNSEEN_NS", 0)
    api = Api(Simulation(World("blocks", NATIVE, airsim=True)), render=False)
    show_on_page(api.simulation, may_pause=False)
    scenes = []
    for name in ("crate", "hut"):
        call(api, "simSpawnObject", name, "Cube", pose(5.0, 0.0, -3.0), point(1.0, 1.0, 1.0), False, False)
        go_on(api, 0.1)
        feed.update(0.0, seen=False)
        feed.update(0.0, seen=True)
        scenes.append(feed.scene.model.geom_rgba[:, 3] if feed.scene else np.zeros(0))
    assert (scenes[1] > 0.0).sum() == (scenes[0] > 0.0).sum() + 1


def test_a_scene_for_which_a_busy_page_has_no_room_leaves_no_file_and_is_told_later(
    feed: Live, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("SCENE_NS", "UNSEEN_NS"):
        monkeypatch.setattr(f"uavaccel.wire.broadcast.{name}", 0)
    api = Api(Simulation(World("blocks", NATIVE)), render=False)
    with monkeypatch.context() as patch:
        patch.setattr(Broadcast, "_send", lambda *_: False)
        show_on_page(api.simulation, may_pause=False)
        assert [*tmp_path.glob("*.mjb")] == []
    go_on(api, 0.1)
    for seen in (False, True):
        feed.update(0.0, seen=seen)
    assert feed.scene is not None


def test_a_page_is_told_as_often_as_it_looks_and_of_each_reset(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By flight and ms; orders are heard after a message, whose pauses are of the machine's time."""
    clock, world = VirtualClock(), World("blocks", NATIVE)
    monkeypatch.setattr(broadcast, "MonotonicClock", lambda: clock)
    monkeypatch.setenv(PAGE, str(tmp_path / "page"))
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as listening:
        listening.bind(str(tmp_path / "page"))
        listening.listen()
        simulation = Simulation(world, 20.0)
        show_on_page(simulation, may_pause=False)
        page, _ = listening.accept()
    page.setblocking(False)

    def told(ticks: int, machine_ms: float, **orders: Any) -> list[Any]:
        if orders:
            page.send(json.dumps({**FREE, **orders}).encode())
        found: list[Any] = []
        for tick in range(world.tick + 16, world.tick + ticks + 1, 16):
            clock.charge(round(machine_ms * 1e6))
            simulation.advance_to(simulation.pacer.wall_due(tick))
            with contextlib.suppress(BlockingIOError):
                while message := json.loads(page.recv(1 << 20)):
                    state = message.get("state")
                    found.append((state["flight"], state["time_ns"] // 10**6) if state else "scene")
        return found

    every = int(20.0 * broadcast.MEASURED_NS / REFRESH_NS) * 16
    assert told(every, 500.0) == ["scene", (1, every * 2)]
    assert told(2 * every, 30.0) == [(1, every * 6)], "200 ms where nobody looks"
    assert told(2 * every, 0.5, seen=True) == [], "the order is not heard yet"
    assert told(every, 40.0) == [(1, every * 12)]
    assert told(2 * every, 1.0) == [(1, every * 14), (1, every * 16)]
    for flight in (2, 3):  # the latter at the tick of the last message
        simulation.reset(simulation.wall_ns)
        assert told(every, 1.0) == [(flight, every * 2)]
    world.surroundings_changed()
    assert told(every, 1.0) == ["scene", (3, every * 4)]
    world.surroundings_changed()
    assert told(every, 1.0) == [(3, every * 6)], "200 ms between two scenes"
    assert told(every, 40.0) == ["scene", (3, every * 8)]
    page.close()
    clock.charge(40_000_000)
    simulation.advance_to(simulation.pacer.wall_due(world.tick + every))
    assert not world._observers


def test_a_flight_that_was_held_up_is_not_hurried(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Shown at half its pace, a refresh takes twice its time; those that a stopped machine missed are not made good."""
    clock, took_ns = VirtualClock(), []
    world, ready = World("blocks", NATIVE), select.poll

    class Ready:
        def __init__(self) -> None:
            self._poll = ready()
            self.register = self._poll.register

        def poll(self, milliseconds: float) -> list[Any]:
            if not (found := self._poll.poll(0)):
                clock.charge(round(milliseconds * 1e6))
            return found

    monkeypatch.setattr(broadcast, "MonotonicClock", lambda: clock)
    monkeypatch.setattr(select, "poll", Ready)
    monkeypatch.setenv(PAGE, str(tmp_path / "page"))
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as listening:
        listening.bind(str(tmp_path / "page"))
        listening.listen()
        show_on_page(Simulation(world), may_pause=True)
        page, _ = listening.accept()
    page.send(json.dumps({**FREE, "seen": True, "pace": 0.5}).encode())
    clock.charge(NS_PER_S)
    world.advance(2000)  # the order is heard on the way
    for stopped_ns in (0, 0, NS_PER_S, 0, 0):
        clock.charge(stopped_ns)
        before_ns = clock.now_ns()
        world.advance(16)
        took_ns.append(clock.now_ns() - before_ns)
    assert took_ns == [64_000_000, 64_000_000, 0, 64_000_000, 64_000_000]
    page.close()


@pytest.mark.wall_clock
def test_a_server_on_the_machines_clock_cannot_be_held(feed: Live) -> None:
    heard: list[Moment] = []
    feed.held = True
    with running_server(clock_speed=10.0):
        while not heard or heard[-1].drones[0].time_s < 2.0:
            heard += feed.update(0.0, seen=True)
    assert not any(moment.may_pause for moment in heard)


@pytest.mark.slow
def test_a_trainings_lanes_are_heard_from_their_processes(feed: Live, tmp_path: Path) -> None:
    config = tiny_config({"observation": "state"}, environments=2, mirror=False)
    thread = threading.Thread(target=lambda: fly_into(tmp_path / "run", Training(), config))
    thread.start()
    speaking = set()
    while thread.is_alive():
        feed.update(0.05, seen=False)
        speaking |= {id(world) for world in feed.worlds if world.moments}
    thread.join()
    assert len(speaking) >= 2
    assert len(RunDirectory(tmp_path / "run").rows()) == config.games


@pytest.mark.slow
def test_watching_changes_no_byte_of_runs_and_scripts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a run, an evaluation, and a script."""
    monkeypatch.setattr(beside, "FIRST_SPECTATOR_S", 0.0)
    squares = configured("dp1", clock_speed=[50.0], t_move_s=[0.5], rounds=[1], games=2, timing="virtual", seed=3)
    lanes = configured("evaluate", "task.observation=state", agent="straight", games=2)
    (tmp_path / "script.py").write_text(SCRIPT)
    options = FlightOptions(tmp_path / "script.py", (), tmp_path, clock_speed=10.0, scratch=tmp_path)

    def all_bytes(name: str) -> dict[str, bytes]:
        out = tmp_path / name
        fly_into(out / "dp1", Dp1(), squares)
        fly_into(out / "evaluate", Evaluation(), lanes)
        (out / "fly").mkdir()
        assert fly_here(replace(options, folder=out / "fly")) == 0
        kept = ("rows.jsonl", "*.npz", "messages.jsonl", "trajectory.csv")
        files = [file for pattern in kept for file in sorted(out.rglob(pattern))]
        return {str(file.relative_to(out)): file.read_bytes() for file in files}

    alone = all_bytes("alone")
    with page_beside(port=18090):
        watched = all_bytes("watched")
    assert PAGE not in os.environ
    assert len(alone) > 10
    assert watched == alone


@pytest.mark.parametrize(
    ("engine", "overrides", "said"),
    [("loky", ["simulator=kernels"], "--set simulator=mujoco"), ("ray", [], "--engine")],
)
def test_what_cannot_be_watched_is_refused(
    engine: str, overrides: list[str], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("uavaccel.suites.runner.check_engine", lambda _: None)
    request = RunRequest("evaluate", {}, overrides, out=tmp_path / "run", engine=engine, watch=True)
    with pytest.raises(UsageError, match=f"--watch: .*{said}"):
        run_experiment(request)
    assert not (tmp_path / "run").exists()
