"""What the page shows, without a browser: replays, running flights and who opens a page for them."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path
from select import select
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest

from tests.golden import assert_as_recorded, numbers
from tests.test_watch_page import MODEL
from tests.web_server import Server
from uavaccel.errors import UsageError, UserError
from uavaccel.files import to_json, write_arrays
from uavaccel.processes import lifetime
from uavaccel.suites.flight import Flight
from uavaccel.watch import beside
from uavaccel.watch import page as pages
from uavaccel.watch.beside import page_beside
from uavaccel.watch.page import Page
from uavaccel.watch.replay import Track, recorded, script_track
from uavaccel.watch.sources import Live, Replay, Told
from uavaccel.wire.broadcast import FREE, PAGE

pytestmark = pytest.mark.usefixtures("without_camera")

# --- replays ---------------------------------------------------------------------------------------------------------


def straight(name: str, clock_speed: float, metres: float, aside_m: float = 0.0, marks: Any = None) -> Track:
    """Northwards for 4 s, at 10 m, so far to the east; a command for the first half of it."""
    arrays = {
        "time_s": np.arange(5.0),
        "position_m": np.array([[metres * share, aside_m, -10.0] for share in (0.0, 0.25, 0.5, 0.75, 1.0)]),
        "orientation_wxyz": np.tile([np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)], (5, 1)),
        "command_start_s": np.array([0.0]),
        "command_end_s": np.array([2.0]),
    }
    return Track(name, Flight.of(f"Flight {name}.", clock_speed, arrays, [(1.0, 0.0, 0.0)]), marks)


def shown(*tracks: Track, **options: Any) -> tuple[Replay, Page, Server]:
    server, replay = Server(2.0), Replay(tracks, **options)
    return replay, Page(server, replay, "A title.", replay.begin), server  # type: ignore[arg-type]


def test_a_replay_goes_by_simulated_seconds_pauses_and_steps() -> None:
    """Four seconds at 50x took 80 ms; at its end it begins anew."""
    replay, page, server = shown(straight("a", 50.0, 4.0))
    controls, said = server.added, list[str]()

    def go(passed_s: float) -> None:
        times = [round(moment.drones[0].time_s, 9) for moment in replay.update(passed_s, True)]
        said.append(f"{passed_s} s later: {times}, held {replay.held}")

    def after(control: str, value: str | None = None) -> None:
        said.append(f"{control} {value or ''}".strip())
        controls[control].click() if value is None else controls[control].choose(value)

    go(1.0)
    go(0.5)
    after("Shown at", "5x")
    go(0.25)
    after("Step")
    go(1.0)
    go(1.0)
    after("Pause")
    go(0.1)
    after("Shown at", pages.FLAT_OUT)
    go(0.02)
    go(1.0)
    after("Pause")
    after("Shown at", "1x")
    go(1.0)
    go(1.0)
    replay.begin()
    page.update(0.0)
    page.update(3.0)
    said += [server.clocks(), *server.shown("/a path"), *list(server.shown("/a"))[:1]]
    assert_as_recorded("watch_replay", "\n".join([*said, ""]))


def test_a_replay_that_is_scrubbed_stays_paused() -> None:
    replay, page, server = shown(straight("a", 50.0, 4.0))
    page.update(0.0)
    page.update(3.5)
    replay.toggle()
    said = []
    for sought_s in (1.5, np.nan, 9.0):
        server.added["Time"].choose(sought_s)
        page.update(1.0)
        said += [f"to {sought_s}: {numbers(replay.progress_s)}, held {replay.held}", *server.shown("/a path")]
    replay.sought_s = 1.0  # from its end
    page.update(0.0)
    assert not replay.held
    assert_as_recorded("watch_scrubbed", "\n".join([*said, ""]))


def test_replays_are_side_by_side_and_held_against_the_last() -> None:
    tracks = [straight("a", 50.0, 4.0, aside_m=3.0), straight("b", 50.0, 5.0), straight("c", 50.0, 4.0)]
    _, page, server = shown(*tracks)
    page.update(0.0)
    places = [line for line in server.shown() if line.count("/") == 1 and (" ideal" in line or " " not in line[:3])]
    assert_as_recorded("watch_side_by_side", "\n".join([server.clocks(), server.views(), *places, ""]))


@pytest.mark.parametrize(
    ("metres", "centre", "reach_m", "follows"),
    [(4.0, 2.0, 3.0, False), (16.0, 8.0, 8.0, False), (30.0, 0.0, 3.0, True)],
)
def test_a_flight_is_seen_whole_or_gone_along_with(metres: float, centre: float, reach_m: float, follows: bool) -> None:
    _, page, server = shown(straight("a", 1.0, metres))
    camera = server.initial_camera
    assert camera.look_at.tolist() == [centre, 0.0, 10.0]
    np.testing.assert_allclose(camera.position - camera.look_at, reach_m * np.array([-1.15, 0.0, 0.85]))
    for passed_s in (0.0, 2.0):
        page.update(passed_s)
    assert camera.look_at.tolist() == [metres / 2 if follows else centre, 0.0, 10.0]
    assert "wall clock 2.000 s" in server.clocks()


def test_another_clock_speed_is_shown_from_its_beginning() -> None:
    replay, page, server = shown(straight("a", 20.0, 4.0), fly_at=lambda speed: [straight("a", speed, 4.0)])
    for passed_s in (0.0, 1.0):
        page.update(passed_s)
    for asked, speed, time_s in (("999999999x", 20.0, 0.0), ("100x", 100.0, 0.0)):
        server.added["ClockSpeed"].choose(asked)
        [moment] = replay.update(5.0, True)
        assert (moment.clock_speed, moment.drones[0].time_s) == (speed, time_s)
    assert replay.update(1.0, True)[-1].wall == "10.0 ms"


def test_a_clock_that_stands_while_the_client_thinks_is_told() -> None:
    marks = np.array([[0.0, 0.0], [0.2, 2.0], [0.3, 2.05], [0.5, 4.0]])  # it stands: a twentieth of ClockSpeed 10
    track = straight("a", 10.0, 4.0, marks=marks)
    said = {0.1: "flies its command", 0.25: "client thinks, clock paused", 0.4: "client thinks, drone flies on"}
    assert {wall_s: track.state(wall_s) for wall_s in said} == said
    assert (track.state(0.5), track.wall_s) == ("done", 0.5)
    assert track.simulated_s(0.25) == pytest.approx(2.025)
    assert [track.towards(time_s) for time_s in (1.0, 2.0)] == [(1.0, 0.0, 0.0), None]
    track.flight.orientation_wxyz[1] = [-1.0, 0.0, 0.0, 0.0]  # a quarter turn, by the farther of its quaternions
    turn = [np.cos(np.pi / 8), 0.0, 0.0, -np.sin(np.pi / 8)]
    np.testing.assert_allclose(track.pose(0.5), [0.5, 0.0, 10.0, *turn], atol=1e-12)
    alone = straight("a", 10.0, 4.0)
    assert (alone.wall_s, alone.simulated_s(0.1), alone.simulated_s(9.0)) == (0.4, 1.0, 4.0)


# --- running flights -------------------------------------------------------------------------------------------------


class Teller:
    """A flight of which only its socket exists, with the vehicles `b` and `a` of MODEL."""

    def __init__(self, path: Path) -> None:
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.socket.connect(str(path))
        self.model = mujoco.MjModel.from_xml_string(MODEL)
        self.qpos = np.arange(14.0)
        self.qpos[[3, 10]] = 1.0
        self.file = path.with_name(f"{id(self)}.mjb")
        mujoco.mj_saveModel(self.model, str(self.file))
        vehicles = [{"name": name, "body": self.model.body(name).id} for name in ("b", "a")]
        self.scene = {"scene": {"model": str(self.file), "qpos": self.qpos.tolist(), "vehicles": vehicles}}

    def send(self, *messages: dict[str, Any]) -> None:
        for message in messages:
            self.socket.send(json.dumps(message).encode())

    def state(self, **changed: Any) -> dict[str, Any]:
        state = {
            "flight": 1,
            "may_pause": True,
            "clock_speed": 5.0,
            "time_ns": 1_500_000_000,
            "wall_ns": 300_000_000,
            "qpos": (self.qpos + 0.5).tolist(),
            "commanded": [True, False],
            "towards": [[1.0, 2.0, 3.0], None],
        }
        return {"state": {**state, **changed}}

    def orders(self) -> list[Any]:
        """The orders that came since it was asked before."""
        self.socket.setblocking(False)
        heard = []
        with contextlib.suppress(BlockingIOError):
            while True:
                heard.append(json.loads(self.socket.recv(4096)))
        return heard


@pytest.fixture
def live(tmp_path: Path) -> Iterator[tuple[Live, list[Teller]]]:
    """A page's ear, and two flights, of which it has heard nothing."""
    source = Live(tmp_path / "page")
    tellers = [Teller(tmp_path / "page") for _ in range(2)]
    with contextlib.closing(source):
        for _ in range(2):
            source.update(0.0, seen=False)
        yield source, tellers
        for teller in tellers:
            teller.socket.close()


