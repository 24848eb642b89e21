"""DP2 end to end on short paths: equal poses and images, guard, collisions, summary, repeatable bytes, films."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import cv2
import numpy as np
import pytest

from tests.opengl import needs_opengl
from uavaccel.cli.run import RunRequest, report_run, run_experiment
from uavaccel.cli.view import view_game
from uavaccel.commands import COMMANDS, SynchronousCommand
from uavaccel.errors import UsageError, UserError
from uavaccel.files import read_arrays, write_arrays
from uavaccel.records import RunDirectory
from uavaccel.sim.lane.layout import LENGTH_M
from uavaccel.suites.experiment import read_mapping, resolve
from uavaccel.suites.old_dp2 import flights
from uavaccel.suites.old_dp2.config import Dp2Config
from uavaccel.suites.old_dp2.flights import SCENE, Case, fly_game, fly_path, velocities
from uavaccel.suites.old_dp2.flights import cases as cases_of
from uavaccel.suites.rows import subset
from uavaccel.wire.session import open_session

SHORT_PATH = "path=[[1, 0], [1, 0], [0.5, 0.8], [1, 0]]"
SAMPLES = 13  # the start, and three of each command
FIGURE = "figures/figure7_images.png"


def config_of(*overrides: str, **options: Any) -> Dp2Config:
    mapping, source = read_mapping("dp2")
    return resolve(Dp2Config, mapping, source, options, overrides)


def request(out: Path, **options: Any) -> RunRequest:
    return RunRequest("dp2", {"clock_speed": [1.0, 100.0], **options}, [SHORT_PATH], out=out)


@pytest.fixture(scope="module")
def run_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("dp2") / "run"
    run_experiment(request(out))
    return out


def summary_in(run_dir: Path) -> dict[str, Any]:
    summary: dict[str, Any] = json.loads((run_dir / "summary.json").read_text())
    return summary


def cell_of(summary: Mapping[str, Any], command: str, clock_speed: float) -> dict[str, Any]:
    (cell,) = (c for c in summary["cells"] if (c["command"], c["clock_speed"]) == (command, clock_speed))
    return dict(cell)


def contents(run_dir: Path) -> dict[str, bytes]:
    """What has to be the same twice."""
    arrays = sorted(path.relative_to(run_dir).as_posix() for path in (run_dir / "arrays").iterdir())
    return {name: (run_dir / name).read_bytes() for name in ("rows.jsonl", "summary.json", FIGURE, *arrays)}


# --- the grid -----------------------------------------------------------------------------------------------


def test_the_papers_dp2_flies_each_clock_speed_once_to_the_lanes_end() -> None:
    config = config_of()
    names = [case.id for case in cases_of(config)]
    games = [f"{command}-k{clock}" for command in ("tcsc", "adsc") for clock in (1, 5, 10, 50, 100)]
    flown = [f"reference-{name}" if name.endswith("k1") else name for name in games]
    assert names == ["lockstep-tcsc-k1", *flown]
    reach_m = sum(north for north, _ in velocities(config)) * config.t_move_s
    assert LENGTH_M < reach_m < LENGTH_M + 5
    assert {case.simulated_s() for case in cases_of(config)} == {float(len(velocities(config)))}


def test_a_measured_run_is_compared_with_modelled_ones_at_1x() -> None:
    config = config_of(SHORT_PATH, clock_speed=[1.0, 50.0], timing="wall", command=["tcsc"])
    assert [(case.id, case.timing) for case in cases_of(config)] == [
        ("reference-tcsc-k1", "virtual"),
        ("lockstep-tcsc-k1", "lockstep"),
        ("tcsc-k1", "wall"),
        ("tcsc-k50", "wall"),
    ]


def test_perturbed_games_are_compared_with_a_clean_one() -> None:
    config = config_of(SHORT_PATH, "perturbation.share=0.1", clock_speed=[1.0], command=["tcsc"])
    assert [case.id for case in cases_of(config)] == ["reference-tcsc-k1", "lockstep-tcsc-k1", "tcsc-k1"]


# --- flights ------------------------------------------------------------------------------------------------


class Asked(Exception):
    """Ends a flight at once: the camera that it asks for is known."""


def cameras(monkeypatch: pytest.MonkeyPatch, *overrides: str, **options: Any) -> dict[str, tuple[Any, ...]]:
    """What each game's camera is made with, by its case: kind of images, guard, perturbation, exposure."""

    def ask(client: Any, *settings: Any) -> Any:
        raise Asked(*settings)

    monkeypatch.setattr(flights, "CameraClient", ask)
    session: Any = SimpleNamespace(start_game=lambda *_: None)
    config, found = config_of(SHORT_PATH, *overrides, command=["tcsc"], **options), {}
    for case in cases_of(config):
        with pytest.raises(Asked) as asked:
            fly_game(config, case, session)
        found[case.id] = asked.value.args
    return found


