"""The page without a browser: the scene, drones and paths, views, clocks, controls, and who may look.

What a browser would be shown is recorded as text (tests/golden.py).
"""

from __future__ import annotations

import errno
import importlib
import socket
import threading
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock
from urllib.request import urlopen

import mujoco
import numpy as np
import pytest

from tests.golden import assert_as_recorded, numbers
from tests.web_server import Server
from uavaccel.clock import VirtualClock
from uavaccel.errors import UserError
from uavaccel.sim.camera.view import HEIGHT, WIDTH
from uavaccel.units import NS_PER_S
from uavaccel.watch import beside
from uavaccel.watch import page as pages
from uavaccel.watch import scene as scenes
from uavaccel.watch.page import FLAT_OUT, DroneState, Moment, Page, Source, Views, clock_table, head_of, legend
from uavaccel.watch.scene import Drone, Eyes, Scene

pytestmark = pytest.mark.usefixtures("without_camera")

# A floor of 6 x 4 m whose texture, red above green, repeats thrice northwards and twice westwards; solids of every
# kind; hulls, a geom far below, and a vehicle that is turned by a quarter and has a rotor beside its middle.
MODEL = """
<mujoco>
  <asset>
    <texture name="halves" type="2d" builtin="gradient" rgb1="1 0 0" rgb2="0 1 0" width="8" height="4" mark="edge"/>
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
    <body name="a" pos="0 0 5">
      <freejoint/>
      <geom type="box" size="0.3 0.1 0.05" rgba="0 0 0 1"/>
      <geom type="cylinder" size="0.1 0.01" pos="0.2 0 0.05" rgba="1 1 1 1"/>
      <geom type="sphere" size="0.4" group="3"/>
    </body>
    <body name="b" pos="20 0 5">
      <freejoint/>
      <geom type="ellipsoid" size="1 2 3" rgba="1 0 0 1"/>
      <geom type="capsule" size="1 2" rgba="0 1 0 1"/>
      <geom type="mesh" mesh="wedge" rgba="0 0 1 1"/>
    </body>
  </worldbody>
</mujoco>
"""
POSTS = """
<mujoco>
  <asset>
    <texture name="bands" type="2d" builtin="checker" rgb1="1 1 1" rgb2="0.2 0.2 0.2" width="64" height="64"/>
    <material name="post" texture="bands" texrepeat="0.5 2" rgba="1 0.5 0 1"/>
  </asset>
  <worldbody><geom type="{shape}" size="1 2 2" pos="0 0 2" material="post"/></worldbody>
</mujoco>"""


def scene_of(*names: str, model: str = MODEL, **more: Any) -> Scene:
    made = mujoco.MjModel.from_xml_string(model)
    data = mujoco.MjData(made)
    mujoco.mj_forward(made, data)
    return Scene(made, data, {name: made.body(name).id for name in names}, np.array([1.0, 2.0, 3.0]), **more)


# --- the scene -------------------------------------------------------------------------------------------------------


def test_surroundings_are_what_is_drawn_and_no_vehicle() -> None:
    """A mesh for each colour, a picture for each floor, shown twice the second in place of the first; posts' bands."""
    said: list[str] = []

    def show(scene: Scene) -> None:
        scenes.show_surroundings(server, scene)  # type: ignore[arg-type]

    server, scene = Server(), scene_of("a")
    show(scene)
    show(scene)
    said += [*server.shown(), "a floor of one colour and without an end:"]
    scene.model.geom_size[0], scene.model.geom_matid[0], scene.model.geom_rgba[0] = 0.0, -1, (0.2, 0.4, 1.0, 1.0)
    show(scene)
    said += server.shown("/surroundings/plane")
    for shape in ("box", "cylinder"):
        server = Server()
        show(scene_of(model=POSTS.format(shape=shape)))
        said += [f"bands of a {shape}, the dark one at the bottom:", *server.shown("/surroundings/solids")]
    assert_as_recorded("watch_surroundings", "\n".join([*said, ""]))


