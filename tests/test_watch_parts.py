"""The parts of a page without a browser: solids and planes, views, clocks, what flights tell, and who opens it."""

from __future__ import annotations

import contextlib
import json
import os
import socket
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest

from uavaccel.errors import UsageError, UserError
from uavaccel.files import to_json, write_arrays
from uavaccel.processes import child
from uavaccel.watch import beside, scene, server
from uavaccel.watch import show as command
from uavaccel.watch.beside import PageAddress, page_beside
from uavaccel.watch.clocks import Line, clock_table
from uavaccel.watch.feed import Source
from uavaccel.watch.replay import recorded
from uavaccel.watch.script_flight import script_track
from uavaccel.watch.view import FARTHER, FROM_BEHIND, LOWER, Views
from uavaccel.wire.page_protocol import FREE, PAGE, Orders

# A floor of 6 x 4 m whose texture, red above green, repeats thrice northwards and twice westwards; solids of every
# kind; a hull, a geom far below, and a vehicle that is turned by a quarter and has a rotor beside its middle.
MODEL = """
<mujoco>
  <asset>
    <texture name="halves" type="2d" builtin="gradient" rgb1="1 0 0" rgb2="0 1 0" width="8" height="8"/>
    <texture name="grey" type="2d" builtin="checker" rgb1="1 1 1" rgb2="0 0 0" width="4" height="4"/>
    <material name="floor" texture="halves" texrepeat="3 2"/>
    <material name="wall" texture="grey" rgba="1 0.5 0 1"/>
    <mesh name="wedge" vertex="0 0 0  3 0 0  0 3 0  0 0 3"/>
  </asset>
  <worldbody>
    <geom type="plane" size="3 2 1" material="floor" pos="0 0 0.5"/>
    <geom type="box" size="1 2 3" pos="10 0 3" material="wall"/>
    <geom type="sphere" size="2" pos="0 20 2" rgba="0 0 1 1"/>
    <geom type="cylinder" size="1 4" pos="0 -20 4" rgba="0 0 1 1" euler="90 0 0"/>
    <geom type="box" size="9 9 9" group="3" pos="40 0 0"/>
    <geom type="box" size="9 9 9" pos="60 0 -60"/>
    <body name="drone" pos="0 0 5">
      <freejoint/>
      <geom type="box" size="0.3 0.1 0.05" rgba="0 0 0 1"/>
      <geom type="cylinder" size="0.1 0.01" pos="0.2 0 0.05" rgba="1 1 1 1"/>
    </body>
    <body name="second" pos="2 0 5">
      <freejoint/>
      <geom type="ellipsoid" size="1 2 3" rgba="1 0 0 1"/>
      <geom type="capsule" size="1 2" rgba="1 0 0 1"/>
      <geom type="mesh" mesh="wedge" rgba="1 0 0 1"/>
    </body>
  </worldbody>
</mujoco>
"""


class Stage:
    """Stands in for a page's scene: keeps what was added, by name, and forgets what is removed."""

    def __init__(self) -> None:
        self.added: dict[str, tuple[tuple[Any, ...], dict[str, Any]]] = {}

    def __getattr__(self, add: str) -> Any:
        return lambda name, *arguments, **options: self.added.__setitem__(name, (arguments, options))

    def remove_by_name(self, name: str) -> None:
        self.added = {each: value for each, value in self.added.items() if not each.startswith(name)}


@pytest.fixture
def model() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(MODEL)


@pytest.fixture
def stage() -> Any:
    return SimpleNamespace(scene=Stage())


def box_of(added: tuple[tuple[Any, ...], dict[str, Any]]) -> list[list[float]]:
    """The corners of a mesh."""
    vertices = added[0][0]
    return [vertices.min(axis=0).round(6).tolist(), vertices.max(axis=0).round(6).tolist()]


# --- the scene -------------------------------------------------------------------------------------------------------