def test_a_scene_and_its_moments_are_as_the_flight_has_them(live: tuple[Live, list[Teller]]) -> None:
    """Each vehicle by its own name, at its own place; at ClockSpeed 5 a flight heard of at 100.3 s began at 100."""
    source, (teller, _) = live
    teller.send(teller.state(), teller.scene, teller.state(), teller.state(qpos=[np.nan] * 14))  # unknown, known, apart
    [heard] = source.update(0.1, seen=True)
    scene = source.scene
    assert scene is not None
    assert not teller.file.exists()
    assert (list(scene.bodies), scene.data.qpos.tolist()) == (["b", "a"], teller.qpos.tolist())
    assert scene.centre_m.tolist() == scene.data.xpos[teller.model.body("b").id].tolist() == [7.0, 8.0, 9.0]
    assert heard[1:4] == (True, 5.0, "0.300 s, simulated")
    assert [(each.time_s, *each[2:]) for each in heard.drones] == [
        (1.5, True, (1.0, 2.0, 3.0), "flies its command"),
        (1.5, False, None, "no command"),
    ]
    poses = [each.pose.tolist() for each in heard.drones]
    assert poses == [(teller.qpos[7:] + 0.5).tolist(), (teller.qpos[:7] + 0.5).tolist()]
    flights = [heard.flight]
    for wall_ns, wall in ((100_300_000_000, "0.300"), (100_800_000_000, "0.800")):
        teller.send(teller.state(flight=2, may_pause=False, wall_ns=wall_ns))
        [heard] = source.update(0.1, seen=True)
        assert heard.wall == f"{wall} s, the machine's"
        flights.append(heard.flight)
    assert flights[0] != flights[1] == flights[2]


