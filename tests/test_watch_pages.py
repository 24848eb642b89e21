"""The two pages of `uavaccel watch` without a browser: what they show, and what a spectator's clicks do."""

from __future__ import annotations

import re
from contextlib import nullcontext
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from uavaccel.errors import UserError
from uavaccel.watch import live_page, page
from uavaccel.watch.feed import Moment, Scene, Source
from uavaccel.watch.live_page import FLAT_OUT, LivePage
from uavaccel.watch.page import Page
from uavaccel.watch.track import Track, track_of
from uavaccel.wire.page_protocol import FREE


class Control:
    """A control of the page; a browser clicks on it, or chooses a value."""

    def __init__(self, first: str = "", **options: Any) -> None:
        self.label, self.content, self.disabled, self.visible, self.image = first, first, False, True, None
        self.value = options.get("initial_value")
        self.visible = options.get("visible", True)
        self._acts: list[Any] = []

    def on_click(self, act: Any) -> None:
        self._acts.append(act)

    on_update = on_click

    def click(self) -> None:
        for act in self._acts:
            act(None)

    def choose(self, value: Any) -> None:
        self.value = value
        self.click()


class Server:
    """Stands in for viser's: the controls by their names, and as many browsers as `clients`."""

    def __init__(self) -> None:
        self.clients: dict[int, Any] = {0: SimpleNamespace(camera=SimpleNamespace(aspect=2.0, position=np.zeros(3)))}
        self.initial_camera = SimpleNamespace()
        self.controls: dict[str, Control] = {}
        self.scene = SimpleNamespace(set_up_direction=lambda _: None)
        self.connected: Any = None

    @property
    def gui(self) -> Any:
        return self

    def __getattr__(self, add: str) -> Any:
        def made(first: Any, *others: Any, **options: Any) -> Control:
            named = add == "add_button" or add in ("add_dropdown", "add_checkbox")
            control = Control(first if isinstance(first, str) else "", **options)
            self.controls[first if named else options.get("label", add.removeprefix("add_"))] = control
            return control

        if not add.startswith("add_"):
            raise AttributeError(add)
        return made

    def atomic(self) -> Any:
        return nullcontext()

    def get_clients(self) -> dict[int, Any]:
        return self.clients

    def on_client_connect(self, act: Any) -> None:
        self.connected = act

    def clocks(self) -> str:
        """The table of clocks in words."""
        return " ".join(re.sub("<[^>]*>|&nbsp;", " ", self.controls["html"].content).split())


class Figure:
    """Stands in for a drone's, 5 m over the ground."""

    def __init__(self, server: Any, name: str, *_: Any) -> None:
        self.name = name
        self.shown: list[tuple[Any, ...]] = []

    def show(self, place: Any, attitude: Any, towards: Any, text: str) -> float:
        self.shown.append((place.tolist(), attitude.tolist(), towards, text))
        return 5.0