def test_surroundings_are_what_is_drawn_and_no_vehicle_a_mesh_for_each_colour(
    model: mujoco.MjModel, stage: Any
) -> None:
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    for _ in range(2):  # the second time in place of the first
        scene.show_surroundings(stage, model, data)
    added = stage.scene.added
    assert sorted(added) == [
        "/surroundings", "/surroundings/plane0", "/surroundings/solids 0", "/surroundings/solids 1",
    ]  # fmt: skip
    wall, blue = added["/surroundings/solids 0"], added["/surroundings/solids 1"]
    assert box_of(wall) == [[9.0, -2.0, 0.0], [11.0, 2.0, 6.0]]
    assert wall[1]["color"] == (127, 63, 0)  # its material's colour, times its texture's mean
    assert blue[1]["color"] == (0, 0, 255)
    assert box_of(blue) == [[-2.0, -24.0, 0.0], [2.0, 22.0, 5.0]]  # the sphere, and the cylinder that lies


def test_a_floor_is_as_large_as_its_plane_and_repeats_its_picture(model: mujoco.MjModel, stage: Any) -> None:
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    scene.show_surroundings(stage, model, data)
    (picture, width, height), options = stage.scene.added["/surroundings/plane0"]
    assert (width, height, options["position"].tolist()) == (6.0, 4.0, [0.0, 0.0, 0.5])
    rows, columns = picture.shape[0] // 2, picture.shape[1] // 3
    assert picture.shape == (2 * 1024, 3 * 682, 3)
    for down in range(2):
        for across in range(3):
            tile = picture[down * rows : (down + 1) * rows, across * columns : (across + 1) * columns]
            np.testing.assert_array_equal(tile, picture[:rows, :columns])
    endless = model
    endless.geom_size[0] = 0.0
    scene.show_surroundings(stage, endless, data)
    assert stage.scene.added["/surroundings/plane0"][0][1:] == (200.0, 200.0)


def test_a_plane_without_a_texture_has_its_own_colour(model: mujoco.MjModel) -> None:
    model.geom_matid[0] = -1
    model.geom_rgba[0] = (0.2, 0.4, 1.0, 1.0)
    assert np.unique(scene.plane_picture(model, 0).reshape(-1, 3), axis=0).tolist() == [[51, 102, 255]]


def test_a_drone_is_its_own_geoms_where_they_are_on_it(model: mujoco.MjModel, stage: Any) -> None:
    scene.show_drone(stage, "/a", model, model.body("drone").id)
    assert list(stage.scene.added) == ["/a/body 0", "/a/body 1"]
    assert box_of(stage.scene.added["/a/body 0"]) == [[-0.3, -0.1, -0.05], [0.3, 0.1, 0.05]]
    assert box_of(stage.scene.added["/a/body 1"]) == [[0.1, -0.1, 0.04], [0.3, 0.1, 0.06]]


def test_a_mesh_is_turned_and_placed_as_its_file_has_it(model: mujoco.MjModel, stage: Any) -> None:
    """MuJoCo keeps meshes in the frame of their inertia."""
    scene.show_drone(stage, "/b", model, model.body("second").id)
    wedge = stage.scene.added["/b/body 0"][0][0][-4:]
    corners = [[0.0, 0.0, 0.0], [0.0, 0.0, 3.0], [0.0, 3.0, 0.0], [3.0, 0.0, 0.0]]
    np.testing.assert_allclose(sorted((wedge.round(5) + 0.0).tolist()), corners, atol=1e-4)


def test_solids_have_the_sizes_of_their_geoms(model: mujoco.MjModel) -> None:
    """MuJoCo's are half lengths; a mesh keeps its volume and its place is its centre's."""
    first = int(model.body("second").geomadr[0])
    for geom, halves in ((first, (1.0, 2.0, 3.0)), (first + 1, (1.0, 1.0, 3.0))):
        mesh = scene.geom_mesh(model, geom)
        assert mesh is not None
        np.testing.assert_allclose(mesh.bounds, [[-half for half in halves], halves], atol=0.05)
    wedge = scene.geom_mesh(model, first + 2)
    assert wedge is not None
    assert abs(wedge.volume) == pytest.approx(4.5)
    assert (len(wedge.vertices), len(wedge.faces)) == (4, 4)


def test_a_vehicles_pose_is_its_own_part_of_the_state(model: mujoco.MjModel) -> None:
    found = [scene.pose_of(model, model.body(name).id) for name in ("drone", "second")]
    assert found == [slice(0, 7), slice(7, 14)]


# --- views -----------------------------------------------------------------------------------------------------------


