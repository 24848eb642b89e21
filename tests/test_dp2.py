"""DP2 end to end on short paths: its grid, equal poses and images, guard, collisions, repeatable bytes, mistakes."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import cv2
import numpy as np
import pytest

from tests.opengl import needs_opengl
from tests.running import configured
from uavaccel.cli.experiments import report_run, run_experiment
from uavaccel.cli.results import view_game
from uavaccel.commands import COMMANDS, SynchronousCommand
from uavaccel.errors import UserError
from uavaccel.files import read_arrays
from uavaccel.records import RunDirectory
from uavaccel.sim.lane.layout import LENGTH_M
from uavaccel.suites import dp2
from uavaccel.suites.dp2 import Dp2, Dp2Config, Game
from uavaccel.suites.rows import subset
from uavaccel.suites.session import RunRequest

SHORT_PATH = "path=[[1, 0], [1, 0], [0.5, 0.8], [1, 0]]"
SAMPLES = 13  # the start, and three of each command
FIGURE = "figures/figure7_images.png"


def config_of(*overrides: str, **options: Any) -> Dp2Config:
    config: Dp2Config = configured("dp2", SHORT_PATH, *overrides, **options)
    return config


def request(out: Path, *overrides: str, **options: Any) -> RunRequest:
    return RunRequest("dp2", {"clock_speed": [1.0, 100.0], **options}, [SHORT_PATH, *overrides], out=out)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> RunDirectory:
    out = tmp_path_factory.mktemp("dp2") / "run"
    run_experiment(request(out))
    return RunDirectory(out)


def fly(config: Dp2Config, case: Game) -> tuple[Any, dict[str, np.ndarray]]:
    with Dp2().open(config, case.timing, cast(Any, None)) as session:
        flown = Dp2().fly(config, case, session)
    return flown.row, dict(flown.arrays)


# --- the grid -----------------------------------------------------------------------------------------------------


def test_the_papers_dp2_flies_each_clock_speed_once_to_the_lanes_end() -> None:
    config = configured("dp2")
    games = [f"{command}-k{clock}" for command in ("tcsc", "adsc") for clock in (1, 5, 10, 50, 100)]
    flown = [f"reference-{name}" if name.endswith("k1") else name for name in games]
    assert [case.id for case in Dp2().cases(config)] == ["lockstep-tcsc-k1", *flown]
    reach_m = sum(north for north, _ in config.velocities) * config.t_move_s
    assert LENGTH_M < reach_m < LENGTH_M + 5
    assert {case.simulated_s() for case in Dp2().cases(config)} == {float(len(config.velocities))}


@pytest.mark.parametrize(
    ("overrides", "options", "flown"),
    [
        ([], {"timing": "wall"}, ["reference virtual", "lockstep lockstep", "game wall", "game wall"]),
        (["reference_timing=wall"], {"timing": "wall"}, ["lockstep lockstep", "reference wall", "game wall"]),
        (["perturbation.share=0.1"], {}, ["reference virtual", "lockstep lockstep", "game virtual", "game virtual"]),
        (["clock_speed=[50]"], {}, ["reference virtual", "lockstep lockstep", "game virtual"]),
    ],
)
def test_games_are_compared_with_a_clean_one_at_1x(overrides: list[str], options: Any, flown: list[str]) -> None:
    """The grid's own where that is modelled or measured as the references are, and not perturbed."""
    config = config_of("clock_speed=[1, 50]", *overrides, command=["tcsc"], **options)
    assert [f"{case.role} {case.timing}" for case in Dp2().cases(config)] == flown
    assert {case.clock_speed for case in Dp2().cases(config) if case.role != "game"} == {1.0}


# --- flights ------------------------------------------------------------------------------------------------------


def cameras(monkeypatch: pytest.MonkeyPatch, *overrides: str, **options: Any) -> dict[str, tuple[Any, ...]]:
    """What each game's camera is made with, by its case: kind of images, guard, perturbation, exposure."""
    asked: list[tuple[Any, ...]] = []

    def camera(*settings: Any) -> Any:
        asked.append(settings[3:])
        raise InterruptedError

    monkeypatch.setattr(dp2, "EventClient", camera)
    session: Any = SimpleNamespace(start_game=lambda *_: None)
    config = config_of(*overrides, command=["tcsc"], **options)
    cases = list(Dp2().cases(config))
    for case in cases:
        with pytest.raises(InterruptedError):
            Dp2().fly(config, case, session)
    return {case.id: settings for case, settings in zip(cases, asked, strict=True)}