def test_a_drone_has_its_geoms_path_arrow_and_shadow() -> None:
    """The floor is at 0.5 m. MuJoCo's frame is north, west, up, and the drone is shown 1 m to the west."""
    server, scene = Server(), scene_of("a", "b")
    drone, _ = (Drone(server, name, scene, np.array([0.0, 1.0, 0.0])) for name in "ab")  # type: ignore[arg-type]
    drone.begin(np.array([[0.0, 0.0, 2.0], [1.0, 0.0, 2.0], [1.0, 1.0, 2.0]]))
    said = [*server.shown()]
    for height_m, towards in ((3.5, (0.0, 2.0, 0.0)), (0.16, (1.0, 0.0, 0.0)), (0.14, (0.0, 0.0, 0.0)), (-1.0, None)):
        drone.show(np.array([1.0, -1.0, 0.5 + height_m, 0.5, 0.5, 0.5, 0.5]), towards)
        said += [f"{height_m} m up, found {numbers([drone.height_m or np.nan])}, towards {towards}:"]
        said += [
            line
            for part in ("/a;", "/a command", "/a shadow", "/a plumb")
            for line in server.shown("/a")
            if line.startswith(part)
        ]
    bodies = scene.bodies.values()
    assert [scenes.pose_of(scene.model, body) for body in bodies] == [slice(0, 7), slice(7, 14)]
    assert_as_recorded("watch_drone", "\n".join([*said, ""]))


def test_a_path_is_sent_in_blocks_and_begins_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scenes, "BLOCK", 2)
    monkeypatch.setattr(scenes, "MOST_BLOCKS", 2)
    server, pose = Server(), np.array([0.0, 0.0, 5.0, 1.0, 0.0, 0.0, 0.0])
    drone, said = Drone(server, "a", scene_of("a"), np.zeros(3)), list[str]()  # type: ignore[arg-type]

    def go(begun: str, *norths: tuple[float, bool]) -> None:
        for north, commanded in norths:
            drone.go_to(np.array([north, 0.0, 0.0]), commanded)
        drone.show(pose, None)
        said.extend([f"{begun}:", *server.shown("/a path")])

    steps = [True, True, True, False, False, True]
    go("six places", *((float(n), commanded) for n, commanded in enumerate(steps)), (5.0, False))  # and it stands
    drone.begin(None)
    go("begun anew")
    go("not from where it was", (9.0, True), (10.0, True))
    assert_as_recorded("watch_path", "\n".join([*said, ""]))


def test_events_are_of_what_passed_since_the_last_image(monkeypatch: pytest.MonkeyPatch) -> None:
    """They begin anew after a jump: neither after standing, nor after jumps."""
    data = SimpleNamespace(qpos=np.zeros(9))
    camera = SimpleNamespace(colour=lambda _: np.zeros((HEIGHT, WIDTH, 3), np.uint8))
    eyes = Eyes(camera, data, slice(1, 8))  # type: ignore[arg-type]
    stepped: list[float] = []

    def step(sensor: Any, state: Any, image: Any, time_s: float) -> Any:
        stepped.append(time_s)
        return state, np.ones((HEIGHT, WIDTH), int), np.zeros((HEIGHT, WIDTH), int)

    monkeypatch.setattr(scenes, "step", step)
    for time_s in (5.0, 5.0, 5.1, 5.2, 9.0, 9.125, 2.0, 2.125, 2.375):
        picture = eyes.render(np.arange(1.0, 8.0), time_s)
    assert stepped == pytest.approx([0.1, 0.2, 0.125, 0.125])
    assert (picture.shape, picture[0, 0].tolist()) == ((2 * HEIGHT, WIDTH, 3), [0, 0, 0])
    assert picture[-1, 0, 2] > picture[-1, 0, 0]  # ON is blue, as browsers have it
    assert data.qpos.tolist() == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 0.0]


# --- views and clocks ------------------------------------------------------------------------------------------------