def test_games_alone_are_perturbed_the_more_the_faster_the_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    """At 26x half of the share, at 76x three quarters of it; each game draws its own images."""
    keys = "perturbation={share: 0.08, half_excess: 25, kinds: [empty]}", "clock_speed=[26, 76]"
    found = cameras(monkeypatch, *keys, "guard.max_retries=1")
    assert {case: settings[0] for case, settings in found.items()} == {
        "reference-tcsc-k1": "gray",
        "lockstep-tcsc-k1": "colour",
        "tcsc-k26": "colour",
        "tcsc-k76": "colour",
    }
    assert [settings[1].max_retries for settings in found.values()] == [1] * 4
    *clean, half, most = (settings[2] for settings in found.values())
    assert clean == [None, None]
    assert (half.share, most.share) == pytest.approx((0.04, 0.06))
    assert half.kinds == most.kinds == ("empty",)
    other = cameras(monkeypatch, *keys, seed=1)["tcsc-k26"][2]
    assert len({half.seed, most.seed, other.seed}) == 3
    assert cameras(monkeypatch, *keys)["tcsc-k26"][2] == half
    always = cameras(monkeypatch, "perturbation.share=0.08", "clock_speed=[26]")["tcsc-k26"][2]
    assert always.share == 0.08


def test_without_perturbation_images_are_gray_and_exposure_is_of_every_game(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for exposed in (False, True):
        found = cameras(monkeypatch, f"auto_exposure={str(exposed).lower()}", "clock_speed=[1, 50]")
        assert [settings[0] for settings in found.values()] == ["colour", "gray", "gray"]
        assert {settings[2] for settings in found.values()} == {None}
        assert [settings[3] is not None for settings in found.values()] == [exposed] * 3


@pytest.mark.parametrize(
    ("profile", "clock_speed", "t_th_ms"),
    [("airsim", 20.0, 20), ("airsim", 100.0, 33), ("airsim", 1.0, 3), ("native", 20.0, 0)],
)
def test_tcsc_allows_for_the_clients_latency_at_the_clock_speed(
    profile: str, clock_speed: float, t_th_ms: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At most a tenth of T_sample, .33 s, and at least a tick of 3 ms."""
    flown: list[Any] = []

    def fly(*asked: Any) -> list[Any]:
        flown.append(asked)
        return [camera.gather(None)]

    def gather(_: Any) -> Any:
        return SimpleNamespace(state=SimpleNamespace(position_m=(len(flown), 0.0, 0.0), time_ns=0))

    camera: Any = SimpleNamespace(
        gather=gather,
        kinematics=lambda: None,
        now_ns=lambda: 0,
        client=SimpleNamespace(collision=lambda: None),
    )
    monkeypatch.setitem(COMMANDS, "tcsc", SynchronousCommand(lambda _: None, cast(Any, fly)))
    options: dict[str, Any] = {"clock_speed": [clock_speed], "profile": profile, "command": ["tcsc"]}
    config = config_of(SHORT_PATH, "t_th_wall_s=0.001", **options)
    case = next(
        case for case in cases_of(config) if case.clock_speed == clock_speed and case.role != "lockstep"
    )
    assert fly_path(config, case, camera).indices == [0, 3, 6, 9, 12]
    assert [asked[2:] for asked in flown] == [(1.0, 0.33, t_th_ms * 1_000_000)] * 4


@needs_opengl
def test_tcsc_sees_at_any_clock_speed_what_lockstep_sees(run_dir: Path) -> None:
    lockstep, real_time, fast = (
        read_arrays(run_dir / f"arrays/{case}.npz")
        for case in ("lockstep-tcsc-k1", "reference-tcsc-k1", "tcsc-k100")
    )
    for arrays in (real_time, fast):
        for name in ("time_s", "sample_index", "position_m", "orientation_wxyz", "image"):
            assert np.array_equal(arrays[name], lockstep[name]), name
    assert lockstep["image"].shape == (SAMPLES, 144, 256)
    assert len(np.unique(lockstep["image"].reshape(SAMPLES, -1), axis=0)) == SAMPLES
    assert lockstep["time_s"][:5].tolist() == [0.0, 0.33, 0.66, 1.0, 1.33]


@needs_opengl
def test_the_summary_of_a_run(run_dir: Path) -> None:
    summary = summary_in(run_dir)
    for clock_speed in (1.0, 100.0):
        tcsc = cell_of(summary, "tcsc", clock_speed)
        errors = ("position_error_m", "attitude_error_deg", "dvs_ed_percent")
        assert [tcsc[f"{name}_max"] for name in errors] == [0.0, 0.0, 0.0]
        assert (tcsc["poses_equal_lockstep"], tcsc["dvs_counts_equal_lockstep"]) == (True, True)
        assert tcsc["paired_images"] == SAMPLES - 1
    adsc = cell_of(summary, "adsc", 100.0)
    assert adsc["position_error_m_max"] > 0.01
    assert adsc["dvs_ed_percent_max"] > 0.0
    assert adsc["poses_equal_lockstep"] is False
    assert adsc["reference"] == {
        "case": "reference-adsc-k1",
        "clock_speed": 1.0,
        "timing": "virtual",
        "provenance": "modelled",
        "is_this_cell": False,
    }


@needs_opengl
def test_the_report_of_a_run(run_dir: Path) -> None:
    figure = cv2.imread(str(run_dir / FIGURE))
    assert figure is not None
    assert np.mean(np.any(figure != 255, axis=-1)) > 0.01
    markdown, html = ((run_dir / f"report.{suffix}").read_text() for suffix in ("md", "html"))
    assert f"({FIGURE})" in markdown
    assert "modelled (virtual clock): 4 games" in markdown
    assert "salt and pepper" in markdown
    assert html.count("data:image/png;base64,") == 1
    before = contents(run_dir)
    report_run(RunDirectory(run_dir))
    assert contents(run_dir) == before


@needs_opengl
def test_a_game_flown_alone_is_that_game_of_the_run(run_dir: Path) -> None:
    """So it does not matter which process flies it, and after which others."""
    run = RunDirectory(run_dir)
    config = resolve(Dp2Config, run.config(), "test")
    by_case = {row["case"]: row for row in run.rows()}
    for case in reversed(list(cases_of(config))[-2:]):
        row, arrays = fly(config, case)
        expected = by_case[case.id]
        assert {**row, **subset(expected, "arrays", "arrays_sha256")} == expected
        stored = run.load_arrays(expected)
        assert {name: each.tobytes() for name, each in arrays.items()} == {
            name: each.tobytes() for name, each in stored.items()
        }


@needs_opengl
def test_the_guard_asks_again_for_perturbed_images() -> None:
    overrides = [SHORT_PATH, "perturbation.share=0.5", "perturbation.kinds=[empty, brightness]"]
    config = config_of(*overrides, clock_speed=[100.0], command=["tcsc"])
    flown = {case.role: fly(config, case) for case in cases_of(config)}
    row, arrays = flown["game"]
    assert row["guard_retries"] == arrays["retries"].sum() > 3
    clean = flown["lockstep"][1]
    assert np.array_equal(arrays["position_m"], clean["position_m"])
    same = [np.array_equal(*images) for images in zip(arrays["image"], clean["image"], strict=True)]
    assert sum(same) > SAMPLES / 2
    assert flown["reference"][0]["guard_retries"] == flown["lockstep"][0]["guard_retries"]


def fly(config: Dp2Config, case: Case) -> tuple[Any, dict[str, np.ndarray]]:
    with open_session(case.timing, config.profile, SCENE, config.latency) as session:
        return fly_game(config, case, session)


@needs_opengl
@pytest.mark.parametrize("command", ["tcsc", "adsc"])
def test_a_collision_ends_the_game_and_its_samples(command: str) -> None:
    lane = "lane={obstacles: [{x_m: 3.0, y_m: 0.0, half_side_m: 0.5}]}"
    straight = f"path={[[1.0, 0.0]] * 12}"
    config = config_of(lane, straight, clock_speed=[100.0], command=[command])
    case = next(case for case in cases_of(config) if case.role == "game")
    row, arrays = fly(config, case)
    assert row["collision"]["object"].startswith("obstacle")
    assert row["distance_m"] == pytest.approx(2.5 - 0.34, abs=0.02)
    assert row["error"] is None
    assert row["commands"] < 12
    assert arrays["time_s"][-1] <= row["collision"]["time_s"] < arrays["time_s"][-1] + 0.5
    assert len(arrays["image"]) == len(arrays["position_m"]) == row["samples"]
    assert len(np.unique(arrays["position_m"][1:], axis=0)) == len(arrays["position_m"]) - 1


# --- films --------------------------------------------------------------------------------------------------


@needs_opengl
def test_view_writes_a_film_that_plays_and_a_contact_sheet(
    run_dir: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    view_game(str(run_dir), None, tmp_path)
    assert capsys.readouterr().out.split() == [str(tmp_path / f"tcsc-k100.{kind}") for kind in ("mp4", "png")]
    film = cv2.VideoCapture(str(tmp_path / "tcsc-k100.mp4"))
    played = []
    while (frame := film.read())[0]:
        played.append(frame[1])
    assert len(played) == SAMPLES
    assert played[0].shape == (808, 1280, 3)
    assert np.mean(np.abs(played[-1].astype(int) - played[1])) > 1.0
    sheet = cv2.imread(str(tmp_path / "tcsc-k100.png"))
    assert sheet is not None
    assert min(sheet.shape[:2]) > 800


@needs_opengl
def test_view_says_what_is_wrong(run_dir: Path, tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"--case tcsc-k10: .*did you mean 'tcsc-k100"):
        view_game(str(run_dir), "tcsc-k10", tmp_path)
    with pytest.raises(UserError, match="not a run directory"):
        view_game(str(tmp_path), None, None)


def test_view_of_a_run_without_images(tmp_path: Path) -> None:
    RunDirectory.create(tmp_path / "run", config_of(SHORT_PATH), {})
    with pytest.raises(UserError, match="holds no finished game"):
        view_game(str(tmp_path / "run"), None, None)
    text = (tmp_path / "run/config.yaml").read_text()
    (tmp_path / "run/config.yaml").write_text(text.replace("suite: dp2", "suite: dp1"))
    with pytest.raises(UserError, match="a run of dp1 keeps no images"):
        view_game(str(tmp_path / "run"), None, None)


# --- files and mistakes -------------------------------------------------------------------------------------


def test_images_are_deflated_and_come_back_whole(tmp_path: Path) -> None:
    images = np.repeat(np.arange(200, dtype=np.uint8), 500).reshape(10, 100, 100)
    for name in ("one", "two"):
        write_arrays(tmp_path / name, {"image": images, "time_s": np.arange(3.0)})
    assert np.array_equal(read_arrays(tmp_path / "one")["image"], images)
    assert (tmp_path / "one").stat().st_size < images.nbytes / 4
    assert (tmp_path / "one").read_bytes() == (tmp_path / "two").read_bytes()


def test_a_lane_of_ones_own_may_have_wind() -> None:
    lane = "lane={obstacles: [{x_m: 3.0, y_m: 0.0, half_side_m: 0.5}], wind_m_s: [1.0, 0.0, 0.5]}"
    assert config_of(lane).layout().wind_m_s == (1.0, 0.0, 0.5)


MISTAKES = {
    "lane=-1": r"dp2\.yaml: lane = -1",
    "lane={seed: 3, dificulty: {}}": "unknown key 'lane.dificulty'",
    "lane={obstacles: [{x_m: 0.1, y_m: 0.0, radius_m: 0.3}]}": "of the start",
    "lane={obstacles: [{x_m: 9.0, y_m: 0.0}]}": "should have radius_m",
    "lane=nowhere.yaml": r"nowhere\.yaml",
    "path=[]": "path = .*needs at least one velocity",
    "height_m=10": "height_m = 10",
    "t_move_s=0.333": "t_move_s: 0.333 s is not a positive multiple",
    "t_sample_s=0.3333": "t_sample_s",
    "perturbation.share=2": r"perturbation\.share = 2",
    "perturbation.kinds=[snow]": "perturbation.kinds",
    "guard.max_retries=-1": r"guard\.max_retries = -1",
    "guards.max_retries=1": "unknown key 'guards'; did you mean 'guard'",
    "dvs_preset=loud": "dvs_preset = 'loud'",
}


@pytest.mark.parametrize("override", MISTAKES)
def test_mistakes_are_one_line(override: str, tmp_path: Path) -> None:
    with pytest.raises(UserError, match=MISTAKES[override]) as mistake:
        run_experiment(replace(request(tmp_path / "run"), overrides=[override]))
    assert "\n" not in str(mistake.value)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"games": 2}, "--games: dp2 has no such option"),
        ({"rounds": [1]}, "--rounds: dp2 has no such option"),
        ({"t_move_s": [1.0, 2.0]}, "--t-move: dp2 takes one value, not 2"),
    ],
)
def test_options_of_other_suites_are_refused(options: dict[str, Any], message: str, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=message):
        run_experiment(request(tmp_path / "run", **options))


def test_an_unknown_suite_is_named(tmp_path: Path) -> None:
    (tmp_path / "dp9.yaml").write_text("suite: dp9\n")
    with pytest.raises(UserError, match=r"dp9\.yaml: suite = 'dp9' is unknown; did you mean 'dp[12]'"):
        run_experiment(replace(request(tmp_path / "run"), experiment=str(tmp_path / "dp9.yaml")))
