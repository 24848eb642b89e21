"""DP2 end to end on short paths: its grid, equal poses and images, guard, collisions, repeatable bytes."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray

from tests import made_runs as made
from tests.made_runs import SIZE, active, dp2_game, hit, uncounted, yaw
from tests.opengl import needs_opengl
from tests.running import configured
from uavaccel.cli.experiments import run_experiment
from uavaccel.commands import COMMANDS, SynchronousCommand
from uavaccel.draw.page import Table
from uavaccel.files import read_arrays
from uavaccel.records import RunDirectory
from uavaccel.sim.lane import LENGTH_M
from uavaccel.suites import dp2
from uavaccel.suites.dp2 import Dp2, Dp2Config, Game
from uavaccel.suites.experiment import subset
from uavaccel.suites.session import RunRequest
from uavaccel.vision.perturb import PerturbationKind, PerturbationSettings, perturb_share
from uavaccel.wire.image_api import lane_layout

SHORT_PATH = "path=[[1, 0], [1, 0], [0.5, 0.8], [1, 0]]"
SAMPLES = 13  # the start, and three of each command


def config_of(*overrides: str, **options: Any) -> Dp2Config:
    """On a simulated clock, which a single ClockSpeed would leave."""
    config: Dp2Config = configured("dp2", SHORT_PATH, *overrides, **{"timing": "virtual", **options})
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


def test_the_papers_dp2_flies_each_clock_speed_to_the_lanes_end() -> None:
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


def cameras(monkeypatch: pytest.MonkeyPatch, *overrides: str, **options: Any) -> dict[str, Any]:
    """What each game's camera is made with, by its case: kind of images, guard, perturbation, exposure, DVS."""
    asked: list[Any] = []

    class Camera:
        def __init__(self, *settings: Any) -> None:
            asked.append([*settings[2:]])

        def count(self, sensor: Any, every_ticks: int, noise_seed: int) -> None:
            asked[-1] += [float(np.asarray(sensor.positive_threshold).ravel()[0]), every_ticks, noise_seed]

        def kinematics(self) -> Any:
            raise InterruptedError

        close = kinematics

    monkeypatch.setattr(dp2, "EventClient", Camera)
    session: Any = SimpleNamespace(start_game=lambda *_: None)
    config = config_of(*overrides, command=["tcsc"], **options)
    cases = list(Dp2().cases(config))
    for case in cases:
        with pytest.raises(InterruptedError):
            Dp2().fly(config, case, session)
    return {case.id: settings for case, settings in zip(cases, asked, strict=True)}


def test_games_alone_are_perturbed_the_more_the_faster_the_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    """At 26x half of the share, at 76x three quarters of it; each game samples its own images, in colour."""
    keys = "perturbation={share: 0.08, half_excess: 25, kinds: [empty]}", "clock_speed=[26, 76]"
    found = cameras(monkeypatch, *keys, "guard.max_retries=1")
    assert [settings[0] for settings in found.values()] == ["gray", "colour", "colour", "colour"]
    assert [settings[1].max_retries for settings in found.values()] == [1] * 4
    *clean, half, most = (settings[2] for settings in found.values())
    assert clean == [None, None]
    assert (half.share, most.share) == pytest.approx((0.04, 0.06))
    assert half.kinds == most.kinds == ("empty",)
    assert len({half.seed, most.seed, cameras(monkeypatch, *keys, seed=1)["tcsc-k26"][2].seed}) == 3
    assert cameras(monkeypatch, *keys)["tcsc-k26"][2] == half
    assert cameras(monkeypatch, "perturbation.share=0.08", "clock_speed=[26]")["tcsc-k26"][2].share == 0.08


