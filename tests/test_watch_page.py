"""The page without a browser: the scene, drones and paths, views, clocks, controls, and who may look."""

from __future__ import annotations

import socket
import threading
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any
from urllib.request import urlopen

import mujoco
import numpy as np
import pytest

from tests.web_server import BLUE, VERMILION, Server
from uavaccel.errors import UserError
from uavaccel.sim.camera.view import HEIGHT, WIDTH
from uavaccel.watch import beside
from uavaccel.watch import page as pages
from uavaccel.watch import scene as scenes
from uavaccel.watch.page import FLAT_OUT, DroneState, Moment, Page, Source, Views, clock_table, head_of, legend
from uavaccel.watch.scene import Drone, Eyes, Scene

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
    <body name="a" pos="0 0 5">
      <freejoint/>
      <geom type="box" size="0.3 0.1 0.05" rgba="0 0 0 1"/>
      <geom type="cylinder" size="0.1 0.01" pos="0.2 0 0.05" rgba="1 1 1 1"/>
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


def scene_of(*names: str, **more: Any) -> Scene:
    model = mujoco.MjModel.from_xml_string(MODEL)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return Scene(model, data, {name: model.body(name).id for name in names}, np.array([1.0, 2.0, 3.0]), **more)


def box_of(handle: Any) -> list[list[float]]:
    """The corners of a mesh."""
    vertices = handle.arguments[1]
    return [vertices.min(axis=0).round(6).tolist(), vertices.max(axis=0).round(6).tolist()]


# --- the scene -------------------------------------------------------------------------------------------------------


def test_surroundings_are_what_is_drawn_and_no_vehicle_a_mesh_for_each_colour_and_a_picture_for_each_floor() -> None:
    server, scene = Server(), scene_of("a")
    for _ in range(2):  # the second time in place of the first
        scenes.show_surroundings(server, scene)  # type: ignore[arg-type]
    solids = [f"/surroundings/solids {number}" for number in (0, 1)]
    assert sorted(server.added) == ["/surroundings", "/surroundings/plane0", *solids]
    wall, blue = (server.added[name] for name in solids)
    assert box_of(wall) == [[9.0, -2.0, 0.0], [11.0, 2.0, 6.0]]
    assert wall.options["color"] == (127, 63, 0)  # its material's colour, times its texture's mean
    assert blue.options["color"] == (0, 0, 255)
    assert box_of(blue) == [[-2.0, -24.0, 0.0], [2.0, 22.0, 5.0]]  # the sphere, and the cylinder that lies
    floor = server.added["/surroundings/plane0"]
    picture, *size = floor.arguments[1:]
    assert (size, floor.options["position"].tolist()) == ([6.0, 4.0], [0.0, 0.0, 0.5])
    assert picture.shape == (2 * 1024, 3 * 682, 3)
    np.testing.assert_array_equal(picture, np.tile(picture[:1024, :682], (2, 3, 1)))
    scene.model.geom_size[0], scene.model.geom_matid[0], scene.model.geom_rgba[0] = 0.0, -1, (0.2, 0.4, 1.0, 1.0)
    scenes.show_surroundings(server, scene)  # type: ignore[arg-type]
    picture, *size = server.added["/surroundings/plane0"].arguments[1:]
    assert size == [200.0, 200.0]  # without an end
    assert np.unique(picture.reshape(-1, 3), axis=0).tolist() == [[51, 102, 255]]