def test_a_view_is_from_behind_and_above_and_goes_along() -> None:
    """Farther away on a phone; a move that is not worth it leaves all as somebody has chosen."""
    server, begun, said = Server(2.0, 0.5), list[bool](), list[str]()
    views, centre = Views(server, lambda: begun.append(True)), np.array([1.0, 2.0, 3.0])  # type: ignore[arg-type]
    for wide in (True, False):
        views.look_at(centre, 4.0, wide)
        said.append(f"wide {wide}: {server.views()}")
    server.clients[0].camera.position = np.full(3, 9.0)
    for moved in ([0.01, 0.0, 0.0], [1.0, -2.0, 0.5], [1.0, -2.0, 1.5]):
        views.follow(centre + moved)
        said.append(f"moved by {moved}: {server.views()}")
    server.connected(server.clients[1])
    server.clients.pop(0)
    server.connected(server.clients[1])
    assert begun == [True]  # the first browser alone begins the show
    assert_as_recorded("watch_views", "\n".join([*said, ""]))


def test_clocks_legend_and_title_are_html() -> None:
    drones = [("a<b", 1.004, 2.46, "flies & thinks"), ("low", 61.5, 0.0, "done"), ("c", 0.0, None, "")]
    tables = [clock_table(2.5, "0.100 s", drones, "1 < 2"), clock_table(2.5, "0.100 s", drones)]
    head = head_of("Game `a<b` of **two**: TCSC at 1.5x. More.").partition("<style>")
    assert head[1]
    said = "\n".join([*tables, legend(""), legend("TCSC"), head[0], ""])
    assert_as_recorded("watch_html", said.replace("><", ">\n<"))


# --- the page --------------------------------------------------------------------------------------------------------


class Told(Source):
    """A flight as a test tells it."""

    step_hint = "on"

    def __init__(self, scene: Scene | None) -> None:
        self.scene = scene
        self.told: Sequence[Moment] = []

    def update(self, passed_s: float, seen: bool) -> Sequence[Moment]:
        return self.told


class Recorded(Told):
    """One that can be scrubbed."""

    at_s, length_s = 0.0, 8.123

    @property
    def progress_s(self) -> tuple[float, float]:
        return self.at_s, self.length_s


POSE = [1.0, 2.0, 3.0, 1.0, 0.0, 0.0, 0.0]
STATE = DroneState(10.0, np.array(POSE), True, (1.0, 0.0, 0.0), "flies")
MOMENT = Moment(1, True, 4.0, "2.500 s", [STATE])


class Opened:
    """A page, its server, and what it is told."""

    def __init__(self, *names: str, source: type[Told] = Told, **more: Any) -> None:
        self.server, self.source = Server(2.0), source(scene_of(*names, **more) if names else None)
        self.page = Page(self.server, self.source, "A title.", lambda: None)  # type: ignore[arg-type]

    def tell(self, *moments: Moment) -> None:
        self.source.told = moments
        self.page.update(0.1)


def test_every_drone_has_its_own_path_in_each_flight() -> None:
    opened, said = Opened("a", "b", apart_m=4.0), list[str]()
    pair = [STATE._replace(does="x"), DroneState(11.0, np.array([4.0, 5.0, 6.0, 0, 1.0, 0, 0]), False, None, "y")]

    def both(flight: int, metres: float = 0.0) -> Moment:
        farther = [each._replace(pose=each.pose + metres, commanded=each.commanded == (metres == 0.0)) for each in pair]
        return MOMENT._replace(flight=flight, drones=farther)

    def tell(begun: str, *moments: Moment) -> None:
        opened.tell(*moments)
        told = [line for line in opened.server.shown() if not line.startswith("/surroundings") and "/body" not in line]
        said.extend([f"{begun}: {opened.server.clocks()}", *told])

    tell("2 m aside, beyond the floor", both(1), both(1, 1.0))
    opened.tell(MOMENT)  # of another scene, with one drone
    opened.source.ideal_m = {"b": np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])}
    tell("another flight, with an ideal path", both(2), both(2, 2.0))
    clients, opened.server.clients = opened.server.clients, {}
    opened.tell(both(2))
    opened.server.clients = clients
    opened.tell(both(2))
    tell("from where somebody looks again", both(2, 1.0))
    assert_as_recorded("watch_drones", "\n".join([*said, ""]))