@pytest.mark.parametrize("exposed", [False, True])
def test_without_perturbation_images_are_gray(exposed: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    found = cameras(monkeypatch, f"auto_exposure={str(exposed).lower()}", "clock_speed=[1, 50]").values()
    assert [settings[0] for settings in found] == ["colour", "gray", "gray"]
    assert [(settings[2], settings[3] is not None) for settings in found] == [(None, exposed)] * 3


def test_events_in_flight_are_of_one_sensor_whatever_the_seed(monkeypatch: pytest.MonkeyPatch) -> None:
    keys = "dvs_rate_hz=100", "dvs_preset=noisy", "clock_speed=[1, 50]"
    one, other, another = (
        {tuple(found[4:]) for found in cameras(monkeypatch, *keys, f"sensor_seed={sensor}", seed=seed).values()}
        for sensor, seed in ((3, 0), (3, 9), (4, 0))
    )
    assert (one == other, len(one), {each[1:] for each in one | another}) == (True, 1, {(5, 3), (5, 4)})


def test_a_late_sample_is_its_commands_last_one(monkeypatch: pytest.MonkeyPatch) -> None:
    flown: list[Any] = []

    def last_alone(camera: Any, _: Any, *asked: Any) -> Any:
        flown.append(asked)
        return [camera.read_sample(None)]

    camera: Any = SimpleNamespace(kinematics=lambda: None, now_ns=lambda: 10**9 * len(flown))
    camera.read_sample = lambda _: SimpleNamespace(state=SimpleNamespace(position_m=len(flown)))
    monkeypatch.setitem(COMMANDS, "tcsc", SynchronousCommand(lambda _: None, cast(Any, last_alone)))
    config = config_of("t_th_wall_s=0.001", profile="airsim")
    case = Game("game", "tcsc", 100.0, "virtual", 0.0)
    samples, indices, commands, wall_s = dp2.fly_to_the_end(config, case, camera)
    assert (len(samples), indices, commands, wall_s) == (5, [0, 3, 6, 9, 12], 4, 4.0)
    assert flown == [(1.0, 0.33, 33_000_000)] * 4, "T_th is a tenth of T_sample"


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
    names = ["position_error_m_max", "attitude_error_deg_max", "dvs_ed_percent_max", "paired_images"]
    names += ["poses_equal_lockstep", "dvs_counts_equal_lockstep"]
    for clock_speed in (1.0, 100.0):
        assert [cells["tcsc", clock_speed][name] for name in names] == [0.0, 0.0, 0.0, SAMPLES - 1, True, True]
    adsc = cells["adsc", 100.0]
    assert adsc["position_error_m_max"] > 0.01
    assert adsc["dvs_ed_percent_max"] > 0.0
    assert (adsc["poses_equal_lockstep"], adsc["reference"]["case"]) == (False, "reference-adsc-k1")


@needs_opengl
def test_games_are_the_same_again(run: RunDirectory) -> None:
    """So it does not matter which process flies a game, and after which others."""
    config, by_case = configured("dp2", SHORT_PATH, clock_speed=[1.0, 100.0]), {row["case"]: row for row in run.rows()}
    for case in reversed(list(Dp2().cases(config))[-2:]):
        row, arrays = fly(config, case)
        expected = by_case[case.id]
        assert {"suite": "dp2", "case": case.id, **row, **subset(expected, "arrays", "arrays_sha256")} == expected
        stored = run.load_arrays(expected)
        assert {name: own.tobytes() for name, own in arrays.items()} == {
            n: each.tobytes() for n, each in stored.items()
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
    Dp2().form.check_arrays(arrays, row, "as many samples and commands as in the row")
    assert len(np.unique(arrays["position_m"][1:], axis=0)) == len(arrays["position_m"]) - 1


def test_a_lane_of_ones_own_may_have_wind() -> None:
    lane = "lane={obstacles: [{x_m: 3.0, y_m: 0.0, half_side_m: 0.5}], wind_m_s: [1.0, 0.0, 0.5]}"
    assert lane_layout(config_of(lane).wire_lane).wind_m_s == (1.0, 0.0, 0.5)
    of_seed_3 = "lane={seed: 3, difficulty: {wind_m_s: 4.0}}"
    assert np.linalg.norm(lane_layout(config_of(of_seed_3).wire_lane).wind_m_s) == pytest.approx(4.0)


# --- reports: tests/test_reports.py has their numbers -----------------------------------------------------------


@pytest.mark.parametrize(("turned", "equal"), [(0.0, True), (1e-9, False)])
def test_poses_are_equal_to_the_last_bit_of_the_attitude(turned: float, equal: bool, tmp_path: Path) -> None:
    report = made.dp2(tmp_path / "run", [dp2_game("lockstep"), dp2_game("game", ORIENTATION_WXYZ=yaw(0, turned))])
    assert report.summary["cells"][0]["poses_equal_lockstep"] is equal


def test_events_that_are_counted_later_are_of_one_sensor(tmp_path: Path) -> None:
    """A ramp of brightness, over which thresholds that differ by pixel make other events."""
    dark = np.full(SIZE, 100, np.uint8)
    ramp = np.linspace(100, 150, dark.size).astype(np.uint8).reshape(SIZE)
    images = {"reference": [ramp, ramp, dark], "game": [dark, ramp, dark]}
    games = [
        uncounted(dp2_game(role, "tcsc", 1.0, (0, 0.0), (0, 0.0), IMAGE=np.array(image)))
        for role, image in images.items()
    ]
    keys: list[dict[str, Any]] = [{}, {"seed": 9}, {"sensor_seed": 1}, {"dvs_preset": "noisy"}]
    reports = [made.dp2(tmp_path / f"{n}", games, **own) for n, own in enumerate(keys)]
    one, other_run, other_sensor, noisy = (report.scores.dvs_ed_percent.iloc[1] for report in reports)
    assert 20.0 < one[0] < 80.0, "the first image makes no events, the second does"
    assert other_run == one
    assert other_sensor != one != noisy


def test_a_command_starts_at_its_first_sample(tmp_path: Path) -> None:
    """Two commands of three samples, of which the first came late and a collision ended the second."""
    late: dict[str, Any] = {"SAMPLE_INDEX": np.array([0, 1, 3, 4]), "TIME_S": np.array([0.0, 0.34, 1.02, 1.4])}
    late |= {"POSITION_M": np.zeros((4, 3)), "IMAGE": np.full((4, *SIZE), 100, np.uint8)}
    late |= {"COMMAND_VELOCITY_M_S": np.array([[1.0, 0.0], [0.5, -0.5]]), "DVS_ON": active(0, 1, 2, 3)}
    crashed = dp2_game("game", "adsc", 10.0, **late, DVS_OFF=active(0, 0, 1, 1), **hit("post"))
    report = made.dp2(tmp_path / "run", [crashed])
    flight = Dp2().flight(report, report.games.iloc[0])
    commands = flight.commands
    assert flight.collision == (500_000_000, "post")
    assert (commands.start_ns / 1e9).tolist() == [0.0, 1.02]
    assert (commands.end_ns / 1e9).tolist() == [1.0, 1.4]
    assert commands.velocity_m_s.tolist() == [[1.0, 0.0, 0.0], [0.5, -0.5, 0.0]]


# --- page ---------------------------------------------------------------------------------------------------------


def brightness(image: NDArray[np.uint8]) -> float:
    return float((image @ np.array([0.299, 0.587, 0.114])).mean())


def sent_through(images: NDArray[np.uint8], share: float, retries: int, seed: int) -> tuple[Counter[Any], Counter[Any]]:
    """The images sent and handed on by kind, None for clean: the guard's rules written down once more."""
    perturbed = PerturbationSettings(share, seed=seed)
    sent, passed, reference = Counter[Any](), Counter[Any](), None
    for scene in images:
        before = None
        for attempt in range(retries + 1):
            image, kind = perturb_share(scene, perturbed, sent.total())
            sent[kind] += 1
            level = brightness(image)
            fine = level >= 10 and (reference is None or abs(level - reference) <= 0.1 * reference)
            if fine or attempt == retries or (before is not None and (image == before).all()):
                break
            before = image
        passed[kind] += 1
        reference = level
    return sent, passed


def test_the_guard_study_sums_up_streams_of_the_runs_own_images(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(dp2, "SHARE", 0.4)
    monkeypatch.setattr(dp2, "STREAMS", 3)
    levels = np.array([90, 94, 98, 130, 100, 100, 104, 70, 72, 74], np.uint8)
    colour = levels[:, None, None, None] + np.random.default_rng(0).integers(0, 60, (10, *SIZE, 3), np.uint8)
    calm = dp2_game("lockstep", "tcsc", 1.0, *[(0, 0.0)] * 9, COLOUR=colour)
    report = made.dp2(tmp_path / "run", [calm, dp2_game("reference")], "guard.max_retries=2", seed=5)
    study, lines = report.summary["guard_study"], dict[str, list[str]]()
    for name, retries in (("off", 0), ("on", 2)):
        streams = [sent_through(colour, 0.4, retries, 5 + n) for n in range(3)]
        sent, passed = (sum(counted, Counter[Any]()) for counted in zip(*streams, strict=True))
        for kind in PerturbationKind:
            share = passed[kind] / sent[kind] if sent[kind] else None
            assert study["by_kind"][kind][name] == {"sent": sent[kind], "passed": passed[kind], "share_passed": share}
            lines.setdefault(kind, []).append("-" if share is None else f"{share:.1%}")
        assert study["perturbed_share_handed_on"][name] == pytest.approx(1 - passed[None] / 30)
    alarms = sent_through(colour, 0.0, 2, 5)
    assert study["clean_false_alarms"] == study["clean_retries"] == alarms[0][None] - alarms[1][None] > 0
    assert [study[key] for key in ("modelled", "images", "share", "streams")] == [True, 10, 0.4, 3]
    *_, table, said, _ = Dp2().page(report)
    assert isinstance(table, Table)
    assert [[kind, *shares] for kind, _, *shares in table.rows] == [
        [kind.replace("_", " "), *shares] for kind, shares in lines.items()
    ]
    assert str(said).startswith(f"False alarms: {study['clean_false_alarms']} of 10 clean images. With 40% of the")


# --- figure 7 -----------------------------------------------------------------------------------------------------