@pytest.mark.parametrize("shape", ["box", "cylinder"])
def test_posts_have_their_bands_the_dark_one_at_the_bottom_as_the_camera_sees_them(shape: str) -> None:
    posts = f"""
      <mujoco>
        <asset>
          <texture name="bands" type="2d" builtin="checker" rgb1="1 1 1" rgb2="0.2 0.2 0.2" width="64" height="64"/>
          <material name="post" texture="bands" texrepeat="0.5 2" rgba="1 0.5 0 1"/>
        </asset>
        <worldbody><geom type="{shape}" size="1 2 2" pos="0 0 2" material="post"/></worldbody>
      </mujoco>"""
    model = mujoco.MjModel.from_xml_string(posts)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    server = Server()
    scenes.show_surroundings(server, Scene(model, data, {}, np.zeros(3)))  # type: ignore[arg-type]
    dark, light = (server.added[f"/surroundings/solids {number}"] for number in (0, 1))
    assert [dark.options["color"], light.options["color"]] == [(51, 25, 0), (255, 127, 0)]
    for mesh, heights in ((dark, [0.0, 1.0, 2.0, 3.0]), (light, [1.0, 2.0, 3.0, 4.0])):
        assert np.unique(mesh.arguments[1][:, 2].round(6)).tolist() == heights


def test_a_drone_is_its_own_geoms_at_their_size_where_they_are_on_it() -> None:
    server, scene = Server(), scene_of("a", "b")
    for name in "ab":
        Drone(server, name, scene, np.zeros(3))  # type: ignore[arg-type]
    assert box_of(server.added["/a/body 0"]) == [[-0.3, -0.1, -0.05], [0.3, 0.1, 0.05]]
    assert box_of(server.added["/a/body 1"]) == [[0.1, -0.1, 0.04], [0.3, 0.1, 0.06]]
    assert "/a/body 2" not in server.added
    for number, halves in ((0, [1.0, 2.0, 3.0]), (1, [1.0, 1.0, 3.0])):
        np.testing.assert_allclose(
            box_of(server.added[f"/b/body {number}"]), [[-half for half in halves], halves], atol=0.05
        )
    corners = [[0.0, 0.0, 0.0], [0.0, 0.0, 3.0], [0.0, 3.0, 0.0], [3.0, 0.0, 0.0]]  # as its file has them
    wedge = server.added["/b/body 2"].arguments
    np.testing.assert_allclose(sorted((wedge[1].round(5) + 0.0).tolist()), corners, atol=1e-4)
    assert len(wedge[2]) == 4
    bodies = scene.bodies.values()
    assert [scenes.pose_of(scene.model, body) for body in bodies] == [slice(0, 7), slice(7, 14)]


def test_a_drone_has_a_path_an_arrow_along_its_command_and_a_shadow_on_what_is_below_it() -> None:
    """The floor is at 0.5 m. MuJoCo's frame is north, west, up, and the drone is shown 1 m to the west."""
    server, drone = Server(), None
    drone = Drone(server, "a", scene_of("a"), np.array([0.0, 1.0, 0.0]))  # type: ignore[arg-type]
    drone.begin(np.array([[0.0, 0.0, 2.0], [1.0, 0.0, 2.0], [1.0, 1.0, 2.0]]))
    ideal = [[[0.0, 1.0, 2.0], [1.0, 1.0, 2.0]], [[1.0, 1.0, 2.0], [1.0, 2.0, 2.0]]]
    assert server.added["/a ideal"].arguments[1].tolist() == ideal
    arrow, shadow, plumb = (server.added[f"/a {part}"] for part in ("command", "shadow", "plumb line"))
    turn = [0.5, 0.5, 0.5, 0.5]
    drone.show(np.array([1.0, -1.0, 4.0, *turn]), (0.0, 2.0, 0.0))
    assert (server.added["/a"].position.tolist(), server.added["/a"].wxyz.tolist()) == ([1.0, 0.0, 4.0], turn)
    assert server.added["/a/name"].arguments[1] == "a"
    np.testing.assert_allclose(arrow.points, [[[1.0, 0.0, 4.0], [1.0, -0.7, 4.0]]])
    assert drone.height_m == pytest.approx(3.5)
    foot = [1.0, 0.0, 0.52]
    np.testing.assert_allclose(shadow.position, foot)
    np.testing.assert_allclose(plumb.points, [[[1.0, 0.0, 4.0], foot]], rtol=1e-6)
    for height_m, towards, seen in (
        (0.16, (1.0, 0.0, 0.0), (True, True, True)),
        (0.14, (0.0, 0.0, 0.0), (False, True, False)),  # no line where it stands
        (-1.0, None, (False, False, False)),
    ):
        drone.show(np.array([1.0, -1.0, 0.5 + height_m, *turn]), towards)
        assert (arrow.visible, shadow.visible, plumb.visible) == seen
        assert drone.height_m == (None if height_m < 0.0 else pytest.approx(height_m))


