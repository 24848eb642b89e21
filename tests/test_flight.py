"""From a row to a flight, and from a flight to a film: of recordings, of DP2's samples, of evaluations flown again."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.running import configured
from uavaccel.config import validate
from uavaccel.draw import chase
from uavaccel.draw.film import frames
from uavaccel.envs.obstacle_lane import LaneTask
from uavaccel.errors import UserError
from uavaccel.records import RunDirectory
from uavaccel.sim.lane import LaneLayout, sample_layout
from uavaccel.suites import evaluate_again
from uavaccel.suites.dp1 import Dp1
from uavaccel.suites.dp2 import Dp2
from uavaccel.suites.evaluate import EvaluateConfig, Evaluation
from uavaccel.suites.evaluate_again import equal_windows
from uavaccel.suites.flight import Commands, Flight, Window, film_of
from uavaccel.suites.seeds import Seeds
from uavaccel.suites.suite import Suite
from uavaccel.vision.dvs import PRESETS
from uavaccel.watch.replay import Track
from uavaccel.wire.image_api import lane_layout

MS = 1_000_000
POSES: dict[str, Any] = {
    "time_s": np.array([0.0, 0.33, 0.7, 1.1, 1.5]),
    "position_m": np.arange(15.0).reshape(5, 3),
    "orientation_wxyz": np.tile([1.0, 0.0, 0.0, 0.0], (5, 1)),
}


def run_with(path: Path, config: Any, row: dict[str, Any], arrays: dict[str, Any]) -> tuple[RunDirectory, Any]:
    run = RunDirectory.create(path, config, {})
    row = {"suite": config.suite, "case": "a", **row}
    run.append_row(row | run.save_arrays(row["case"], arrays))
    return run, run.rows()[0]


# --- from a row -------------------------------------------------------------------------------------------------


def test_a_suite_that_keeps_recordings_has_flights_for_free(tmp_path: Path) -> None:
    arrays = POSES | {"command_start_s": np.array([0.0, 0.7]), "command_end_s": np.array([0.5, 1.5])}
    run, row = run_with(tmp_path / "run", configured("dp1"), {"clock_speed": 4}, arrays)
    report: Any = SimpleNamespace(run=run)
    flight = Suite.flight(Dp1(), report, row)
    assert (flight.title, flight.clock_speed, flight.scene, flight.lane) == ("a", 4.0, "blocks", None)
    assert (flight.time_ns // MS).tolist() == [0, 330, 700, 1100, 1500]
    assert (flight.commands.end_ns // MS).tolist() == [500, 1500]
    assert flight.commands.velocity_m_s.shape == (0, 3)
    np.testing.assert_array_equal(flight.position_m, arrays["position_m"])
    with pytest.raises(UserError, match="a run of dp1 keeps no flights to show"):
        Suite.flight(Dp1(), report, {"case": "a"})
    with pytest.raises(UserError, match=f"^{run.path}: a run of seeds has its flights in the runs below parts/; take"):
        Seeds().flight(report, row)
    assert Suite.flight(Dp1(), report, row | {"clock_speed": "fast"}).clock_speed == 1.0
    short = SimpleNamespace(
        run=SimpleNamespace(path="run", load_arrays=lambda _: arrays | {"position_m": np.ones((4, 3))})
    )
    with pytest.raises(UserError, match=r"^run: a: position_m: has the shape \(4, 3\), not \(5, 3\)$"):
        Suite.flight(Dp1(), short, row)  # type: ignore[arg-type]
    del arrays["position_m"], arrays["command_end_s"]
    run, row = run_with(tmp_path / "other", configured("dp1"), {}, arrays)
    with pytest.raises(UserError, match=r"the arrays of a have no position_m, command_end_s$"):
        Suite.flight(Dp1(), SimpleNamespace(run=run), row)  # type: ignore[arg-type]


SEEN = {"image_ns": np.zeros(1, int), "images": np.zeros((1, 5, 6), np.uint8)}


@pytest.mark.parametrize(
    ("more", "reason"),
    [
        ({"velocity_m_s": np.ones((4, 3))}, r"^a: velocity_m_s has the shape \(4, 3\), not \(5, 3\)$"),
        ({"velocity_m_s": np.full((5, 3), np.nan)}, "^a: velocity_m_s has numbers that are not finite$"),
        ({"images": np.zeros((2, 8, 8), np.uint8)}, r"^a: images has the shape \(2, 8, 8\), not \(0, 8, 8\)$"),
        ({"images": np.zeros((0, 8, 8))}, r"^a: images are float64 \(0, 8, 8\), not uint8"),
        ({"orientation_wxyz": np.zeros((5, 4))}, "^a: orientation_wxyz has an attitude of length 0$"),
        (
            SEEN | {"windows": [Window(0, np.array([[0.0, 6, 4, 1]]))]},
            "^a: windows have events outside the images of 6 x 5$",
        ),
        (
            SEEN | {"windows": [Window(0, None, (np.zeros((6, 5), int),) * 2)]},
            r"^a: windows count \(2, 6, 5\) events, not \(2, 5, 6\)",
        ),
        (
            {"commands": Commands(np.zeros(1, int), np.zeros(2, int), np.zeros((0, 3)))},
            "^a: commands.end_ns has the shape",
        ),
    ],
)
def test_a_flight_of_ones_own_has_arrays_that_fit(more: dict[str, Any], reason: str) -> None:
    flight = Flight.of("a", 1.0, POSES | {"command_start_s": np.zeros(1), "command_end_s": np.ones(1)})
    with pytest.raises(UserError, match=reason):
        replace(flight, **more)


def test_a_flight_of_one_sample_is_watched_where_it_is() -> None:
    arrays = {name: values[:1] for name, values in POSES.items()}
    flight = Flight.of("a", 1.0, arrays | {"command_start_s": np.zeros(1), "command_end_s": np.ones(1)})
    assert Track("a", flight).pose(0.5).tolist() == [0.0, -1.0, -2.0, 1.0, 0.0, 0.0, 0.0]


def test_what_is_compared_is_shown_first() -> None:
    games = [("game", 50.0, "tcsc"), ("game", 50.0, "adsc"), ("game", 1.0, "tcsc"), ("reference", 100.0, "tcsc")]
    rows = [{"role": role, "clock_speed": k, "command": command} for role, k, command in games]
    assert sorted([rows[n] for n in (3, 1, 2, 0)], key=Dp1().interest) == rows
    assert Dp1().interest({"clock_speed": None}) > Dp1().interest(rows[0])


@pytest.mark.parametrize(
    ("time_s", "ends_ms"),
    [
        ([0.0, 0.33, 0.7, 1.1, 1.5], [660, 1360]),
        ([0.0, 0.33, 0.5, 0.8, 1.0], [500, 1000]),  # the next command, and the flight's end, come before
    ],
)
@pytest.mark.parametrize("counted", [False, True])
def test_a_game_of_dp2_is_read_from_its_samples(
    tmp_path: Path, counted: bool, time_s: list[float], ends_ms: list[int]
) -> None:
    """Two commands of two samples each, after that of the start, and a collision on the way."""
    image = np.full((5, 144, 256), 100, np.uint8)
    image[2:, 8, 9] = 250
    commands = {"sample_index": np.arange(5), "command_velocity_m_s": np.array([[1.0, 0.0], [0.0, 2.0]])}
    arrays = POSES | commands | {"image": image, "time_s": np.array(time_s), "retries": np.zeros(5, np.int64)}
    if counted:
        arrays["dvs_on"] = np.arange(5, dtype=np.uint16)[:, None, None] * np.ones((1, 144, 256), np.uint16)
        arrays["dvs_off"] = 2 * arrays["dvs_on"]
        arrays["colour"] = np.stack([image, image // 2, image // 4], axis=3)
    config = configured("dp2", "path=[[1, 0], [0, 2]]", "t_move_s=0.66", "t_sample_s=0.33")
    row: dict[str, Any] = {"role": "game", "command": "adsc", "clock_speed": 10.0, "timing": "virtual"}
    row |= {"case": "adsc-k10", "profile": "native", "seed": 0, "real_time_factor": 9.96}
    row |= {"wall_s": 0.15, "sim_time_s": 1.5, "duration_s": 1.5}
    row |= {"t_move_s": 0.66, "t_sample_s": 0.33, "commands": 2, "planned_commands": 2, "samples": 5}
    row |= {"distance_m": 1.0, "guard_retries": 0, "error": None}
    row["collision"] = None if counted else {"time_s": 1.25, "object": "wall", "position_m": [1.0, 1.0, -10.0]}
    run, row = run_with(tmp_path / "run", config, row, arrays)
    report = Dp2().report(run)
    flight = Dp2().flight(report, row)
    hit = "" if counted else ", hit wall"
    assert flight.title == f"ADSC at ClockSpeed 10x (achieved 10.0x, modelled{hit})"
    assert (flight.time_ns / 1e9).tolist() == (flight.image_ns / 1e9).tolist() == time_s
    assert (flight.commands.start_ns / 1e9).tolist() == [0.0, time_s[2]]
    assert (flight.commands.end_ns // MS).tolist() == ends_ms
    assert flight.commands.velocity_m_s.tolist() == [[1.0, 0.0, 0.0], [0.0, 2.0, 0.0]]
    assert flight.collision == (None if counted else (1250 * MS, "wall"))
    np.testing.assert_array_equal(flight.images, arrays["colour" if counted else "image"])
    assert isinstance(flight.lane, LaneLayout)
    np.testing.assert_array_equal(flight.lane.x_m, lane_layout(config.wire_lane).x_m)
    ends, counts = (
        [window.time_ns / 1e9 for window in flight.windows],
        [window.per_pixel((144, 256)) for window in flight.windows],
    )
    if counted:
        assert ends == time_s
        assert [(on[0, 0], off[0, 0]) for on, off in counts] == [(n, 2 * n) for n in range(5)]
    else:
        assert ends == time_s[1:]
        assert [bool(on[8, 9]) for on, _ in counts] == [False, True, False, False]
        assert not any(off.any() for _, off in counts)
    assert Dp2().flight(report, row, pictures=False).windows == ()


def at(after_ms: int) -> Any:
    place = (after_ms / 1000, 0.0, -10.0)
    return SimpleNamespace(time_ns=7000 * MS + MS * after_ms, position_m=place, orientation_wxyz=(1.0, 0.0, 0.0, 0.0))


class Lane:
    """Two commands of two samples each, the last one at an impact; the simulation had run for 7 s before the game."""

    hit = True

    def __init__(self, **task: Any) -> None:
        self.observers: list[Any] = []
        self.add_observer = self.observers.append
        self.episode_task = SimpleNamespace(
            goal=lambda action: SimpleNamespace(velocity_m_s=(float(action), 0.0, 0.0)),
            model_dump=lambda: {"command": "adsc", "clock_speed": 20.0},
            lane_layout=lambda ended: f"lane {ended['lane']}",
            clock_speed=20.0,
            scene="lane",
            dvs_parameters=PRESETS["clean"],
            dvs_seed=0,
        )

    def close(self) -> None: ...

    def fly(self) -> list[Any]:
        onlooker, picture = self.observers[0], np.zeros((2, 3), np.uint8)
        task, session = LaneTask(), SimpleNamespace(picture=lambda: picture)
        onlooker.game_begun(SimpleNamespace(start=at(0), picture=lambda _: picture, task=task, session=session))
        for command, ends in enumerate([(330, 660), (1000, 1320)]):
            for after_ms in ends:
                struck = {"time_ns": at(after_ms - 20).time_ns, "object": "a tree", "position_m": (1.3, 0.5, -9.0)}
                collision = struck if self.hit and after_ms == 1320 else None
                told = SimpleNamespace(state=at(after_ms), image=picture, collision=collision)
                onlooker.sample_taken(told, command)
        return [SimpleNamespace(action=3), SimpleNamespace(action=4, info={"lane": 5, "is_success": False})]


@pytest.mark.parametrize("hit", [True, False])
@pytest.mark.parametrize(
    ("profile", "rate_hz", "ticks"),
    [("native", 100.0, 5), ("native", 1e9, 1), ("native", 7.0, 71), ("airsim", 100.0, 3)],
)
def test_an_evaluations_times_are_since_the_start_of_its_game(
    monkeypatch: pytest.MonkeyPatch, hit: bool, profile: str, rate_hz: float, ticks: int
) -> None:
    class Camera:
        def __init__(self, task: Any, every_ticks: int) -> None:
            assert every_ticks == ticks  # of 2 ms, or AirSim's 3 ms
            rows = np.array([[0.05, 1, 1, 1], [0.06, 2, 1, -1], [1.25, 0, 0, 1]])
            self.events = SimpleNamespace(pop_events=lambda: rows)

    monkeypatch.setattr(Lane, "hit", hit)
    for name, value in (
        ("environment_class", lambda _: Lane), ("SecondEventCamera", Camera),
        ("fly_again", lambda run, config, lane, row: lane.fly()),
    ):  # fmt: skip
        monkeypatch.setattr(evaluate_again, name, value)
    config = validate(EvaluateConfig, {"agent": "straight", "task": {"profile": profile}}, "test")
    report: Any = SimpleNamespace(run=None, config=config)
    flight = Evaluation().flight(report, {"lane": 5}, event_rate_hz=rate_hz)
    last_ms = 1300 if hit else 1320
    assert flight.title == f"lane 5, ADSC at 20x: {'hit a tree' if hit else 'ran out of commands'}"
    seen: tuple[Any, ...] = (flight.clock_speed, flight.scene, flight.lane)
    assert seen == (20.0, "lane", "lane 5")
    assert (flight.time_ns // MS).tolist() == (flight.image_ns // MS).tolist() == [0, 330, 660, 1000, last_ms]
    assert flight.position_m[-1].tolist() == ([1.3, 0.5, -9.0] if hit else [1.32, 0.0, -10.0])
    assert (flight.commands.start_ns // MS).tolist() == [0, 660]  # the sample that each was decided on
    assert (flight.commands.end_ns // MS).tolist() == [660, last_ms]
    assert flight.commands.velocity_m_s.tolist() == [[3.0, 0.0, 0.0], [4.0, 0.0, 0.0]]
    assert flight.collision == ((1300 * MS, "a tree") if hit else None)
    assert flight.images.shape == (5, 2, 3)
    filled = {window.time_ns // MS: len(window.rows) for window in flight.windows if len(window.rows)}  # type: ignore[arg-type]
    assert filled == {50: 1, 100: 1, 1250: 1}
    assert flight.windows[-1].time_ns == last_ms * MS


def test_events_are_of_the_window_that_ends_with_them() -> None:
    rows = np.array([  # s, x, y, sign
        [0.01, 3, 2, 1], [0.05, 3, 2, 1], [0.05, 4, 2, -1], [0.051, 3, 2, -1], [0.12, 0, 0, -1],
    ])  # fmt: skip
    windows = list(equal_windows(rows, 120 * MS))
    found = [(window.time_ns // MS, len(window.rows)) for window in windows if window.rows is not None]
    assert found == [(50, 3), (100, 1), (120, 1)]
    on, off = windows[0].per_pixel((5, 6))
    assert (on.shape, on[2, 3], on.sum(), off[2, 4], off.sum()) == ((5, 6), 2, 2, 1, 1)
    assert Window(0, None, (off, on)).per_pixel((5, 6))[0] is off


# --- to a film --------------------------------------------------------------------------------------------------


def flight() -> Flight:
    """Five poses a second apart, three pictures of them, and events of both signs in one pixel."""
    time_ns = np.arange(5) * 1000 * MS
    commands = Commands(time_ns[:1], time_ns[-1:], np.zeros((1, 3)))
    windows = [
        Window(end * 100 * MS, np.array([[0.0, end, 3, 1.0], [0.0, 7, 3, -1.0]])) for end in (10, 11, 20, 21, 35)
    ]
    images = np.stack([np.full((144, 256), 40 * n, np.uint8) for n in range(3)])
    position_m = np.arange(15.0).reshape(5, 3)
    rest = np.tile([1.0, 0.0, 0.0, 0.0], (5, 1)) * np.arange(1.0, 6.0)[:, None]
    seen: dict[str, Any] = {"image_ns": time_ns[1:4], "images": images, "windows": windows}
    return Flight("who", 2.0, time_ns, position_m, rest, commands, **seen)


@pytest.fixture
def nothing_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(chase, "ChaseView", lambda *_: None)


@pytest.mark.usefixtures("nothing_behind")
def test_a_film_shows_each_picture_with_the_events_up_to_it() -> None:
    film = film_of(flight())
    assert (film.title, film.hit, film.layout) == ("who", "", None)
    assert film.time_s.tolist() == [0.0, 1.0, 2.0]
    assert film.position_m[:, 0].tolist() == [3.0, 6.0, 9.0]
    assert film.on_events[:, 3, [10, 11, 20, 21, 35]].tolist() == [[1, 0, 0, 0, 0], [0, 1, 1, 0, 0], [0, 0, 0, 1, 1]]
    assert film.off_events[:, 3, 7].tolist() == [1, 2, 2]
    assert len(list(frames(film))) == 3  # without a lane too
    with pytest.raises(UserError, match="who: has no images to film"):
        film_of(replace(flight(), image_ns=np.zeros(0, int), images=np.zeros((0, 0, 0), np.uint8)))


@pytest.mark.usefixtures("nothing_behind")
@pytest.mark.parametrize(("hit_ms", "marked"), [(3000, True), (3001, False)])
def test_a_film_marks_an_impact_that_it_has_reached(hit_ms: int, marked: bool) -> None:
    assert film_of(replace(flight(), collision=(hit_ms * MS, "wall"))).hit == ("wall" if marked else "")


def test_a_film_has_the_view_from_behind_at_its_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[Any] = []

    def behind(*what: Any) -> str:
        told.append(what)
        return "behind"

    monkeypatch.setattr(chase, "ChaseView", behind)
    lane, target_m = sample_layout(3), [1.0, 2.0, -3.0]
    film = film_of(replace(flight(), scene="lane", lane=lane, target_m=target_m))
    ((scene, layout, position_m, orientation_wxyz, size, target),) = told
    seen: tuple[Any, ...] = (film.chase, film.layout, film.target_m, scene, layout, size, target)
    assert seen == ("behind", lane, target_m, "lane", lane, (512, 288), target_m)
    assert (position_m[:, 0].tolist(), orientation_wxyz[:, 0].tolist()) == ([3.0, 6.0, 9.0], [2.0, 3.0, 4.0])