def test_controls_are_those_of_the_flight_and_tell_its_player() -> None:
    opened, said = Opened(), list[str]()
    controls, source = opened.server.added, opened.source

    def look(begun: str) -> None:
        buttons = [
            f"{controls[name].label}{' (off)' * controls[name].disabled}" for name in ("Pause", "Step", "Shown at")
        ]
        player = f"held {source.held}, steps {source.steps}, pace {source.pace}, shown at {controls['Shown at'].value}"
        said.append(f"{begun}: {', '.join(buttons)}; {player}; looks at {opened.server.initial_camera.look_at}")
        said.append(f"  {opened.server.clocks()}")

    assert not {"Time", "ClockSpeed"} & controls.keys()  # it goes on, and cannot begin anew
    look("opened")
    opened.tell(MOMENT)  # before it has told its scene
    source.scene = scene_of("a")
    for flight, may_pause in enumerate((False, True, False)):
        opened.tell(MOMENT._replace(flight=flight, may_pause=may_pause))
        look(f"may pause {may_pause}")
    for pace in ("0.25x", "20x", "1e-9x", FLAT_OUT):
        controls["Shown at"].choose(pace)
        look(f"shown at {pace}")
    source.note = "Paused."
    for button in ("Pause", "Pause", "Step"):
        controls[button].click()
        opened.tell()
        look(f"clicked {button}")
    assert controls[""].content == "No pictures: no OpenGL"
    for follow in (False, True):
        controls["Follow"].choose(follow)
        opened.tell(MOMENT._replace(drones=[STATE._replace(pose=STATE.pose + 1.0)]))
        look(f"follow {follow}")
    assert_as_recorded("watch_controls", "\n".join([*said, ""]))


def test_a_show_goes_on_by_the_machines_clock_but_for_flying_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each update takes half a second, which is shown next, unless another flight has begun in it."""
    clock, passed_s = VirtualClock(), list[float]()
    monkeypatch.setattr(pages, "MonotonicClock", lambda: clock)

    class Slow(Told):
        def update(self, passed: float, seen: bool) -> Sequence[Moment]:
            passed_s.append(passed)
            if len(passed_s) == 5:
                raise KeyboardInterrupt
            clock.charge(NS_PER_S // 2)
            return [MOMENT._replace(flight=len(passed_s) // 3)]

    with pytest.raises(KeyboardInterrupt):
        Opened("a", source=Slow).page.run()
    assert passed_s == pytest.approx([1 / 30, 1 / 30, 0.5, 1 / 30, 0.5])


def test_a_recorded_flight_is_scrubbed_by_spectators_alone() -> None:
    opened = Opened("a", source=Recorded)
    source: Any = opened.source
    time = opened.server.added["Time"]
    assert time.arguments[1:3] == (0.0, 8.12)
    source.at_s = 3.456
    for length_s in (8.12, 4.0):  # it is flown at another ClockSpeed
        source.length_s = length_s
        for _ in range(pages.PICTURES_EVERY):
            opened.tell(MOMENT)
        assert (time.value, time.max) == (3.46, length_s)
    sought = [source.sought_s]
    time.choose(1.25)
    for _ in range(pages.PICTURES_EVERY):
        opened.tell(MOMENT)
    assert [*sought, source.sought_s] == [None, 1.25]
    assert time.value == 3.46  # where the source is
    places = iter((5.0, 6.0, 7.0))  # to which it is moved while the page is at work
    source.update = lambda *_: [MOMENT] if time.choose(next(places)) is None else []
    for place in (5.0, 6.0, 7.0):
        opened.page.update(0.1)
        assert time.value == place


def test_drones_see_from_their_own_places_every_third_update(monkeypatch: pytest.MonkeyPatch) -> None:
    """Those of the first body."""

    class Seen:
        def __init__(self, camera: Any, data: Any, pose: slice) -> None:
            assert pose == slice(0, 7)

        def render(self, pose: Any, time_s: float) -> Any:
            return pose.tolist(), time_s

    monkeypatch.setattr(pages, "make_camera", lambda *_: None)
    monkeypatch.setattr(pages, "Eyes", Seen)
    opened = Opened("a", "b")
    first: Any = opened.source.scene
    opened.tell(MOMENT._replace(drones=[STATE, STATE]))

    def images() -> dict[str, Any]:
        return {name: each.image for name, each in opened.server.added.items() if name.endswith("camera, events")}

    assert list(images()) == ["a: camera, events"]
    opened.source.scene = Scene(first.model, first.data, {"a": first.bodies["a"], "c": first.bodies["a"]}, np.zeros(3))
    for time_s in (3.0, 4.0, 5.0):
        other = STATE._replace(time_s=7.0, pose=np.array([2.0, *POSE[1:]]))
        opened.tell(MOMENT._replace(drones=[STATE._replace(time_s=time_s), other]))
    assert images() == {"a: camera, events": (POSE, 5.0), "c: camera, events": ([2.0, *POSE[1:]], 7.0)}
    opened.source.scene = Scene(first.model, first.data, {"c": first.bodies["a"]}, np.zeros(3))
    opened.tell(MOMENT)
    assert list(images()) == ["c: camera, events"], "no picture of a drone that is gone"


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
        (OWN, "null", False),
        (OWN, f"file://{OWN}", False),
        ("example.org:8080", None, False),
        ("example.org:8080", "http://example.org:8080", False),
        *((host, None, False) for host in ("localhost@example.org", "[", "", None)),
    ],
)
def test_the_page_answers_its_own_alone(host: str | None, origin: str | None, answered: bool) -> None:
    """Neither another website's page, nor one whose name leads to this machine."""
    headers = pytest.importorskip("websockets").Headers()
    for name, value in (("Host", host), ("Origin", origin)):
        if value is not None:
            headers[name] = value
    assert beside.is_ours(headers, "lab") is answered
    headers["Host"] = OWN
    assert beside.is_ours(headers, "lab") is (host is None)  # elsewhere it is a second one