def test_a_path_is_sent_in_blocks_forgets_its_oldest_and_begins_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scenes, "BLOCK", 2)
    monkeypatch.setattr(scenes, "MOST_BLOCKS", 2)
    server = Server()
    drone = Drone(server, "a", scene_of("a"), np.zeros(3))  # type: ignore[arg-type]
    pose = np.array([0.0, 0.0, 5.0, 1.0, 0.0, 0.0, 0.0])
    for number, commanded in enumerate([True, True, True, False, False, True]):
        drone.go_to(np.array([number, 0.0, 0.0]), commanded)
    drone.go_to(np.array([5.0, 0.0, 0.0]), False)  # it stands
    drone.show(pose, None)
    points, colours = server.path("a")
    assert [[start[0], end[0]] for start, end in points] == [[2, 3], [3, 4], [4, 5]]
    assert colours == [VERMILION, VERMILION, BLUE]
    drone.begin(None)
    assert server.path("a") == ([], [])
    for north in (9.0, 10.0):
        drone.go_to(np.array([north, 0.0, 0.0]), True)
    drone.show(pose, None)
    assert server.path("a")[0] == [[[9.0, 0.0, 0.0], [10.0, 0.0, 0.0]]]  # not from where it was


def test_events_are_of_what_passed_since_the_last_image_and_begin_anew_after_a_jump(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    data = SimpleNamespace(qpos=np.zeros(9))
    camera = SimpleNamespace(colour=lambda _: np.zeros((HEIGHT, WIDTH, 3), np.uint8))
    eyes = Eyes(camera, data, slice(1, 8))  # type: ignore[arg-type]
    stepped: list[float] = []

    def step(sensor: Any, state: Any, image: Any, time_s: float) -> Any:
        stepped.append(time_s)
        return state, np.ones((HEIGHT, WIDTH), int), np.zeros((HEIGHT, WIDTH), int)

    monkeypatch.setattr(scenes, "step", step)
    for time_s in (5.0, 5.0, 5.1, 5.2, 9.0, 9.125, 2.0, 2.25):
        picture = eyes.render(np.arange(1.0, 8.0), time_s)
    assert stepped == pytest.approx([0.1, 0.2, 0.125])  # since it began: not after standing, nor after jumps
    assert picture.shape == (2 * HEIGHT, WIDTH, 3)
    assert picture[0, 0].tolist() == [0, 0, 0]
    assert picture[-1, 0, 2] > picture[-1, 0, 0]  # ON is blue, as browsers have it
    assert data.qpos.tolist() == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 0.0]


# --- views and clocks ------------------------------------------------------------------------------------------------


def test_a_view_is_from_behind_and_above_farther_on_a_phone_and_goes_along() -> None:
    server, begun = Server(2.0, 0.5), list[bool]()
    views = Views(server, lambda: begun.append(True))  # type: ignore[arg-type]
    screen, phone = (client.camera for client in server.clients.values())
    centre, back = np.array([1.0, 2.0, 3.0]), 4.0 * np.array([-1.15, 0.0, 0.85])
    for wide, times in ((True, 3.0), (False, 1.0)):  # 1.5 over 0.5
        views.look_at(centre, 4.0, wide)
        for camera in (server.initial_camera, screen):
            np.testing.assert_allclose([camera.position, camera.look_at], [centre + back, centre])
        np.testing.assert_allclose(phone.position, centre + times * back)
        np.testing.assert_allclose(phone.look_at, centre)
    screen.position = np.full(3, 9.0)  # as somebody has chosen
    views.follow(centre + np.array([0.01, 0.0, 0.0]))  # less than it is worth
    assert screen.position.tolist() == [9.0, 9.0, 9.0]
    for moved, position in (([1.0, -2.0, 0.5], [10.0, 7.0, 9.5]), ([1.0, -2.0, 1.5], [10.0, 7.0, 10.5])):
        views.follow(centre + moved)
        assert screen.position.tolist() == position
        np.testing.assert_allclose(server.initial_camera.look_at, centre + moved)
        np.testing.assert_allclose(server.initial_camera.position, centre + moved + back)
    server.connected(server.clients[1])
    server.clients.pop(0)
    server.connected(server.clients[1])
    assert begun == [True]  # the first browser alone begins the show


