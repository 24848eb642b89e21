"""DP2's report, from rows and arrays: every number, on games whose errors are known by hand, its figure and page."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from numpy.typing import NDArray

from tests.drawing import headline, legend_texts, record_figures, texts
from tests.running import configured
from uavaccel.draw import style
from uavaccel.draw.page import Table
from uavaccel.errors import UserError
from uavaccel.records import RunDirectory
from uavaccel.suites import dp2
from uavaccel.suites.dp2 import ERRORS, Dp2
from uavaccel.suites.report import Report
from uavaccel.suites.rows import subset
from uavaccel.vision.perturb import PerturbationKind, PerturbationSettings, perturb_share
from uavaccel.wire.latency import LatencyConfig

Game = tuple[dict[str, Any], dict[str, NDArray[Any]]]
EIGHTH = 12.5  # % of the pixels
SIZE = (144, 256)


def active(*eighths: int) -> NDArray[np.uint8]:
    """Event counts (n, 144, 256) in which so many eighths of the pixels have seen something."""
    counts = np.zeros((len(eighths), *SIZE), np.uint8)
    for image, share in zip(counts, eighths, strict=True):
        image[: 18 * share] = 1 + share
    return counts


def yaw(*degrees: float) -> NDArray[np.float64]:
    half = np.radians(degrees) / 2
    return np.column_stack([np.cos(half), 0 * half, 0 * half, np.sin(half)])


def game(role: str, command: str = "tcsc", clock_speed: float = 1.0, *errors: tuple[int, float], **keys: Any) -> Game:
    """A game with an image for each error, in eighths of the pixels and metres aside, after the start's.

    Upper-case `keys` replace its arrays, others the keys of its row.
    """
    eighths, aside_m = zip((0, 0.0), *(errors or [(0, 0.0)]), strict=True)
    places = np.arange(len(eighths))
    arrays: dict[str, Any] = {
        "sample_index": places,
        "position_m": np.column_stack([places, aside_m, np.full(len(places), -10.0)]).astype(float),
        "image": np.full((len(places), *SIZE), 100, np.uint8),
        "dvs_on": active(*eighths),
        "dvs_off": active(*[0] * len(places)),
        "command_velocity_m_s": np.array([[1.0, 0.5]]),
    } | {key.lower(): keys.pop(key) for key in list(keys) if key.isupper()}
    n = len(arrays["sample_index"])
    arrays = {"time_s": 0.33 * np.arange(n), "orientation_wxyz": yaw(*[0] * n), "retries": np.zeros(n, int)} | arrays
    if role == "lockstep":
        arrays.setdefault("colour", np.repeat(arrays["image"][..., None], 3, axis=-1))
    row: dict[str, Any] = {
        "case": f"{'' if role == 'game' else f'{role}-'}{command}-k{clock_speed:g}",
        "suite": "dp2", "role": role, "command": command, "clock_speed": clock_speed, "profile": "native",
        "timing": "lockstep" if role == "lockstep" else "virtual", "seed": 3, "t_move_s": 1.0, "t_sample_s": 0.33,
        "samples": n, "commands": len(arrays["command_velocity_m_s"]), "planned_commands": 2, "guard_retries": 2,
        "collision": None, "distance_m": 12.34, "wall_s": 0.03, "duration_s": 0.66, "sim_time_s": 9.0,
        "real_time_factor": 21.5, "lost_wall_s": 0.0, "error": None,
    }  # fmt: skip
    return row | keys, arrays


def hit(thing: str) -> dict[str, Any]:
    return {"collision": {"object": thing, "time_s": 0.5, "position_m": [1.0, 2.0, 3.0]}}


def counted_later(made: Game) -> Game:
    """The game without the counts of its flight."""
    return made[0], {name: array for name, array in made[1].items() if not name.startswith("dvs")}


def report_of(path: Path, *games: Game, overrides: Sequence[str] = (), changes: Any = None, **keys: Any) -> Report:
    """The report of a run of these games, whose configuration has these keys and `changes`."""
    config = configured("dp2", *overrides, **{"seed": 3} | keys)
    run = RunDirectory.create(path, config.model_copy(update=changes or {}), {"host": "synthetic"})
    for row, arrays in games:
        run.append_row(row | run.save_arrays(row["case"], arrays))
    return Dp2().report(run)


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[str, Figure]]:
    with style.project_style():
        yield record_figures(monkeypatch)


# --- numbers ------------------------------------------------------------------------------------------------------

# Shared are the samples 0, 1, 2 and 5, of which the first is the start.
REFERENCE = game(
    "reference", SAMPLE_INDEX=np.array([0, 1, 2, 4, 5]), ORIENTATION_WXYZ=yaw(0, 0, 0, 0, 10),
    POSITION_M=np.array([[9.0, 9, 9], [1, 0, 0], [2, 0, 0], [4, 0, 0], [5, 0, 0]]),
    IMAGE=np.full((5, *SIZE), 100, np.uint8), DVS_ON=active(0, 3, 3, 8, 4), DVS_OFF=active(0, 1, 4, 8, 2),
)  # fmt: skip
GAME = game(
    "game", "tcsc", 50.0, timing="wall", guard_retries=4, lost_wall_s=0.25, **hit("wall_east"), restarts=1,
    SAMPLE_INDEX=np.array([0, 1, 2, 3, 5]), ORIENTATION_WXYZ=yaw(0, 5, 0, 0, 40),
    POSITION_M=np.array([[0.0, 0, 0], [1, 0.3, 0.4], [2, 0, 0], [3, 0, 0], [5, 1.2, -0.9]]),
    IMAGE=np.full((5, *SIZE), 100, np.uint8), DVS_ON=active(8, 4, 3, 0, 8), DVS_OFF=active(8, 1, 2, 0, 0),
)  # fmt: skip
SAME: dict[str, Any] = {key.upper(): each for key, each in (GAME[1] | {"dvs_off": REFERENCE[1]["dvs_off"]}).items()}
LOCKSTEP = game("lockstep", **SAME)


def test_every_number_of_a_summary(tmp_path: Path) -> None:
    report = report_of(
        tmp_path / "run", GAME, LOCKSTEP, REFERENCE, game("game", "adsc", 5.0, error="crashed"), dvs_preset="noisy",
        sensor_seed=8, overrides=("perturbation.share=0.1",),
    )  # fmt: skip
    reference, found = report.summary["cells"]
    assert subset(report.summary, "suite", "profile", "seed", "dvs_preset", "sensor_seed", "perturbed_share") == {
        "suite": "dp2", "profile": "native", "seed": 3, "dvs_preset": "noisy", "sensor_seed": 8, "perturbed_share": 0.1,
    }  # fmt: skip
    exact = {
        "command": "tcsc", "clock_speed": 50.0, "t_move_s": 1.0, "timing": "wall", "provenance": "measured",
        "reference": {
            "case": "reference-tcsc-k1", "clock_speed": 1.0, "timing": "virtual", "provenance": "modelled",
            "is_this_cell": False,
        },
        "images": 5, "paired_images": 3, "poses_equal_lockstep": True, "dvs_counts_equal_lockstep": False,
        "guard_retries": 4, "distance_m": 12.34, "wall_s": 0.03, "real_time_factor": 21.5, "lost_wall_s": 0.25,
        "restarts": 1, **hit("wall_east"),
    }  # fmt: skip
    near = {
        # |4 - 3| + |1 - 1|, |3 - 3| + |2 - 4| and |8 - 4| + |0 - 2| eighths
        "dvs_ed_percent_median": 25.0, "dvs_ed_percent_max": 75.0,
        "position_error_m_median": 0.5, "position_error_m_max": 1.5,
        "attitude_error_deg_median": 5.0, "attitude_error_deg_max": 30.0, "simulated_s_per_wall_s": 22.0,
    }  # fmt: skip
    assert found == exact | {key: pytest.approx(value) for key, value in near.items()}
    assert (reference["reference"]["is_this_cell"], reference["position_error_m_max"]) == (True, 0.0)
    assert (reference["poses_equal_lockstep"], reference["dvs_counts_equal_lockstep"]) == (False, False)
    at_1x, by_image = report.scores[report.scores.reference.notna()].to_dict("records")
    assert (at_1x["role"], at_1x["dvs_ed_percent"]) == ("reference", [0, 0, 0, 0])
    assert [by_image[name] for name in ERRORS] == [
        pytest.approx(each) for each in ([0.5, 0.0, 1.5], [5.0, 0.0, 30.0], [12.5, 25.0, 75.0])
    ]


@pytest.mark.parametrize(("turned", "equal"), [(0.0, True), (1e-9, False)])
def test_poses_are_equal_to_the_last_bit_of_the_attitude(turned: float, equal: bool, tmp_path: Path) -> None:
    report = report_of(tmp_path / "run", game("lockstep"), game("game", ORIENTATION_WXYZ=yaw(0, turned)))
    assert report.summary["cells"][0]["poses_equal_lockstep"] is equal


def test_without_a_run_at_1x_or_in_lockstep_the_numbers_are_unknown(tmp_path: Path) -> None:
    report = report_of(tmp_path / "run", GAME, game("reference", error="crashed"))
    (cell,) = report.summary["cells"]
    spread = {f"{error}_{kind}" for error in ERRORS for kind in ("median", "max")}
    unknown = {"reference", "poses_equal_lockstep", "dvs_counts_equal_lockstep", *spread}
    assert {key for key, value in cell.items() if value is None} == unknown
    assert (cell["paired_images"], report.summary["guard_study"]) == (0, None)
    assert report.overview().rows[0][2:8] == ("0", "-", "-", "-", "4", "-, -")  # type: ignore[union-attr]


def test_games_stand_by_command_and_clock_speed_each_against_its_own_run_at_1x(tmp_path: Path) -> None:
    rows = [("lockstep", "tcsc", 1.0), ("game", "tcsc", 100.0), ("game", "tcsc", 9.0), ("game", "adsc", 5.0)]
    rows += [("game", "tcsc", 1.0), ("reference", "tcsc", 1.0), ("reference", "adsc", 1.0)]
    made = [counted_later(game(*row)) for row in rows]
    report = report_of(tmp_path / "run", *made, game("game", "tcsc", 7.0, error="crashed"))
    assert report.scores[["case", "reference", "equal_poses", "equal_counts"]].to_numpy().tolist() == [
        ["reference-adsc-k1", "reference-adsc-k1", True, True],
        ["adsc-k5", "reference-adsc-k1", True, True],
        *([case, "reference-tcsc-k1", True, True] for case in ("reference-tcsc-k1", "tcsc-k1", "tcsc-k9", "tcsc-k100")),
    ]


def test_events_that_were_not_counted_in_flight_are_those_of_one_sensor(tmp_path: Path) -> None:
    """A ramp of brightness, over which thresholds that differ by pixel make other events."""
    dark = np.full(SIZE, 100, np.uint8)
    ramp = np.linspace(100, 150, dark.size).astype(np.uint8).reshape(SIZE)
    images = {"reference": [ramp, ramp, dark], "game": [dark, ramp, dark]}
    made = [
        counted_later(game(role, "tcsc", 1.0, (0, 0.0), (0, 0.0), IMAGE=np.array(image)))
        for role, image in images.items()
    ]
    keys: list[dict[str, Any]] = [{}, {"seed": 9}, {"sensor_seed": 1}, {"dvs_preset": "noisy"}]
    reports = [report_of(tmp_path / f"{n}", *made, **own) for n, own in enumerate(keys)]
    one, other_run, other_sensor, noisy = (report.scores.dvs_ed_percent.iloc[1] for report in reports)
    assert 20.0 < one[0] < 80.0, "the first image makes no events, the second does"
    assert other_run == one
    assert other_sensor != one != noisy


def test_flights_are_read_from_the_samples(tmp_path: Path) -> None:
    """Two commands of three samples, of which the first came late and a collision ended the second."""
    late: dict[str, Any] = {"SAMPLE_INDEX": np.array([0, 1, 3, 4]), "TIME_S": np.array([0.0, 0.34, 1.02, 1.4])}
    late |= {"POSITION_M": np.zeros((4, 3)), "IMAGE": np.full((4, *SIZE), 100, np.uint8)}
    late |= {"COMMAND_VELOCITY_M_S": np.array([[1.0, 0.0], [0.5, -0.5]])}
    late |= {"DVS_ON": active(0, 1, 2, 3), "DVS_OFF": active(0, 0, 1, 1)}
    crashed = game("game", "adsc", 10.0, **late, **hit("post"))
    report = report_of(tmp_path / "run", crashed, counted_later(game("lockstep", **late)))
    flown, calm = (Dp2().flight(report, each) for _, each in report.games.iterrows())
    assert flown.title == "ADSC at ClockSpeed 10x (achieved 21.5x, modelled, hit post)"
    assert calm.title == "TCSC in lockstep, without latency"
    assert flown.commands.start_ns.tolist() == [0, 1_020_000_000]
    assert flown.commands.end_ns.tolist() == [1_000_000_000, 1_400_000_000]
    assert flown.commands.velocity_m_s.tolist() == [[1.0, 0.0, 0.0], [0.5, -0.5, 0.0]]
    assert (flown.collision, calm.collision) == ((500_000_000, "post"), None)
    assert (flown.images.shape, calm.images.shape) == ((4, *SIZE), (4, *SIZE, 3))
    assert [window.per_pixel(SIZE)[0].astype(bool).mean() for window in flown.windows] == [0.0, 0.125, 0.25, 0.375]
    assert [window.time_ns for window in calm.windows] == [340_000_000, 1_020_000_000, 1_400_000_000]
    assert flown.scene == "lane"
    assert flown.lane is not None
    assert flown.lane.x_m.tolist() == report.config.layout().x_m.tolist()
    assert Dp2().flight(report, report.games.iloc[0], pictures=False).windows == ()


# --- page ---------------------------------------------------------------------------------------------------------


def test_lines_of_the_table(tmp_path: Path) -> None:
    close = game("game", "adsc", 9.0, (1, 0.0), (0, 0.0008), disturbed=True, lost_wall_s=0.1)
    own = game("reference", "adsc", 1.0, (0, 0.0), (0, 0.0))
    table = report_of(tmp_path / "run", GAME, REFERENCE, LOCKSTEP, close, own).overview()
    assert table
    at_1x, near, _, far = (dict(zip(table.header, line, strict=True)) for line in table.rows)
    assert far == {
        "command": "TCSC", "ClockSpeed": "50x", "images": "3", "position error, m: median, max": "0.500, 1.500",
        "attitude error, deg: max": "30.000", "DVS-ED, %: median, max": "25.000, 75.000", "guard retries": "4",
        "poses, counts v. lockstep": "equal, differ", "distance, m": "12.3 (hit wall_east)",
        "simulated s a wall s": "22.00", "source": "measured",
    }  # fmt: skip
    assert tuple(at_1x.values())[:7] == ("ADSC", "1x (reference)", "2", "0, 0", "0", "0, 0", "2")
    assert (at_1x["distance, m"], at_1x["source"]) == ("12.3", "modelled")
    assert (near["ClockSpeed"], near["position error, m: median, max"]) == ("9x (disturbed)", "4.0e-04, 8.0e-04")


LIKE = "takes the images of 1x, each at the same place with as many events"
UNLIKE = "ADSC at {}x takes its images up to {} m from those of 1x, with a DVS-ED of up to {} %"
NONE = "{} games, none of them accelerated and comparable with 1x"


@pytest.mark.parametrize(
    ("games", "said"),
    [
        ([("tcsc", 20.0, 0, 0.0), ("tcsc", 5.0, 1, 0.125), ("tcsc", 1.0, 0, 0.0)], f"TCSC at 20x {LIKE}"),
        ([("adsc", 50.0, 1, 0.25), ("adsc", 9.0, 2, 0.75), ("tcsc", 20.0, 0, 0.0)],
         f"{UNLIKE.format(50, '0.250', '12.500')}; TCSC at 20x {LIKE}"),
        ([("adsc", 5.0, 2, 0.0)], UNLIKE.format(5, "0", "25.000")),
        ([("adsc", 5.0, 0, 0.5)], UNLIKE.format(5, "0.500", "0")),
        ([("adsc", 1.0, 1, 1.0), ("tcsc", 90.0, 4, 3.0, "lockstep")], NONE.format(4)),
        ([], NONE.format(2)),
    ],
)  # fmt: skip
def test_the_headline_is_of_each_commands_fastest_game(games: list[Any], said: str, tmp_path: Path) -> None:
    made = [
        game("game", command, speed, (eighths, metres), timing=clock[0] if clock else "virtual")
        for command, speed, eighths, metres, *clock in games
    ]
    assert report_of(tmp_path / "run", game("reference"), game("reference", "adsc"), *made).headline() == said


NO_DRAWING = "The modelled wall times leave out drawing the images"
SHARE = "Modelled: 10.0% of the images of the games were perturbed on their way"
NO_IMAGES = {"latency": LatencyConfig()}
SHARE_OF = "perturbation={share: 0.1, half_excess: %s}"


@pytest.mark.parametrize(
    ("games", "overrides", "said"),
    [
        ([], [], []),
        ([hit("post") | {"distance_m": 3.25}], [], ["tcsc-k5 hit post after 3.2 m and stood still from there"]),
        ([{"error": "crashed"}], [], ["Warning: 1 games failed and are left out"]),
        ([{"lost_wall_s": 0.5}, {"lost_wall_s": 0.25}], [], [
            "Warning: the machine could not keep up and lost 0.750 s of wall time."]),
        ([{"disturbed": True}, {}], [], ["Warning: 1 games were disturbed"]),
        ([{}], [SHARE_OF % "null"], [f"{SHARE}; those of the runs at 1x"]),
        ([{}], [SHARE_OF % 9], [f"{SHARE}, fewer where the ClockSpeed is low; those"]),
        ([{"timing": "wall"}, {}], NO_IMAGES, [NO_DRAWING]),
        ([{"timing": "wall"}, {"timing": "lockstep"}], NO_IMAGES, []),
    ],
)  # fmt: skip
def test_the_page_warns_of_what_a_reader_has_to_know(
    games: list[Any], overrides: Any, said: list[str], tmp_path: Path, drawn: dict[str, Figure]
) -> None:
    """Game by game: the first flew at 5x, and each at 1x more than the one before."""
    made = [game("game", "tcsc", 5.0 + n, **change) for n, change in enumerate(games or [{}])]
    changes = overrides if isinstance(overrides, dict) else {}
    report = report_of(tmp_path / "run", *made, overrides=() if changes else overrides, changes=changes)
    found = [block for block in Dp2().page(report) if isinstance(block, str)][1:-1]
    assert [text[: len(start)] for text, start in zip(found, said, strict=True)] == said


def test_the_written_report(tmp_path: Path, drawn: dict[str, Figure]) -> None:
    slow, fast = game("game", "adsc", 5.0, error="crashed"), game("game", "tcsc", 50.0, (1, 0.5), timing="wall")
    report = report_of(tmp_path / "run", game("lockstep"), game("reference"), slow, fast)
    assert report.write() == report.run.read_json("summary.json")
    source = "modelled (virtual clock): 1 game · measured (wall clock): 1 game · native profile · seed 3"
    text = (report.run.path / "report.md").read_text()
    assert text.startswith(
        f"# DP2, native profile, seed 3\n\n{report.headline()}.\n\nGames: modelled (no latency): 1 game · "
    )
    for words in (
        f"linear up to 0.1 % and 1 mm. Source: {headline(drawn['figure7_images'])[1]}.",
        "Figure 7. ",
        "1 games failed",
        "False alarms: 0 of 2 clean images. With 5% of the images perturbed",
        "sent 20 times",
        *(" | ".join(line) for line in report.overview().rows),  # type: ignore[union-attr]
    ):
        assert words in text, words
    assert sorted(headline(drawn["figure7_images"])[1].split(" · ")) == sorted(source.split(" · "))


def test_a_run_without_games_is_the_users_mistake(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"rows\.jsonl: holds no finished game of dp2"):
        report_of(tmp_path / "run")


# --- guard --------------------------------------------------------------------------------------------------------


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
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, drawn: dict[str, Figure]
) -> None:
    for name, value in {"GUARD_SHARE": 0.4, "GUARD_STREAMS": 3}.items():
        monkeypatch.setattr(dp2, name, value)
    levels = np.array([90, 94, 98, 130, 100, 100, 104, 70, 72, 74], np.uint8)
    colour = levels[:, None, None, None] + np.random.default_rng(0).integers(0, 60, (10, *SIZE, 3), np.uint8)
    made = game("lockstep", "tcsc", 1.0, *[(0, 0.0)] * 9, COLOUR=colour)
    report = report_of(tmp_path / "run", made, game("reference"), overrides=("guard.max_retries=2",), seed=5)
    study = report.summary["guard_study"]
    passing = {}
    for name, retries in (("off", 0), ("on", 2)):
        streams = [sent_through(colour, 0.4, retries, 5 + n) for n in range(3)]
        sent, passed = (sum(counted, Counter[Any]()) for counted in zip(*streams, strict=True))
        for kind in PerturbationKind:
            share = passed[kind] / sent[kind] if sent[kind] else None
            assert study["by_kind"][kind][name] == {"sent": sent[kind], "passed": passed[kind], "share_passed": share}
        assert study["perturbed_share_handed_on"][name] == pytest.approx(1 - passed[None] / 30)
        passing[name] = [sum(each[kind] for kind in PerturbationKind) for each in (sent, passed)]
    sent, passed = sent_through(colour, 0.0, 2, 5)
    assert study["clean_false_alarms"] == study["clean_retries"] == sent[None] - passed[None] > 0
    assert subset(study, "modelled", "images", "share", "streams") == {
        "modelled": True, "images": 10, "share": 0.4, "streams": 3,
    }  # fmt: skip
    *_, table, said = Dp2().page(report)
    assert isinstance(table, Table)
    shares = [f"{passed / sent:.1%}" for sent, passed in passing.values()]
    assert table.rows[-1] == ("all", str(passing["on"][0]), *shares)
    salt = study["by_kind"]["salt_and_pepper"]
    assert table.rows[0] == ("salt and pepper", str(salt["on"]["sent"]),
                             *(f"{salt[name]['share_passed']:.1%}" for name in ("off", "on")))  # fmt: skip
    handed_on = study["perturbed_share_handed_on"]
    assert str(said).startswith(
        f"False alarms: {study['clean_false_alarms']} of 10 clean images. With 40% of the images perturbed, "
        f"{handed_on['off']:.1%} of those handed on are perturbed without the guard and {handed_on['on']:.1%} with it."
    )


# --- figure 7 -----------------------------------------------------------------------------------------------------

ADSC = [("adsc", 5.0, (0, 0.0), (1, 0.0), (0, 0.02)), ("adsc", 100.0, (2, 3.0), (3, 4.0))]
EXACT = ("tcsc", 5.0, (0, 0.0), (0, 0.0), (0, 0.0))
Cloud = tuple[Any, ...]


def figure_of(path: Path, drawn: dict[str, Figure], clouds: list[Cloud]) -> Any:
    at_1x = [game("reference", command, 1.0, *[(0, 0.0)] * 3) for command in ("adsc", "tcsc")]
    dp2.images_figure(report_of(path, *at_1x, *(game("game", *cloud) for cloud in clouds)))
    return drawn["figure7_images"]


def shown(axes: Any) -> list[tuple[float, float]]:
    return [tuple(np.round(point, 9).tolist()) for group in axes.collections for point in group.get_offsets()]


def test_clouds_stand_by_command_and_clock_speed(tmp_path: Path, drawn: dict[str, Figure]) -> None:
    figure = figure_of(tmp_path / "run", drawn, [*ADSC, ("tcsc", 5.0, (0, 0.0)), ("tcsc", 100.0, (0, 0.0), (4, 0.5))])
    assert headline(figure) == (
        "Position error and DVS-ED of each image against the run at 1x",
        "modelled (virtual clock): 6 games · native profile · seed 3",
    )
    tcsc, adsc = figure.axes  # TCSC first, as in the paper
    # The fastest first, so that few and near points lie on top; one ring for the images at 0.
    assert shown(tcsc) == [(4 * EIGHTH, 0.5), (0.0, 0.0), (0.0, 0.0)]
    assert shown(adsc) == [(2 * EIGHTH, 3.0), (3 * EIGHTH, 4.0), (EIGHTH, 0.0), (0.0, 0.02), (0.0, 0.0)]
    legends = [axes.get_legend() for axes in figure.axes]
    assert [(legend.get_title().get_text(), legend_texts(legend)) for legend in legends] == [
        ("TCSC", ["5x: all 1 at 0, 0", "100x: 1 of 2 at 0, 0"]),
        ("ADSC", ["5x: 1 of 3 at 0, 0", "100x: 2 images"]),
    ]
    assert [axes.get_xlabel() for axes in figure.axes] == ["DVS-ED, % of the pixels"] * 2
    assert (tcsc.get_ylabel(), adsc.get_ylabel()) == ("position error, m", "")
    assert tcsc.get_shared_x_axes().joined(tcsc, adsc)
    assert tcsc.get_shared_y_axes().joined(tcsc, adsc)
    fast_adsc, _, slow_adsc, slow_ring, *_ = adsc.collections  # one colour and ring for a ClockSpeed in every panel
    fast_tcsc, fast_ring, *_ = tcsc.collections
    assert np.array_equal(fast_adsc.get_facecolor(), fast_tcsc.get_facecolor())
    assert not np.array_equal(fast_adsc.get_facecolor(), slow_adsc.get_facecolor())
    assert np.array_equal(slow_ring.get_edgecolor()[0, :3], slow_adsc.get_facecolor()[0, :3])
    assert slow_ring.get_facecolor().size == fast_ring.get_facecolor().size == 0
    assert fast_ring.get_sizes()[0] > slow_ring.get_sizes()[0]  # so that one does not hide the other
    for axis, limits, unit, most in (
        (tcsc.get_xaxis(), tcsc.get_xlim(), 0.1, 100),
        (tcsc.get_yaxis(), tcsc.get_ylim(), 0.001, 10),
    ):
        assert limits == pytest.approx((-0.4 * unit, most))
        zero, half, one, ten, hundred = axis.get_transform().transform(unit * np.array([0.0, 0.5, 1.0, 10.0, 100.0]))
        assert half - zero == pytest.approx(one - half), "linear next to 0"
        assert hundred - ten == pytest.approx(ten - one), "else logarithmic"


@pytest.mark.parametrize(
    ("clouds", "panels", "below", "note"),
    [
        ([*ADSC, EXACT], 1, ["TCSC at 5x: all 3 images at 0, 0"], []),
        ([*ADSC, ("tcsc", 100.0, (0, 0.0)), EXACT], 1, ["TCSC at 5x, 100x: all 4 images at 0, 0"], []),
        ([*ADSC, ("tcsc", 100.0, (0, 0.1)), EXACT], 2, [], []),
        ([EXACT], 1, ["TCSC at 5x: all 3 images at 0, 0"], ["every image has no error at all"]),
        ([], 1, [], ["no accelerated game to compare with a run at 1x"]),
    ],
)
def test_a_command_without_any_error_has_a_line_in_place_of_an_empty_panel(
    clouds: list[Cloud], panels: int, below: list[str], note: list[str], tmp_path: Path, drawn: dict[str, Figure]
) -> None:
    figure = figure_of(tmp_path / "run", drawn, clouds)
    assert (len(figure.axes), headline(figure)[1].split("\n")[:-1]) == (panels, below)
    assert texts(figure.axes[0]) == note