class Pages:
    """Stands in for the server of browsers, of which each has a camera of this aspect."""

    def __init__(self, *aspects: float) -> None:
        self.initial_camera = SimpleNamespace()
        self.clients = {
            number: SimpleNamespace(camera=SimpleNamespace(aspect=aspect, position=np.array([9.0, 9.0, 9.0])))
            for number, aspect in enumerate(aspects)
        }
        self.connected: Any = None

    def get_clients(self) -> dict[int, Any]:
        return self.clients

    def on_client_connect(self, act: Any) -> None:
        self.connected = act


def test_a_view_is_from_behind_and_above_and_lower_and_farther_on_a_phone() -> None:
    server: Any = Pages(2.0, 0.5)
    views = Views(server, lambda: None)
    centre, back = np.array([1.0, 2.0, 3.0]), 4.0 * np.array([-1.15, 0.0, 0.85])
    assert (FROM_BEHIND, LOWER, FARTHER) == ((-1.15, 0.0, 0.85), 0.3, 1.5)
    for wide, times in ((True, 3.0), (False, 1.0)):  # 1.5 times 2, the height over the width
        views.look_at(centre, 4.0, wide)
        views.aim_all()
        screen, phone = (client.camera for client in server.clients.values())
        np.testing.assert_allclose(server.initial_camera.position, centre + back)
        np.testing.assert_allclose(screen.position, centre + back)
        np.testing.assert_allclose(screen.look_at, centre)
        np.testing.assert_allclose(phone.position, centre + times * back)
        below = [0.0, 0.0, 0.3 * times * np.linalg.norm(back)]
        np.testing.assert_allclose(phone.look_at, centre - below)


def test_a_view_goes_along_by_as_much_as_the_drone_and_keeps_what_was_chosen() -> None:
    server: Any = Pages(2.0)
    views = Views(server, lambda: None)
    views.look_at(np.zeros(3), 2.0)
    [client] = server.clients.values()
    views.follow(np.array([0.01, 0.0, 0.0]))  # less than it is worth
    assert client.camera.position.tolist() == [9.0, 9.0, 9.0]
    views.follow(np.array([1.0, -2.0, 0.5]))
    assert client.camera.position.tolist() == [10.0, 7.0, 9.5]
    views.follow(np.array([1.0, -2.0, 1.5]))
    assert client.camera.position.tolist() == [10.0, 7.0, 10.5]
    np.testing.assert_allclose(server.initial_camera.look_at, [1.0, -2.0, 1.5])
    np.testing.assert_allclose(server.initial_camera.position, [-1.3, -2.0, 3.2])


def test_only_the_first_browser_begins_the_show() -> None:
    server: Any = Pages(2.0)
    begun: list[bool] = []
    Views(server, lambda: begun.append(True))
    for others in (0, 1):
        server.clients = {number: SimpleNamespace(camera=SimpleNamespace(aspect=1.0)) for number in range(others + 1)}
        server.connected(server.clients[others])
    assert begun == [True]


# --- clocks ----------------------------------------------------------------------------------------------------------


def test_the_table_of_clocks_has_a_line_for_each_drone_and_its_height_where_there_is_ground() -> None:
    lines = [Line("a<b", 1.005, 2.46, "flies & thinks"), Line("low", 61.5, 0.0, "done"), Line("c", 0.0, None, "")]
    table = clock_table(2.5, "0.100 s", lines, "1 < 2")
    assert "ClockSpeed <b>2.5x</b>" in table
    assert "<b>0.100 s</b>" in table
    rows = [row.split("</tr>")[0] for row in table.split("<tr>")[1:]]
    cells = [[cell.split(">", 1)[1].split("</td>")[0] for cell in row.split("<td")[1:]] for row in rows]
    assert cells == [
        ["<b>a&lt;b</b>", f"{1.005:.2f} s", "2.5 m up", "flies &amp; thinks"],
        ["<b>low</b>", "61.50 s", "0.0 m up", "done"],
        ["<b>c</b>", "0.00 s", "", ""],
    ]
    assert "1 &lt; 2</p></div>" in table
    assert clock_table(100.0, "0 s", []).endswith("<table style='width:100%;line-height:1.5'></table></div>")


# --- what flights tell -----------------------------------------------------------------------------------------------


@pytest.fixture
def told() -> Iterator[tuple[Source, socket.socket]]:
    """A source, and the flight's end of its socket."""
    page, flight = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    page.setblocking(False)
    flight.settimeout(5.0)
    with page, flight:
        yield Source(page), flight