def test_clocks_have_two_lines_for_each_drone_and_its_height_where_there_is_ground() -> None:
    drones = [("a<b", 1.004, 2.46, "flies & thinks"), ("low", 61.5, 0.0, "done"), ("c", 0.0, None, "")]
    table = clock_table(2.5, "0.100 s", drones, "1 < 2")
    rows = [row.split("</tr>")[0] for row in table.split("<tr>")[1:]]
    assert [[cell.split(">", 1)[1].split("</td>")[0] for cell in row.split("<td")[1:]] for row in rows] == [
        ["<b>a&lt;b</b>", "1.00 s", "2.5 m up"],
        ["flies &amp; thinks"],
        ["<b>low</b>", "61.50 s", "0.0 m up"],
        ["done"],
        ["<b>c</b>", "0.00 s", ""],
        [""],
    ]
    assert "ClockSpeed <b>2.5x</b> &nbsp; wall clock <b>0.100 s</b>" in table
    assert "<p class='note'>1 &lt; 2</p>" in table
    assert "<p class='note'></p>" in clock_table(2.5, "0.100 s", drones)  # its place is kept


def test_the_legend_names_every_colour_and_white_only_where_a_path_is_compared() -> None:
    plain, compared = legend(""), legend("TCSC")
    for text in ("flies a command", "client thinks", "commanded velocity", "plumb line"):
        assert text in plain
        assert text in compared
    assert [text.count("background:rgb") for text in (plain, compared)] == [4, 5]
    assert "background:rgb(245, 245, 245)'></i>path of TCSC<" in compared
    for colour in ("rgb(0, 114, 178)", "rgb(213, 94, 0)"):
        assert colour in plain


def test_the_pages_title_is_the_first_sentence_and_its_style_is_beside_it() -> None:
    head = head_of("Game `a<b` of **two**: TCSC at 1.5x. More.")
    assert head.startswith("<title>Game a&lt;b of two: TCSC at 1.5x – uavaccel</title><style>")


# --- the page --------------------------------------------------------------------------------------------------------


class Told(Source):
    """A flight as a test tells it."""

    step_hint = "on"

    def __init__(self, scene: Scene | None) -> None:
        self.scene = scene
        self.told: Sequence[Moment] = []
        self.begun = 0

    def update(self, passed_s: float, seen: bool) -> Sequence[Moment]:
        return self.told

    def begin(self) -> None:
        self.begun += 1


class Recorded(Told):
    """One that can be scrubbed."""

    at_s, length_s = 0.0, 8.123

    def __init__(self, scene: Scene | None) -> None:
        super().__init__(scene)
        self.sought: list[float] = []

    @property
    def progress_s(self) -> tuple[float, float]:
        return self.at_s, self.length_s

    def seek(self, at_s: float) -> None:
        self.sought.append(at_s)


POSE = [1.0, 2.0, 3.0, 1.0, 0.0, 0.0, 0.0]
STATE = DroneState(10.0, np.array(POSE), True, (1.0, 0.0, 0.0), "flies")
MOMENT = Moment(1, True, 4.0, "2.500 s", [STATE])