def test_games_alone_are_perturbed_the_more_the_faster_the_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    """At 26x half of the share, at 76x three quarters of it; each game draws its own images."""
    keys = "perturbation={share: 0.08, half_excess: 25, kinds: [empty]}", "clock_speed=[26, 76]"
    found = cameras(monkeypatch, *keys, "guard.max_retries=1")
    assert {case: settings[0] for case, settings in found.items()} == {
        "reference-tcsc-k1": "gray", "lockstep-tcsc-k1": "colour", "tcsc-k26": "colour", "tcsc-k76": "colour",
    }  # fmt: skip
    assert [settings[1].max_retries for settings in found.values()] == [1] * 4
    *clean, half, most = (settings[2] for settings in found.values())
    assert clean == [None, None]
    assert (half.share, most.share) == pytest.approx((0.04, 0.06))
    assert half.kinds == most.kinds == ("empty",)
    other = cameras(monkeypatch, *keys, seed=1)["tcsc-k26"][2]
    assert len({half.seed, most.seed, other.seed}) == 3
    assert cameras(monkeypatch, *keys)["tcsc-k26"][2] == half
    assert cameras(monkeypatch, "perturbation.share=0.08", "clock_speed=[26]")["tcsc-k26"][2].share == 0.08


@pytest.mark.parametrize("exposed", [False, True])
def test_without_perturbation_images_are_gray_and_exposure_is_of_every_game(
    exposed: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = cameras(monkeypatch, f"auto_exposure={str(exposed).lower()}", "clock_speed=[1, 50]").values()
    assert [settings[0] for settings in found] == ["colour", "gray", "gray"]
    assert [(settings[2], settings[3] is not None) for settings in found] == [(None, exposed)] * 3


@pytest.mark.parametrize(
    ("profile", "clock_speed", "t_th_ms"),
    [("airsim", 20.0, 20), ("airsim", 100.0, 33), ("airsim", 1.0, 3), ("native", 20.0, 0)],
)
def test_tcsc_allows_for_the_clients_latency_at_the_clock_speed(
    profile: str, clock_speed: float, t_th_ms: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At most a tenth of T_sample, .33 s, and at least a tick of 3 ms. A late sample is the command's last one."""
    flown: list[Any] = []

    def last_alone(*asked: Any) -> list[Any]:
        flown.append(asked[2:])
        return [camera.read_sample(None)]

    camera: Any = SimpleNamespace(
        read_sample=lambda _: SimpleNamespace(state=SimpleNamespace(position_m=(len(flown), 0.0, 0.0), time_ns=0)),
        kinematics=lambda: None,
        now_ns=lambda: 0,
    )
    monkeypatch.setitem(COMMANDS, "tcsc", SynchronousCommand(lambda _: None, cast(Any, last_alone)))
    config = config_of("t_th_wall_s=0.001", clock_speed=[clock_speed], profile=profile)
    case = Game("game", "tcsc", clock_speed, "virtual", 0.0)
    assert dp2.fly_path(config, case, camera)[1] == [0, 3, 6, 9, 12]
    assert flown == [(1.0, 0.33, t_th_ms * 1_000_000)] * 4


@needs_opengl
def test_tcsc_sees_at_any_clock_speed_what_lockstep_sees(run: RunDirectory) -> None:
    cases = ("lockstep-tcsc-k1", "reference-tcsc-k1", "tcsc-k100")
    lockstep, *others = (read_arrays(run.path / f"arrays/{case}.npz") for case in cases)
    for arrays in others:
        for name in ("time_s", "sample_index", "position_m", "orientation_wxyz", "image"):
            assert np.array_equal(arrays[name], lockstep[name]), name
    assert lockstep["image"].shape == (SAMPLES, 144, 256)
    assert len(np.unique(lockstep["image"].reshape(SAMPLES, -1), axis=0)) == SAMPLES
    assert lockstep["time_s"][:5].tolist() == [0.0, 0.33, 0.66, 1.0, 1.33]
    cells = {(cell["command"], cell["clock_speed"]): cell for cell in run.read_json("summary.json")["cells"]}
    for clock_speed in (1.0, 100.0):
        tcsc, adsc = cells["tcsc", clock_speed], cells["adsc", 100.0]
        assert [tcsc["position_error_m_max"], tcsc["attitude_error_deg_max"], tcsc["dvs_ed_percent_max"]] == [0.0] * 3
        assert (tcsc["poses_equal_lockstep"], tcsc["dvs_counts_equal_lockstep"]) == (True, True)
        assert tcsc["paired_images"] == SAMPLES - 1
    assert adsc["position_error_m_max"] > 0.01
    assert adsc["dvs_ed_percent_max"] > 0.0
    assert (adsc["poses_equal_lockstep"], adsc["reference"]["case"]) == (False, "reference-adsc-k1")


@needs_opengl
def test_reports_and_games_are_the_same_again(run: RunDirectory) -> None:
    """So it does not matter which process flies a game, and after which others."""
    names = ["rows.jsonl", "summary.json", FIGURE, "report.html"]
    before = [(run.path / name).read_bytes() for name in names]
    report_run(run)
    assert [(run.path / name).read_bytes() for name in names] == before
    figure = cv2.imread(str(run.path / FIGURE))
    assert figure is not None
    assert np.mean(np.any(figure != 255, axis=-1)) > 0.01
    config, by_case = configured("dp2", SHORT_PATH, clock_speed=[1.0, 100.0]), {row["case"]: row for row in run.rows()}
    for case in reversed(list(Dp2().cases(config))[-2:]):
        row, arrays = fly(config, case)
        expected = by_case[case.id]
        assert {"suite": "dp2", "case": case.id, **row, **subset(expected, "arrays", "arrays_sha256")} == expected
        stored = run.load_arrays(expected)
        assert {name: array.tobytes() for name, array in arrays.items()} == {
            name: each.tobytes() for name, each in stored.items()
        }


@needs_opengl
def test_the_guard_asks_again_for_perturbed_images() -> None:
    overrides = ["perturbation.share=0.5", "perturbation.kinds=[empty, brightness]"]
    config = config_of(*overrides, clock_speed=[100.0], command=["tcsc"])
    flown = {case.role: fly(config, case) for case in Dp2().cases(config)}
    row, arrays = flown["game"]
    assert row["guard_retries"] == arrays["retries"].sum() > 3
    clean = flown["lockstep"][1]
    assert np.array_equal(arrays["position_m"], clean["position_m"])
    same = [np.array_equal(*images) for images in zip(arrays["image"], clean["image"], strict=True)]
    assert sum(same) > SAMPLES / 2
    assert flown["reference"][0]["guard_retries"] == flown["lockstep"][0]["guard_retries"]


@needs_opengl
@pytest.mark.parametrize("command", ["tcsc", "adsc"])
def test_a_collision_ends_the_game_and_its_samples(command: str) -> None:
    lane = "lane={obstacles: [{x_m: 3.0, y_m: 0.0, half_side_m: 0.5}]}"
    config = config_of(lane, f"path={[[1.0, 0.0]] * 12}", clock_speed=[100.0], command=[command])
    row, arrays = fly(config, next(case for case in Dp2().cases(config) if case.role == "game"))
    assert row["collision"]["object"].startswith("obstacle")
    assert row["distance_m"] == pytest.approx(2.5 - 0.34, abs=0.02)
    assert row["collision"]["position_m"][0] == pytest.approx(row["distance_m"])
    assert (row["error"], row["commands"] < 12, row["planned_commands"]) == (None, True, 12)
    assert arrays["time_s"][-1] <= row["collision"]["time_s"] < arrays["time_s"][-1] + 0.5
    assert len(arrays["image"]) == len(arrays["position_m"]) == row["samples"]
    assert len(np.unique(arrays["position_m"][1:], axis=0)) == len(arrays["position_m"]) - 1


@needs_opengl
def test_view_writes_a_film_that_plays_and_a_contact_sheet(
    run: RunDirectory, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    view_game(str(run.path), None, tmp_path)
    assert capsys.readouterr().out.split() == [str(tmp_path / f"tcsc-k100.{kind}") for kind in ("mp4", "png")]
    film, played = cv2.VideoCapture(str(tmp_path / "tcsc-k100.mp4")), []
    while (frame := film.read())[0]:
        played.append(frame[1])
    assert (len(played), played[0].shape) == (SAMPLES, (808, 1280, 3))
    assert np.mean(np.abs(played[-1].astype(int) - played[1])) > 1.0
    sheet = cv2.imread(str(tmp_path / "tcsc-k100.png"))
    assert sheet is not None
    assert min(sheet.shape[:2]) > 800
    with pytest.raises(UserError, match=r"--case tcsc-k10: .*did you mean 'tcsc-k100"):
        view_game(str(run.path), "tcsc-k10", tmp_path)


# --- files and mistakes -------------------------------------------------------------------------------------------


def test_a_lane_of_ones_own_may_have_wind() -> None:
    lane = "lane={obstacles: [{x_m: 3.0, y_m: 0.0, half_side_m: 0.5}], wind_m_s: [1.0, 0.0, 0.5]}"
    assert config_of(lane).layout().wind_m_s == (1.0, 0.0, 0.5)


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("lane={seed: 3, dificulty: {}}", "unknown key 'lane.dificulty'"),
        ("lane={obstacles: [{x_m: 9.0, y_m: 0.0}]}", "should have radius_m"),
        ("path=[]", r"path = \[\]"),
        ("t_move_s=0.333", "t_move_s: 0.333 s is not a positive multiple"),
        ("t_sample_s=0.3333", "t_sample_s"),
        ("perturbation.share=2", r"perturbation\.share = 2"),
        ("perturbation.kinds=[snow]", "perturbation.kinds"),
        ("dvs_preset=loud", "dvs_preset = 'loud'"),
    ],
)
def test_mistakes_are_one_line(override: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(UserError, match=message) as mistake:
        run_experiment(RunRequest("dp2", {}, [override], out=tmp_path / "run"))
    assert "\n" not in str(mistake.value)
    assert not (tmp_path / "run").exists()