def test_orders_are_sent_when_they_change_and_looks_leave_them_as_they_are(told: tuple[Source, socket.socket]) -> None:
    source, flight = told
    held: Orders = {"seen": True, "held": True, "pace": 0.5, "refreshes": 0}
    source.let_pass(2)
    for orders in (held, held, FREE):
        source.order(orders)
        if orders is held:
            source.let_pass(3)
    heard = [json.loads(flight.recv(4096)) for _ in range(5)]
    assert heard == [{**FREE, "refreshes": 2}, held, {**held, "refreshes": 3}, {**held, "refreshes": 3}, FREE]
    flight.setblocking(False)
    with pytest.raises(BlockingIOError):
        flight.recv(4096)
    flight.close()
    source.order(held)  # to a flight that has ended
    assert not source.receive()


def test_a_scene_and_its_moments_are_as_the_flight_has_them(
    told: tuple[Source, socket.socket], model: mujoco.MjModel, tmp_path: Path
) -> None:
    """Each vehicle by its own name, at its own place; times in seconds."""
    source, flight = told
    file = tmp_path / "scene.mjb"
    mujoco.mj_saveModel(model, str(file))
    qpos = np.arange(14.0)
    qpos[[3, 10]] = 1.0
    vehicles = [{"name": name, "body": model.body(name).id} for name in ("second", "drone")]
    moment = {
        "flight": 2, "may_pause": False, "clock_speed": 5.0, "time_ns": 1_500_000_000, "wall_ns": 300_000_000,
        "qpos": (qpos + 0.5).tolist(), "commanded": [True, False], "towards": [[1.0, 2.0, 3.0], None],
    }  # fmt: skip
    for message in (
        {"moment": moment},  # of a scene that is not yet known
        {"scene": {"model": str(file), "qpos": qpos.tolist(), "vehicles": vehicles}},
        {"moment": moment},
    ):
        flight.send(json.dumps(message).encode())
    assert source.receive()
    assert source.scene is not None
    assert not file.exists()
    assert source.scene.data.qpos.tolist() == qpos.tolist()
    assert source.scene.data.xpos[model.body("second").id].tolist() == [7.0, 8.0, 9.0]
    [heard] = source.moments
    assert heard[:5] == (2, False, 5.0, 1.5, 0.3)
    assert heard.poses.tolist() == [(qpos[7:] + 0.5).tolist(), (qpos[:7] + 0.5).tolist()]
    assert heard[6:] == ((True, False), ((1.0, 2.0, 3.0), None))