class Opened:
    """A page, its server, and what it is told."""

    def __init__(self, *names: str, **more: Any) -> None:
        self.server, self.source = Server(2.0), Told(scene_of(*names, **more) if names else None)
        self.page = Page(self.server, self.source, "A title.", lambda: None)  # type: ignore[arg-type]

    def tell(self, *moments: Moment) -> None:
        self.source.told = moments
        self.page.update(0.1)


@pytest.fixture(autouse=True)
def without_camera(monkeypatch: pytest.MonkeyPatch) -> None:
    def make_camera(*_: Any) -> Any:
        raise UserError("no OpenGL")

    monkeypatch.setattr(pages, "make_camera", make_camera)


def test_every_drone_is_shown_with_its_own_path_which_begins_anew_with_each_flight() -> None:
    opened = Opened("a", "b", apart_m=4.0)
    added = opened.server.added
    pose = np.array([4.0, 5.0, 6.0, 0.0, 1.0, 0.0, 0.0])
    pair = [STATE._replace(does="x"), DroneState(11.0, pose, False, None, "y")]

    def farther(metres: float) -> list[DroneState]:
        return [each._replace(pose=each.pose + metres, commanded=not each.commanded) for each in pair]

    both, moved = MOMENT._replace(drones=pair), MOMENT._replace(drones=farther(1.0))
    opened.tell(both, moved)
    assert [added[f"/{name}"].position.tolist() for name in "ab"] == [[2.0, 5.0, 4.0], [5.0, 4.0, 7.0]]  # 2 m aside
    assert [added[f"/{name} command"].visible for name in "ab"] == [True, False]
    assert opened.server.path("a") == ([[[1.0, 4.0, 3.0], [2.0, 5.0, 4.0]]], [VERMILION])
    assert opened.server.path("b") == ([[[4.0, 3.0, 6.0], [5.0, 4.0, 7.0]]], [BLUE])
    heights = ["3.5 m up" if abs(y) < 2.0 and abs(x) < 3.0 else "" for x, y in ((2.0, 5.0), (5.0, 4.0))]
    assert heights == ["", ""]  # beyond the floor
    assert opened.server.clocks() == "ClockSpeed 4x wall clock 2.500 s a 10.00 s x b 11.00 s y"
    opened.tell(MOMENT)  # of another scene, with one drone
    opened.source.ideal_m = {"b": np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])}
    opened.tell(both._replace(flight=2), moved._replace(flight=2, drones=farther(2.0)))
    assert opened.server.path("a")[0] == [[[1.0, 4.0, 3.0], [3.0, 6.0, 5.0]]]
    assert ("/a ideal" in added, added["/b ideal"].arguments[1].tolist()) == (False, [[[0, -2, 0], [1, -2, 0]]])
    clients, opened.server.clients = opened.server.clients, {}
    opened.tell(both._replace(flight=2))
    opened.server.clients = clients
    opened.tell(both._replace(flight=2), moved._replace(flight=2))
    assert opened.server.path("a")[0] == [[[1.0, 4.0, 3.0], [2.0, 5.0, 4.0]]]  # from where somebody looks again


def test_controls_are_those_of_the_flight_and_tell_its_player() -> None:
    opened = Opened()
    controls, source = opened.server.added, opened.source
    assert "Waits for a flight." in opened.server.clocks()
    assert not {"Time", "ClockSpeed"} & controls.keys()  # it goes on, and cannot begin anew
    opened.tell(MOMENT)  # before it has told its scene
    source.scene = scene_of("a")
    for flight, may_pause in enumerate((False, True, False)):
        opened.tell(MOMENT._replace(flight=flight, may_pause=may_pause))
        assert {controls[name].disabled for name in ("Pause", "Step", "Shown at")} == {not may_pause}
        assert ("Cannot be paused" in opened.server.clocks()) is not may_pause
    for pace, pace_of in (("0.25x", 0.25), ("20x", 20.0), ("1e-9x", 1.0), (FLAT_OUT, None)):
        controls["Shown at"].choose(pace)
        assert source.pace == pace_of
    source.note = "Paused."
    for button, held, steps, label in (
        ("Pause", True, 0, "Play"),
        ("Pause", False, 0, "Pause"),
        ("Step", True, 1, "Play"),
    ):
        controls[button].click()
        opened.tell()
        assert (source.held, source.steps, controls["Pause"].label) == (held, steps, label)
    assert opened.server.clocks().endswith("a 10.00 s 2.5 m up flies Paused.")
    assert controls[""].content == "No pictures: no OpenGL"
    controls["Follow"].choose(False)
    looked_at = opened.server.initial_camera.look_at.tolist()
    opened.tell(MOMENT._replace(drones=[STATE._replace(pose=STATE.pose + 1.0)]))
    assert opened.server.initial_camera.look_at.tolist() == looked_at == [1.0, 2.0, 3.0]
    controls["Follow"].choose(True)
    opened.tell(MOMENT._replace(drones=[STATE._replace(pose=STATE.pose + 1.0)]))
    assert opened.server.initial_camera.look_at.tolist() == [2.0, 3.0, 4.0]