def test_a_flight_obeys_the_page_while_somebody_looks(live: tuple[Live, list[Teller]]) -> None:
    source, (shown, other) = live
    assert (shown.orders(), other.orders()) == ([FREE], [FREE])
    orders = {"seen": True, "held": False, "pace": 1.0, "refreshes": 0}
    source.update(0.1, seen=True)
    assert (shown.orders(), other.orders()) == ([orders], [])
    source.pace = None
    source.step()
    source.step()
    for _ in range(2):  # once
        source.update(0.1, seen=True)
    held = {**orders, "held": True, "pace": None}
    assert shown.orders() == [{**held, "refreshes": 2}]
    source.toggle()
    source.update(0.1, seen=True)
    source.toggle()
    source.update(0.1, seen=True)
    source.update(0.1, seen=False)  # nobody is there who could let it go on
    assert shown.orders() == [{**held, "held": False}, held, FREE]
    assert other.orders() == []
    shown.socket.close()
    source.update(0.1, seen=True)
    source.toggle()
    source.update(0.1, seen=True)
    assert [world.moments for world in source.worlds] == [[]]


def test_the_first_flight_is_shown_until_it_is_silent(live: tuple[Live, list[Teller]]) -> None:
    source, tellers = live
    for teller in tellers:
        teller.send(teller.scene)
    source.update(0.0, seen=True)
    first, second = source.worlds

    def after(passed_s: float, *speaking: Teller) -> tuple[Told | None, str]:
        for teller in speaking:
            teller.send(teller.state())
        source.update(passed_s, seen=True)
        return source.shown, source.note

    over = "Its clock is paused, or its flight is over."
    assert after(0.4, *tellers) == (first, "")
    assert [after(0.4, tellers[1]) for _ in range(2)] == [(first, ""), (first, over)]
    source.toggle()
    assert [after(0.6, tellers[1]) for _ in range(2)] == [(first, "Paused.")] * 2  # it is held
    source.toggle()
    assert [after(0.4, tellers[1]) for _ in range(3)] == [(first, ""), (first, over), (second, "")]
    tellers[1].send(tellers[1].state(may_pause=False))
    after(0.1)
    source.toggle()
    assert after(0.6) == (second, over)  # it cannot have been paused here
    tellers[1].socket.close()
    assert after(0.1) == (None, over)
    assert after(0.1, tellers[0]) == (first, "")