@pytest.fixture
def figures(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    made: list[Figure] = []

    def figure(*how: Any) -> Figure:
        made.append(Figure(*how))
        return made[-1]

    def no_camera(model: Any) -> Any:
        raise UserError("no OpenGL")

    for module in (page, live_page):
        monkeypatch.setattr(module, "light_up", lambda _: None)
        monkeypatch.setattr(module, "show_surroundings", lambda *_: None)
        monkeypatch.setattr(module, "Figure", figure)
        monkeypatch.setattr(module, "camera_of", no_camera)
        monkeypatch.setattr(module, "pose_of", lambda *_: slice(0, 7))
    return made


# --- flights that go on ----------------------------------------------------------------------------------------------


class Told(Source):
    """A flight that keeps the orders that it was given."""

    def __init__(self, *names: str) -> None:
        self.orders: list[Any] = []
        data: Any = SimpleNamespace(qpos=np.array([1.0, 2.0, 3.0, 1, 0, 0, 0]))
        self.scene = Scene(None, data, {name: number for number, name in enumerate(names)})
        self.moments: list[Moment] = []
        self._told = None

    def _send(self, orders: Any) -> None:
        self.orders.append(orders)


class Trail:
    def __init__(self, server: Any, name: str) -> None:
        self.places: list[Any] = []

    def clear(self) -> None:
        self.places.clear()

    def add(self, place: Any, commanded: bool) -> None:
        self.places.append((place.tolist(), commanded))

    def draw(self) -> None: ...


class Live:
    """A page, its server, and what it hears."""

    def __init__(self, *names: str) -> None:
        self.server, self.source, self.other = Server(), Told(*names), Told("b")
        self.forgiven = 0
        self.feed: Any = SimpleNamespace(
            sources=[self.source, self.other], shown=self.source, listen=lambda _: None, forgive=self._forgive
        )
        self.page = LivePage(self.server, self.feed, "A title.", lambda: None)  # type: ignore[arg-type]

    def _forgive(self) -> None:
        self.forgiven += 1

    def hear(self, *moments: Moment, passed_s: float = 0.1) -> None:
        self.source.moments[:] = moments
        self.page.update(passed_s)

    def press(self, name: str) -> None:
        self.server.controls[name].click()


MOMENT = Moment(1, True, 4.0, 10.0, 2.5, np.array([[1.0, 2.0, 3.0, 1.0, 0.0, 0.0, 0.0]]), (True,), ((1.0, 0.0, 0.0),))


@pytest.fixture
def live(figures: list[Figure], monkeypatch: pytest.MonkeyPatch) -> Live:
    monkeypatch.setattr(live_page, "Trail", Trail)
    return Live("a")


def test_a_simulated_clock_is_shown_as_it_is_and_the_machines_from_the_flights_begin(live: Live) -> None:
    """At ClockSpeed 4 ten seconds are flown in 2.5 s: a flight heard of at 102.5 s began at 100."""
    live.hear(MOMENT)
    assert live.server.clocks() == "ClockSpeed 4x wall clock 2.500 s, simulated a 10.00 s 5.0 m up flies its command"
    for wall_s, shown in ((102.5, "2.500"), (103.0, "3.000")):
        live.hear(MOMENT._replace(flight=2, may_pause=False, wall_s=wall_s, commanded=(False,)))
        assert live.server.clocks() == (
            f"ClockSpeed 4x wall clock {shown} s, the machine's a 10.00 s 5.0 m up no command"
        )
    live.hear(MOMENT._replace(flight=3))
    assert "wall clock 2.500 s, simulated" in live.server.clocks()


def test_a_flight_obeys_the_page_that_shows_it_while_somebody_looks(live: Live) -> None:
    source, other, controls = live.source, live.other, live.server.controls
    live.hear(MOMENT)
    shown = {"seen": True, "held": False, "pace": 1.0, "refreshes": 0}
    assert (source.orders, other.orders) == ([shown], [FREE])
    for pace, pace_of in (("0.25x", 0.25), ("20x", 20.0), ("1e-9x", 1.0), (FLAT_OUT, None)):
        controls["Shown at"].choose(pace)
        live.hear(MOMENT)
        assert source.orders[-1] == {**shown, "pace": pace_of}
    live.press("Pause")
    live.hear()
    held = {**shown, "held": True, "pace": None}
    assert source.orders[-1] == held
    assert (controls["Pause"].label, live.forgiven) == ("Play", 1)
    for _ in range(2):
        live.press("Step")
    live.hear()
    assert source.orders[-1] == {**held, "refreshes": 2}
    said = len(source.orders)
    live.hear()
    assert len(source.orders) == said  # nothing new
    live.press("Pause")
    live.hear()
    assert source.orders[-1] == {**shown, "pace": None}
    live.press("Step")  # which pauses too
    live.hear()
    assert source.orders[-2:] == [held, {**held, "refreshes": 1}]
    live.server.clients.clear()
    live.hear()
    assert source.orders[-1] == FREE  # nobody is there who could let it go on
    assert other.orders == [FREE]


def test_a_silent_flight_is_said_to_be_paused_or_over(live: Live) -> None:
    live.hear(MOMENT)
    table = live.server.clocks()
    live.hear(passed_s=0.5)
    assert live.server.clocks() == table
    live.hear(passed_s=0.1)
    assert live.server.clocks() == f"{table} Its clock is paused, or its flight is over."
    live.press("Pause")
    live.hear(passed_s=0.1)
    assert live.server.clocks() == f"{table} Paused."
    live.hear(MOMENT)
    assert live.server.clocks() == table
    live.hear(MOMENT._replace(may_pause=False, flight=2))
    live.hear(passed_s=0.6)
    assert live.server.clocks().endswith("or its flight is over.")  # it cannot have been paused here


def test_every_vehicle_has_its_own_figure_and_path_which_begins_anew_with_each_flight(
    figures: list[Figure], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live_page, "Trail", Trail)
    live = Live("a", "b")
    poses = np.array([[1.0, 2.0, 3.0, 1.0, 0.0, 0.0, 0.0], [4.0, 5.0, 6.0, 0.0, 1.0, 0.0, 0.0]])
    moment = MOMENT._replace(poses=poses, commanded=(True, False), towards=((1.0, 0.0, 0.0), None))
    live.hear(moment, moment._replace(poses=poses + 1.0))
    a, b = figures
    assert a.shown == [([2.0, 3.0, 4.0], [2.0, 1.0, 1.0, 1.0], (1.0, 0.0, 0.0), "a: flies its command")]
    assert b.shown == [([5.0, 6.0, 7.0], [1.0, 2.0, 1.0, 1.0], None, "b: no command")]
    trails = live.page._trails
    assert [trail.places for trail in trails] == [  # type: ignore[attr-defined]
        [([1.0, 2.0, 3.0], True), ([2.0, 3.0, 4.0], True)],
        [([4.0, 5.0, 6.0], False), ([5.0, 6.0, 7.0], False)],
    ]
    live.hear(moment._replace(poses=poses * np.nan))  # of a flight that has come apart
    assert a.shown[1:] == a.shown[:1]
    live.hear(moment._replace(flight=2))
    assert [trail.places for trail in trails] == [[([1.0, 2.0, 3.0], True)], [([4.0, 5.0, 6.0], False)]]  # type: ignore[attr-defined]
    live.server.clients, there = {}, live.server.clients
    live.hear(moment)
    live.server.clients = there
    live.hear(moment._replace(flight=2, poses=poses + 1.0))  # from where somebody looks again
    assert trails[0].places == [([2.0, 3.0, 4.0], True)]  # type: ignore[attr-defined]


def test_only_a_simulated_clock_can_be_held(live: Live) -> None:
    for flight, may_pause in enumerate((False, True, False)):
        live.hear(MOMENT._replace(flight=flight, may_pause=may_pause))
        for name in ("Pause", "Step", "Shown at"):
            assert live.server.controls[name].disabled is not may_pause
        assert live.page._why_not.visible is not may_pause


def test_the_view_goes_along_unless_it_is_told_not_to(live: Live) -> None:
    live.hear(MOMENT)
    camera = live.server.initial_camera
    assert camera.look_at.tolist() == [1.0, 2.0, 3.0]
    live.hear(MOMENT._replace(poses=MOMENT.poses + 1.0))
    assert camera.look_at.tolist() == [2.0, 3.0, 4.0]
    live.server.controls["Follow"].choose(False)
    live.hear(MOMENT)
    assert camera.look_at.tolist() == [2.0, 3.0, 4.0]


# --- finished flights ------------------------------------------------------------------------------------------------


def straight(name: str, clock_speed: float, metres: float, seconds: float = 4.0, aside_m: float = 0.0) -> Track:
    """Northwards at an even pace, at 10 m, so far to the east; a command for the first half of it."""
    return track_of(name, clock_speed, {
        "time_s": np.array([0.0, seconds]),
        "position_m": np.array([[0.0, aside_m, -10.0], [metres, aside_m, -10.0]]),
        "orientation_wxyz": np.tile([1.0, 0.0, 0.0, 0.0], (2, 1)),
        "command_start_s": np.array([0.0]),
        "command_end_s": np.array([seconds / 2]),
    })  # fmt: skip


@pytest.fixture
def shown(figures: list[Figure], monkeypatch: pytest.MonkeyPatch) -> Any:
    """Opens a page; the drones keep where they are shown."""

    class Drone:
        def __init__(self, server: Any, track: Track, figure: Any, offset_m: Any, ideal_m: Any) -> None:
            self.track, self.offset_m, self.ideal_m, self.height_m = track, offset_m.tolist(), ideal_m, 7.0
            self.shown_s: list[float] = []

        def show(self, wall_s: float) -> None:
            self.shown_s.append(wall_s)

        def state(self, wall_s: float) -> str:
            return "flies"

    monkeypatch.setattr(page, "Drone", Drone)

    def opened(*tracks: Track, **options: Any) -> tuple[Any, Server]:
        server = Server()
        return Page(server, tracks, "blocks", "A title.", **options), server  # type: ignore[arg-type]

    return opened


def test_the_page_goes_by_simulated_seconds_per_second_whatever_the_clock_speed(shown: Any) -> None:
    """Four seconds at 50x took 80 ms: at 1x they are shown in four seconds, and a step is of 0.05 of them."""
    opened, server = shown(straight("a", 50.0, 4.0))
    head, controls = opened.playhead, server.controls
    assert (head.end_s, head.step_s) == (pytest.approx(0.08), pytest.approx(0.001))
    for pace, wall_s in (("1x", 0.02), ("0.25x", 0.005), ("5x", 0.1)):
        controls["Shown at"].choose(pace)
        head.replay()
        head.end_s = 1.0
        head.pass_time(1.0)
        assert head.at_s == pytest.approx(wall_s), pace
    controls["Step"].click()
    assert (head.at_s, head.playing) == (pytest.approx(0.101), False)
    controls["Pause"].click()
    assert head.playing
    controls["Replay"].click()
    assert head.at_s == 0.0
    head.at_s, head.playing = 0.06, False
    opened._show()
    assert server.clocks() == "ClockSpeed 50x wall clock 0.060 s a 3.00 s 7.0 m up flies"
    assert controls["Pause"].label == "Play"
    head.end_s = 0.08
    opened._show()
    assert "wall clock 60.0 ms" in server.clocks()
    assert opened.drones[0].shown_s[-1] == 0.06


def test_flights_are_side_by_side_around_the_middle_and_held_against_the_last(shown: Any) -> None:
    tracks = [straight("a", 50.0, 4.0, aside_m=3.0), straight("b", 50.0, 5.0), straight("c", 50.0, 4.0)]
    opened, server = shown(*tracks)
    assert [drone.offset_m for drone in opened.drones] == [[0.0, east, 0.0] for east in (-4.6, 0.0, 4.6)]
    assert [drone.ideal_m is tracks[2].position_m for drone in opened.drones] == [True, True, False]
    assert server.clocks().endswith("a leaves the path of c by up to 3.00 m; b leaves the path of c by up to 1.00 m")
    alone, _ = shown(tracks[0])
    assert (alone.drones[0].offset_m, alone.drones[0].ideal_m) == ([0.0, 0.0, 0.0], None)


@pytest.mark.parametrize(
    ("metres", "centre", "reach_m", "follows"),
    [(4.0, 2.0, 3.0, False), (16.0, 8.0, 8.0, False), (30.0, 0.0, 3.0, True)],
)
def test_a_flight_is_seen_whole_or_gone_along_with(
    shown: Any, metres: float, centre: float, reach_m: float, follows: bool
) -> None:
    opened, server = shown(straight("a", 1.0, metres))
    camera = server.initial_camera
    assert camera.look_at.tolist() == [centre, 0.0, 10.0]
    back = camera.position - camera.look_at
    np.testing.assert_allclose(back, reach_m * np.array([-1.15, 0.0, 0.85]))
    opened.playhead.at_s = 2.0  # half of the way
    opened._show()
    assert camera.look_at.tolist() == [metres / 2 if follows else centre, 0.0, 10.0]


def test_another_clock_speed_is_flown_and_shown_from_its_beginning(shown: Any) -> None:
    asked: list[float] = []

    def fly_at(clock_speed: float) -> list[Track]:
        asked.append(clock_speed)
        return [straight("a", clock_speed, 4.0)]

    opened, server = shown(straight("a", 20.0, 4.0), fly_at=fly_at)
    for pace in ("2000x", "2x"):
        server.controls["Shown at"].choose(pace)
    server.controls["ClockSpeed"].choose("999999999x")  # which the menu does not offer
    assert (opened._wanted, server.controls["ClockSpeed"].value) == (20.0, "20x")
    opened.playhead.seek(0.1)
    sleeps = iter([0, 0])

    def sleep_until(ns: int) -> None:
        if next(sleeps, None) is None:
            raise KeyboardInterrupt

    opened._clock = SimpleNamespace(now_ns=lambda: 0, sleep_until=sleep_until)
    server.controls["ClockSpeed"].choose("100x")
    with pytest.raises(KeyboardInterrupt):
        opened.run()
    assert asked == [100.0]
    assert (opened.speed, opened.playhead.at_s, opened.playhead.slowness) == (100.0, 0.0, 50.0)
    assert opened.playhead.end_s == pytest.approx(0.04)
    assert "ClockSpeed 100x" in server.clocks()
    opened.playhead.seek(0.02)
    server.connected(server.clients[0])  # the first browser misses nothing
    assert opened.playhead.at_s == 0.0


def test_each_drone_sees_from_its_own_place_in_mujocos_frame(shown: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    looked: list[Any] = []

    class Eyes:
        def __init__(self, *_: Any) -> None: ...
        def render(self, place: Any, attitude: Any, time_s: float) -> str:
            looked.append((place.tolist(), time_s))
            return f"picture {len(looked)}"

    monkeypatch.setattr(page, "camera_of", lambda _: None)
    monkeypatch.setattr(page, "Eyes", Eyes)
    tracks = [straight("a", 2.0, 4.0, aside_m=3.0), straight("b", 2.0, 8.0)]
    opened, server = shown(*tracks)
    looked.clear()
    opened.playhead.at_s, opened.updates = 1.0, 3
    opened._show()
    opened._show()  # only every third update
    assert looked == [([2.0, -3.0, 10.0], 2.0), ([4.0, 0.0, 10.0], 2.0)]
    assert [server.controls[f"{name}: camera, events"].image for name in "ab"] == ["picture 1", "picture 2"]