def test_a_recorded_flight_is_scrubbed_and_the_show_itself_seeks_nothing() -> None:
    source = Recorded(scene_of("a"))
    server = Server(2.0)
    page = Page(server, source, "A title.", lambda: None)  # type: ignore[arg-type]
    time = server.added["Time"]
    assert time.arguments[1:3] == (0.0, 8.12)
    source.told, source.at_s = [MOMENT], 3.456
    for length_s in (8.12, 4.0):  # it is flown at another ClockSpeed
        source.length_s = length_s
        for _ in range(pages.PICTURES_EVERY):
            page.update(0.1)
        assert (time.value, time.max) == (3.46, length_s)
    time.click(client=None)
    assert source.sought == []
    time.choose(1.25)
    assert source.sought == [1.25]


def test_drones_of_the_first_body_see_from_their_own_places_every_third_update(monkeypatch: pytest.MonkeyPatch) -> None:
    class Seen:
        def __init__(self, camera: Any, data: Any, pose: slice) -> None:
            assert pose == slice(0, 7)

        def render(self, pose: Any, time_s: float) -> Any:
            return pose.tolist(), time_s

    monkeypatch.setattr(pages, "make_camera", lambda *_: None)
    monkeypatch.setattr(pages, "Eyes", Seen)
    opened = Opened("a", "b")
    first = opened.source.scene
    assert first is not None
    opened.tell(MOMENT._replace(drones=[STATE, STATE]))
    images = {name: handle for name, handle in opened.server.added.items() if name.endswith("camera, events")}
    assert list(images) == ["a: camera, events"]
    opened.source.scene = Scene(first.model, first.data, {"a": first.bodies["a"], "c": first.bodies["a"]}, np.zeros(3))
    for time_s in (3.0, 4.0, 5.0):
        other = STATE._replace(time_s=7.0, pose=np.array([2.0, *POSE[1:]]))
        opened.tell(MOMENT._replace(drones=[STATE._replace(time_s=time_s), other]))
    shown = {name: handle.image for name, handle in opened.server.added.items() if name.endswith("camera, events")}
    assert shown == {"a: camera, events": (POSE, 5.0), "c: camera, events": ([2.0, *POSE[1:]], 7.0)}


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
def test_a_foreign_page_gets_nothing_and_one_that_does_not_read_is_dropped(monkeypatch: pytest.MonkeyPatch) -> None:
    viser = pytest.importorskip("viser")
    monkeypatch.setattr(beside, "UNREAD_MS", 100)
    page = beside.open_server("127.0.0.1", 18180, head_of("What flies."))
    try:
        port = page.get_port()
        socket_of = (
            *("Upgrade: websocket", "Connection: Upgrade", "Sec-WebSocket-Version: 13"),
            *("Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==", f"Sec-WebSocket-Protocol: viser-v{viser.__version__}"),
        )
        with urlopen(f"http://127.0.0.1:{port}/") as answer:
            assert b"<title>What flies \xe2\x80\x93 uavaccel</title><style>" in answer.read()
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