# --- who opens the page ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("waits", "opened"), [(True, True), (True, False), (False, True)])
def test_a_page_beside_a_command_is_there_while_it_flies(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], waits: bool, opened: bool
) -> None:
    """The command waits for its first spectator where that was asked for, and not for ever."""
    reading, writing = (os.fdopen(end, mode, 0) for end, mode in zip(os.pipe(), ("rb", "wb"), strict=True))
    writing.write(b'{"port": 8123}\n' + (b'{"opened": true}\n' if opened else b""))
    asked: list[Any] = []
    process = SimpleNamespace(
        pid=os.getpid(), stdout=reading, poll=lambda: None, terminate=lambda: asked.append("ended")
    )

    def start(*command: str, **options: Any) -> Any:
        asked.append(command)
        return contextlib.nullcontext(process)

    for name, stand_in in (("free_port", lambda *_: 8123), ("start_python", start)):
        monkeypatch.setattr(beside, name, stand_in)
    monkeypatch.setattr(beside, "end_within", lambda *_: None)
    monkeypatch.setattr(beside, "FIRST_SPECTATOR_S", 0.01)
    monkeypatch.setattr("sys.argv", ["uavaccel", "run", "a `b`"])
    monkeypatch.delenv(PAGE, raising=False)
    with reading, writing:
        with page_beside(waits, 8100, "127.0.0.9"):
            (_, module, told), socket_path = asked[0], os.environ[PAGE]
            assert asked[1:] == []
            assert bool(select([reading], [], [], 0.0)[0]) == (opened and not waits)  # nobody has read that line
        assert (PAGE in os.environ, asked[1:]) == (False, ["ended"])
    options = json.loads(told)
    assert module == "uavaccel.watch.beside"
    assert options == {
        "host": "127.0.0.9",
        "port": 8100,
        "socket": socket_path,
        "title": "`uavaccel run 'a b'`",
        "parent": os.getpid(),
    }
    begins = "the flight begins when it is opened, or in 0.01 s" if waits else "Ctrl-C ends"
    assert capsys.readouterr().out == f"watch at http://127.0.0.9:8123; {begins}\n"