def asked(port: int, *more: str, host: str = "") -> tuple[socket.socket, bytes]:
    """A connection, and the status of the answer."""
    connection = socket.socket()
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    connection.connect(("127.0.0.1", port))
    lines = ["GET / HTTP/1.1", f"Host: {host or f'127.0.0.1:{port}'}", *more, "", ""]
    connection.sendall("\r\n".join(lines).encode())
    return connection, connection.recv(12)[-3:]


@pytest.mark.filterwarnings("ignore:.control_layout:DeprecationWarning")  # of viser's newer versions
def test_a_foreign_page_gets_nothing_and_a_deaf_one_is_dropped(monkeypatch: pytest.MonkeyPatch) -> None:
    viser = pytest.importorskip("viser")
    servers = importlib.import_module("websockets.asyncio.server")
    monkeypatch.setattr(beside, "UNREAD_MS", 100)
    serve = servers.serve
    page = beside.open_server("127.0.0.1", 18180, head_of("What flies."))
    try:
        assert servers.serve is serve, "other servers are as they were"
        port = page.get_port()
        socket_of = (
            *("Upgrade: websocket", "Connection: Upgrade", "Sec-WebSocket-Version: 13"),
            *("Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==", f"Sec-WebSocket-Protocol: viser-v{viser.__version__}"),
        )
        with urlopen(f"http://127.0.0.1:{port}/") as answer:
            document = answer.read()
            assert answer.headers.get_all("Content-Length") == [str(len(document))]
        assert b"<title>What flies \xe2\x80\x93 uavaccel</title><style>" in document
        for more in ((), socket_of):
            for host in ("", "example.org"):
                connection, status = asked(port, "Origin: http://example.org", *more, host=host)
                connection.close()
                assert status == b"403"
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


def test_the_first_free_port_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert beside.free_port("127.0.0.1", port) > port
    assert beside.free_port("127.0.0.1", port) == port
    with pytest.raises(UserError, match=r"at 127\.0\.0\.1: no port is free from 65536 on"):
        beside.free_port("127.0.0.1", 1 << 16)
    create, refused = socket.create_server, PermissionError(errno.EACCES, "Permission denied")  # below 1024, if no root
    monkeypatch.setattr(socket, "create_server", Mock(side_effect=[refused, refused, create(("127.0.0.1", 0))]))
    assert beside.free_port("127.0.0.1", 80) == 82