# --- who opens the page ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("waits", "opened"), [(True, True), (True, False), (False, True)])
def test_a_page_beside_a_command_is_there_for_as_long_as_it_flies(
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

    for name, stand_in in (("check_viser", lambda: None), ("free_port", lambda *_: 8123), ("start_python", start)):
        monkeypatch.setattr(beside, name, stand_in)
    monkeypatch.setattr(beside, "end_within", lambda *_: None)
    monkeypatch.setattr(beside, "FIRST_SPECTATOR_S", 0.01)
    monkeypatch.setattr("sys.argv", ["uavaccel", "run", "a `b`"])
    monkeypatch.delenv(PAGE, raising=False)
    with reading, writing:
        with page_beside(PageAddress("127.0.0.9", 8100), waits):
            (_, module, told), socket_path = asked[0], os.environ[PAGE]
            assert asked[1:] == []
            assert beside._within(process.stdout, 0.0) == (opened and not waits)  # nobody has read that line
        assert (PAGE in os.environ, asked[1:]) == (False, ["ended"])
    options = json.loads(told)
    assert module == "uavaccel.watch.live"
    assert options == {
        "host": "127.0.0.9",
        "port": 8100,
        "socket": socket_path,
        "title": "`uavaccel run 'a b'`",
        "parent": os.getpid(),
    }
    begins = "the flight begins when it is opened, or in 0.01 s" if waits else "Ctrl-C ends"
    assert capsys.readouterr().out == f"watch at http://127.0.0.9:8123; {begins}\n"


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
    monkeypatch.setattr(beside, "start_python", lambda *_, **options: child.start_python("-c", dies, **options))
    monkeypatch.setattr(beside, "check_viser", lambda: None)
    monkeypatch.setattr(child, "POLL_S", 1 / 64)
    watches: list[child.Watch] = []

    def watched(*arguments: Any) -> child.Watch:
        watches.append(child.Watch(*arguments))
        return watches[0]

    monkeypatch.setattr(beside, "Watch", watched)
    left = Path(tempfile.gettempdir(), f"uavaccel-watch-{2**22 + 1}-left")  # no process has that id
    left.mkdir()
    with page_beside(PageAddress(port=18093), waits=False):
        assert not left.exists()
        watches[0]._thread.join()
    assert capsys.readouterr().out.splitlines()[1:] == said


def test_a_page_that_does_not_open_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    with open(os.devnull, "rb") as nothing, pytest.raises(UserError, match="could not be opened"):
        beside._port_of(nothing)


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """What `uavaccel watch` shows: the page's arguments, what was flown and what was looked for."""
    shown: dict[str, Any] = {"flown": []}
    server = SimpleNamespace(get_port=lambda: 8123, stop=lambda: shown.update(stopped=True))

    def page(*arguments: Any) -> Any:
        shown["page"] = arguments
        return SimpleNamespace(run=lambda: None)

    monkeypatch.setattr(command, "check_viser", lambda: None)
    monkeypatch.setattr(command, "open_server", lambda host, port: (shown.update(at=(host, port)), server)[1])
    monkeypatch.setattr(command, "Page", page)
    monkeypatch.setattr(
        command, "fly_side_by_side", lambda *how, **named: (shown["flown"].append((how, named)), ["tracks"])[1]
    )
    return shown


def test_the_square_is_flown_as_asked_for_and_at_every_clock_speed_that_is_chosen(
    opened: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    command.show(None, None, None, (50.0, 0.0125, 7), "127.0.0.9", 8100)
    _, tracks, where, title, _, fly_at = opened["page"]
    assert (opened["at"], tracks, where) == (("127.0.0.9", 8100), ["tracks"], "blocks")
    assert "thinks for 12.5 ms" in title
    fly_at(5.0)
    assert opened["flown"] == [((speed, 0.0125), {"rounds": 1, "seed": 7}) for speed in (50.0, 5.0)]
    assert opened["stopped"]
    assert capsys.readouterr().out == "watch at http://127.0.0.9:8123; Ctrl-C ends\n"
    for case, game in (("a", None), (None, 0)):
        with pytest.raises(UsageError, match="need a run directory"):
            command.show(None, case, game, (50.0, 0.0, 0), "127.0.0.9", 8100)


def test_a_finished_game_is_shown_where_and_as_it_was_asked_for(
    opened: dict[str, Any], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    asked: list[Any] = []
    replay = SimpleNamespace(track="track", scene="lane", title="A game.", lane="its lane")

    def recorded(*which: Any) -> Any:
        asked.append(which)
        return replay

    monkeypatch.setattr("uavaccel.watch.replay.recorded", recorded)
    for case, game in (("a", None), (None, 3)):
        command.show(tmp_path, case, game, (50.0, 0.0, 0), "127.0.0.9", 8100)
        assert asked[-1] == (tmp_path, case, game)
        assert opened["page"][1:] == (["track"], "lane", "A game.", "its lane", None)
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


def test_a_scripts_commands_end_with_their_answers_or_at_the_next_one(tmp_path: Path) -> None:
    """Answered in time, answered after the next command had begun, and never asked for."""

    def call(number: int, wall_s: float, method: str, *params: Any) -> dict[str, Any]:
        wall_ns = round(wall_s * 1e9)
        return {"call": number, "wall_ns": wall_ns, "time_ns": 2 * wall_ns, "method": method, "params": [*params]}

    def answer(number: int, wall_s: float) -> dict[str, Any]:
        return {"answer": number, "wall_ns": round(wall_s * 1e9), "result": True}

    yaw = (0, {"is_rate": True, "yaw_or_rate": 0.0}, "")
    track, where = script_track(
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
    assert (track.name, track.clock_speed, where) == ("script at 2x", 2.0, "lane")
    assert track.command_start_s.tolist() == [1.0, 2.0, 3.0]
    assert track.command_end_s.tolist() == [1.5, 3.0, 4.0]
    assert track.velocities == [(1.0, 2.0, 3.0), (4.0, 5.0, 0.0), None]
    assert track.marks.tolist() == [[0, 0], [0.25, 0.5], [0.5, 1], [1, 2], [1.5, 3], [2.5, 4]]
    assert track.wall_s == 2.5  # until the script's end
    replay = recorded(tmp_path / "flight")
    assert (replay.scene, replay.track.marks.tolist()) == ("lane", track.marks.tolist())


def test_a_flight_on_the_machines_clock_took_its_time_over_its_clock_speed(tmp_path: Path) -> None:
    ping: dict[str, Any] = {"call": 1, "wall_ns": 5, "time_ns": None, "method": "ping", "params": []}
    track, where = script_track(script_flight(tmp_path / "flight", ping))
    assert track.marks.tolist() == [[0.0, 0.0], [2.0, 4.0]]
    assert (where, track.command_start_s.tolist(), track.velocities) == ("blocks", [], [])


# --- who may look ----------------------------------------------------------------------------------------------------

OWN = "127.0.0.1:8080"


@pytest.mark.parametrize(
    ("host", "origin", "answered"),
    [
        (OWN, None, True),
        (OWN, f"http://{OWN}", True),
        ("localhost:9000", "http://localhost:9000", True),
        ("[::1]:8080", "https://[::1]:8080", True),
        ("192.168.0.7:8080", "http://192.168.0.7:8080", True),
        ("lab:8080", "http://LAB:8080", True),
        (OWN, "http://127.0.0.1:8081", False),
        (OWN, "https://example.org", False),
        (OWN, "null", False),
        (OWN, f"ftp://{OWN}", False),
        ("example.org:8080", None, False),
        ("example.org:8080", "http://example.org:8080", False),
        ("127.0.0.1.example.org", None, False),
        ("localhost@example.org", None, False),
        ("[", None, False),
        ("", None, False),
        (None, None, False),
    ],
)
def test_the_page_answers_its_own_alone(host: str | None, origin: str | None, answered: bool) -> None:
    """Neither another website's page, nor one whose name leads to this machine."""
    headers = pytest.importorskip("websockets").Headers()
    for name, value in (("Host", host), ("Origin", origin)):
        if value is not None:
            headers[name] = value
    assert server.is_ours(headers, "lab") is answered
    if host is not None:
        headers["Host"] = OWN  # a second one
        assert not server.is_ours(headers, "lab")


def asked(port: int, *more: str, host: str = "") -> tuple[socket.socket, bytes]:
    """A connection, and the status of the answer."""
    connection = socket.socket()
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    connection.connect(("127.0.0.1", port))
    lines = ["GET / HTTP/1.1", f"Host: {host or f'127.0.0.1:{port}'}", *more, "", ""]
    connection.sendall("\r\n".join(lines).encode())
    return connection, connection.recv(12)[-3:]


@pytest.mark.filterwarnings("ignore:.control_layout:DeprecationWarning")  # of viser's newer versions
def test_a_foreign_page_gets_nothing_and_one_that_does_not_read_is_dropped(monkeypatch: pytest.MonkeyPatch) -> None:
    viser = pytest.importorskip("viser")
    monkeypatch.setattr(server, "UNREAD_MS", 100)
    page = server.open_server("127.0.0.1", 18180)
    try:
        port = page.get_port()
        socket_of = (
            *("Upgrade: websocket", "Connection: Upgrade", "Sec-WebSocket-Version: 13"),
            *("Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==", f"Sec-WebSocket-Protocol: viser-v{viser.__version__}"),
        )
        statuses = []
        for more in ((), socket_of):
            for host, origin in (("", "http://example.org"), ("example.org", "http://example.org")):
                connection, status = asked(port, f"Origin: {origin}", *more, host=host)
                connection.close()
                statuses.append(status)
        assert statuses == [b"403"] * 4
        deaf, status = asked(port, f"Origin: http://127.0.0.1:{port}", *socket_of)
        assert status == b"101"
        dropped = threading.Event()
        page._websock_server.on_client_disconnect(lambda _: dropped.set())
        for number in range(32):  # more than the system keeps for it
            page.scene.add_point_cloud(f"/{number}", np.zeros((50_000, 3), np.float32), np.zeros((50_000, 3)))
        assert dropped.wait(30.0)
        deaf.close()
    finally:
        page.stop()