def test_the_pages_process_tells_its_port_and_its_first_spectator_and_leaves_nothing(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """It yields to the flight, and ends with the command, whose folder goes too."""
    (tmp_path / "flights").mkdir()
    options = {"host": "127.0.0.9", "port": 8100, "socket": f"{tmp_path}/flights/one", "title": "A title", "parent": 77}
    monkeypatch.setattr("sys.argv", ["", json.dumps(options)])
    done: list[Any] = []
    monkeypatch.setattr(beside, "end_with_parent", lambda parent, first: done.append((parent, first)))
    monkeypatch.setattr(os, "nice", done.append)
    server = SimpleNamespace(get_port=lambda: 8123)

    def opened(*asked: Any) -> Any:
        done.append(asked)
        return server

    monkeypatch.setattr(beside, "open_server", opened)
    monkeypatch.setattr("uavaccel.watch.sources.Live", str)
    browsers: list[threading.Thread] = []
    shown = SimpleNamespace(run=lambda: done.append("run"))

    def page(*told: Any) -> Any:
        browsers.append(threading.Thread(target=told[-1]))  # one that comes before the port is told
        browsers[0].start()
        done.append(told[:-1])
        return shown

    monkeypatch.setattr(pages, "Page", page)
    beside.main()
    (parent, leave), *then = done
    assert (parent, then) == (77, [
        5, ("127.0.0.9", 8100, pages.head_of("A title")), (server, f"{tmp_path}/flights/one", "A title"), "run",
    ])  # fmt: skip
    assert signal.getsignal(signal.SIGINT) is signal.SIG_DFL
    leave()
    assert not (tmp_path / "flights").exists()
    browsers[0].join()
    assert capsys.readouterr().out == '{"port": 8123}\n{"opened": true}\n'


@pytest.mark.wall_clock
@pytest.mark.parametrize(("end", "said"), [
    ("signal.SIGKILL", ["warning: the page's process was ended by SIGKILL; the flight goes on, unwatched"]),
    ("signal.SIGINT", []),
])  # fmt: skip
def test_a_page_that_dies_is_said_in_one_line(
    end: str, said: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """And a killed command's folder is gone with the next one; at Ctrl-C the page has every reason to end."""
    dies = (
        "import os, signal; signal.signal(signal.SIGINT, signal.SIG_DFL);"
        f"print('{{\"port\": 1}}', flush=True); os.kill(os.getpid(), {end})"
    )
    monkeypatch.setattr(beside, "start_python", lambda *_, **options: lifetime.start_python("-c", dies, **options))
    monkeypatch.setattr(lifetime, "POLL_S", 1 / 64)
    watches: list[lifetime.Watch] = []

    def watched(*arguments: Any) -> lifetime.Watch:
        watches.append(lifetime.Watch(*arguments))
        return watches[0]

    monkeypatch.setattr(beside, "Watch", watched)
    left = Path(tempfile.gettempdir(), f"uavaccel-watch-{2**22 + 1}-left")  # no process has that id
    left.mkdir()
    with page_beside(waits=False, port=18093):
        assert not left.exists()
        watches[0]._thread.join()
    told = capsys.readouterr().out.splitlines()  # that may be before the page's address is
    assert [line for line in told if not line.startswith("watch at ")] == said


def test_a_page_that_does_not_open_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("free_port", "end_within"):
        monkeypatch.setattr(beside, name, lambda *_: None)
    with open(os.devnull, "rb") as nothing:
        process = SimpleNamespace(stdout=nothing, terminate=lambda: None)
        monkeypatch.setattr(beside, "start_python", lambda *_, **__: contextlib.nullcontext(process))
        with pytest.raises(UserError, match="could not be opened"), page_beside():
            pass


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """What `uavaccel watch` shows: the page's arguments, what was flown and what was looked for."""
    shown: dict[str, Any] = {"flown": []}
    server = SimpleNamespace(get_port=lambda: 8123, stop=lambda: shown.update(stopped=True))

    def page(_: Any, source: Any, title: str, opened: Any) -> Any:
        shown.update(source=source, title=title, opened=opened)
        return SimpleNamespace(run=interrupted)

    def interrupted() -> None:
        raise KeyboardInterrupt  # the end of every page

    def fly(clock_speed: float, *how: Any, **named: Any) -> list[Track]:
        shown["flown"].append((clock_speed, how, named))
        return [straight("a", clock_speed, 4.0)]

    monkeypatch.setattr(beside, "open_server", lambda *at: (shown.update(at=at[:2]), server)[1])
    monkeypatch.setattr("uavaccel.watch.page.Page", page)
    monkeypatch.setattr("uavaccel.watch.replay.fly_side_by_side", fly)
    return shown


def test_the_square_is_flown_at_every_clock_speed_chosen(
    opened: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    beside.show(None, None, None, (50.0, 0.0125, 7), "127.0.0.9", 8100)
    assert opened["at"] == ("127.0.0.9", 8100)
    assert "thinks for 12.5 ms" in opened["title"]
    opened["source"].fly_at(5.0)
    opened["source"].update(0.1, True)
    assert opened["flown"] == [(speed, (), {"think_s": 0.0125, "rounds": 1, "seed": 7}) for speed in (50.0, 5.0)]
    assert opened["opened"] == opened["source"].begin  # who comes first has missed nothing
    assert opened["stopped"]
    assert capsys.readouterr().out == "watch at http://127.0.0.9:8123; Ctrl-C ends\n"
    for case, game in (("a", None), (None, 0)):
        with pytest.raises(UsageError, match="need a run directory"):
            beside.show(None, case, game, (50.0, 0.0, 0), "127.0.0.9", 8100)


def test_a_finished_game_is_shown_as_it_was_asked_for(
    opened: dict[str, Any], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    asked: list[Any] = []
    track = straight("a", 2.0, 4.0)

    def find(*which: Any) -> Track:
        asked.append(which)
        return track

    monkeypatch.setattr("uavaccel.watch.replay.recorded", find)
    for case, game in (("a", None), (None, 3)):
        beside.show(tmp_path, case, game, (50.0, 0.0, 0), "127.0.0.9", 8100)
        assert asked[-1] == (tmp_path, case, game)
        assert (opened["title"], opened["source"].fly_at) == (track.flight.title, None)
    assert not opened["flown"]


# --- finished flights ------------------------------------------------------------------------------------------------


def script_flight(folder: Path, *messages: dict[str, Any], **summary: Any) -> Path:
    """What `fly --out` keeps of 4 simulated seconds at ClockSpeed 2, eastwards."""
    folder.mkdir()
    (folder / "messages.jsonl").write_text("".join(to_json(row) + "\n" for row in messages))
    (folder / "flight.json").write_text(json.dumps({"clock_speed": 2.0, "script_s": 2.5, **summary}))
    place = np.zeros((5, 3))
    place[:, 1] = np.arange(5)
    arrays = {"time_ns": np.arange(5) * 1_000_000_000, "position_m": place}
    write_arrays(folder / "trajectory.npz", arrays | {"orientation_wxyz": np.tile([1.0, 0, 0, 0], (5, 1))})
    return folder


def test_a_scripts_commands_end_with_answers_or_the_next_one(tmp_path: Path) -> None:
    """Answered in time, answered after the next command had begun, and never asked for."""

    def call(number: int, wall_s: float, method: str, *params: Any) -> dict[str, Any]:
        wall_ns = round(wall_s * 1e9)
        return {"call": number, "wall_ns": wall_ns, "time_ns": 2 * wall_ns, "method": method, "params": [*params]}

    def answer(number: int, wall_s: float) -> dict[str, Any]:
        return {"answer": number, "wall_ns": round(wall_s * 1e9), "result": True}

    yaw = (0, {"is_rate": True, "yaw_or_rate": 0.0}, "")
    track = script_track(
        script_flight(
            tmp_path / "flight",
            call(1, 0.25, "ping"),
            answer(1, 0.25),
            call(2, 0.5, "moveByVelocity", 1.0, 2.0, 3.0, 5.0, *yaw),
            answer(2, 0.75),
            call(3, 1.0, "moveByVelocityZ", 4.0, 5.0, -6.0, 5.0, *yaw),
            call(4, 1.5, "moveToPosition", 1.0, 2.0, 3.0, 5.0, 60.0, *yaw, -1.0, 1.0),
            answer(3, 1.75),
            scene="lane",
        )
    )
    assert (track.name, track.flight.clock_speed, track.flight.scene) == ("script at 2x", 2.0, "lane")
    assert track.start_s.tolist() == [1.0, 2.0, 3.0]
    assert track.end_s.tolist() == [1.5, 3.0, 4.0]
    assert [track.towards(at) for at in (1.25, 2.5, 3.5)] == [(1.0, 2.0, 3.0), (4.0, 5.0, 0.0), None]
    assert track.marks.tolist() == [[0, 0], [0.25, 0.5], [0.5, 1], [1, 2], [1.5, 3], [2.5, 4]]
    assert track.wall_s == 2.5  # until the script's end
    replay = recorded(tmp_path / "flight")
    assert (replay.flight.scene, replay.marks.tolist()) == ("lane", track.marks.tolist())


def test_a_measured_flight_took_its_time_over_its_clock_speed(tmp_path: Path) -> None:
    ping: dict[str, Any] = {"call": 1, "wall_ns": 5, "time_ns": None, "method": "ping", "params": []}
    track = script_track(script_flight(tmp_path / "flight", ping))
    assert track.marks.tolist() == [[0.0, 0.0], [2.0, 4.0]]
    assert (track.flight.scene, track.start_s.tolist(), track.towards(1.0)) == ("blocks", [], None)
