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

from tests.drawing import legend_texts, record_figures, texts
from tests.running import configured
from uavaccel.draw import style
from uavaccel.draw.page import Table
from uavaccel.records import RunDirectory
from uavaccel.suites import dp2, guard_study
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
    assert report.overview().rows[0][3:10] == ("0", "-", "-", "-", "-", "-", "4")  # type: ignore[union-attr]


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


def test_a_command_starts_at_its_first_sample_even_if_others_are_missing(tmp_path: Path) -> None:
    """Two commands of three samples, of which the first came late and a collision ended the second."""
    late: dict[str, Any] = {"SAMPLE_INDEX": np.array([0, 1, 3, 4]), "TIME_S": np.array([0.0, 0.34, 1.02, 1.4])}
    late |= {"POSITION_M": np.zeros((4, 3)), "IMAGE": np.full((4, *SIZE), 100, np.uint8)}
    late |= {"COMMAND_VELOCITY_M_S": np.array([[1.0, 0.0], [0.5, -0.5]]), "DVS_ON": active(0, 1, 2, 3)}
    crashed = game("game", "adsc", 10.0, **late, DVS_OFF=active(0, 0, 1, 1), **hit("post"))
    report = report_of(tmp_path / "run", crashed)
    flight = Dp2().flight(report, report.games.iloc[0])
    commands = flight.commands
    assert flight.collision == (500_000_000, "post")
    assert (commands.start_ns / 1e9).tolist() == [0.0, 1.02]
    assert (commands.end_ns / 1e9).tolist() == [1.0, 1.4]
    assert commands.velocity_m_s.tolist() == [[1.0, 0.0, 0.0], [0.5, -0.5, 0.0]]


# --- page ---------------------------------------------------------------------------------------------------------


SAID = "{} takes its images up to {} m from where it takes them at 1x (DVS-ED up to {} %)"


def test_the_written_report(tmp_path: Path, drawn: dict[str, Figure]) -> None:
    """Its headline is of each command's fastest game; the table has a line for each command and ClockSpeed."""
    close = game("game", "adsc", 9.0, (1, 0.0), (0, 0.0008))
    ideal = game("game", "adsc", 90.0, (4, 3.0), timing="lockstep")
    at_1x = game("reference", "adsc", 1.0, (0, 0.0), (0, 0.0))
    report = report_of(tmp_path / "run", GAME, REFERENCE, LOCKSTEP, close, ideal, at_1x)
    table = report.overview()
    assert report.write() == report.run.read_json("summary.json")
    text = (report.run.path / "report.md").read_text()
    said = f"{SAID.format('At 9x ADSC', '0.0008', '12.5')}; {SAID.format('at 50x TCSC', '1.5', '75')}"
    source = "Modelled (no latency): 2 games · modelled (virtual clock): 3 games · measured (wall clock): 1 game"
    assert text.startswith(f"# DP2, native profile, seed 3\n\n{said}.\n\n{source} · native profile · seed 3\n\n")
    assert "1 mm. Modelled (no latency) and modelled (virtual clock) and measured (wall clock)." in text
    assert "False alarms: 0 of 5 clean images. With 5% of the images perturbed, " in text
    assert table
    assert all(" | ".join(line) in text.replace("\\_", "_") for line in table.rows)
    slow, near, *_, far = table.rows
    assert far == (
        *("TCSC", "50x", "measured", "3", "0.5, 1.5", "30", "25, 75", "True", "False", "4", "12.3"),
        *("wall_east", "22.00", "-"),
    )
    assert (slow[:7], near[4]) == (("ADSC", "1x", "modelled", "2", "0, 0", "0", "0, 0"), "0.0004, 0.0008")


def test_the_page_warns_of_what_a_reader_has_to_know(tmp_path: Path, drawn: dict[str, Figure]) -> None:
    """A run on the machine's clock may have all of it to say, one in lockstep nothing."""
    changes: list[Any] = [{"error": "crashed"}, {"lost_wall_s": 0.5, "disturbed": True}, {"lost_wall_s": 0.25}]
    made = [game("game", "tcsc", 5.0 + n, timing="wall", **change) for n, change in enumerate(changes)]
    perturbed, no_channel = ["perturbation.share=0.1"], {"latency": LatencyConfig()}
    reports = {
        "all": report_of(tmp_path / "all", *made, game("reference"), overrides=perturbed, changes=no_channel),
        "none": report_of(tmp_path / "none", game("game", timing="lockstep"), changes=no_channel),
        "channel": report_of(tmp_path / "channel", game("game", "tcsc", 1.0, (1, 0.5)), game("reference")),
    }
    found = {name: [block for block in Dp2().page(own) if isinstance(block, str)] for name, own in reports.items()}
    said = (
        "Warning: 1 games failed and are left out",
        "Warning: the machine could not keep up and lost 0.750 s of wall time.",
        "Warning: 1 games were disturbed",
        "Modelled: up to 10.0% of the games' images were perturbed on their way",
        "The modelled wall times leave out drawing the images",
    )
    assert [text[: len(start)] for text, start in zip(found.pop("all"), said, strict=True)] == list(said)
    assert found == {"none": [], "channel": []}
    none = "{} games, none of them accelerated and comparable with 1x"
    assert [reports[name].headline() for name in ("none", "channel")] == [none.format(1), none.format(2)]


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
    monkeypatch.setattr(guard_study, "SHARE", 0.4)
    monkeypatch.setattr(guard_study, "STREAMS", 3)
    levels = np.array([90, 94, 98, 130, 100, 100, 104, 70, 72, 74], np.uint8)
    colour = levels[:, None, None, None] + np.random.default_rng(0).integers(0, 60, (10, *SIZE, 3), np.uint8)
    made = game("lockstep", "tcsc", 1.0, *[(0, 0.0)] * 9, COLOUR=colour)
    report = report_of(tmp_path / "run", made, game("reference"), overrides=("guard.max_retries=2",), seed=5)
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

ADSC: list[Any] = [("adsc", 5.0, (0, 0.0), (1, 0.0), (0, 0.02)), ("adsc", 100.0, (2, 3.0), (3, 4.0))]
TCSC: list[Any] = [("tcsc", 5.0, (0, 0.0)), ("tcsc", 100.0, (0, 0.0), (4, 0.5))]


def shown(axes: Any) -> list[tuple[float, float]]:
    return [tuple(np.round(point, 9).tolist()) for group in axes.collections for point in group.get_offsets()]


def test_clouds_stand_by_command_and_clock_speed(tmp_path: Path, drawn: dict[str, Figure]) -> None:
    at_1x = [game("reference", command, 1.0, *[(0, 0.0)] * 3) for command in ("adsc", "tcsc")]
    dp2.images_figure(report_of(tmp_path / "run", *at_1x, *(game("game", *cloud) for cloud in (*ADSC, *TCSC))))
    figure: Any = drawn["figure7_images"]
    adsc, tcsc = figure.axes
    # The fastest first, so that few and near points lie on top; one ring for the images at 0.
    assert shown(tcsc) == [(4 * EIGHTH, 0.5), (0.0, 0.0), (0.0, 0.0)]
    assert shown(adsc) == [(2 * EIGHTH, 3.0), (3 * EIGHTH, 4.0), (EIGHTH, 0.0), (0.0, 0.02), (0.0, 0.0)]
    legends = [axes.get_legend() for axes in figure.axes]
    assert [(legend.get_title().get_text(), legend_texts(legend)) for legend in legends] == [
        ("ADSC", ["5x: 1 of 3 at 0, 0", "100x: 0 of 2 at 0, 0"]),
        ("TCSC", ["5x: 1 of 1 at 0, 0", "100x: 1 of 2 at 0, 0"]),
    ]
    assert [axes.get_xlabel() for axes in figure.axes] == ["", "DVS-ED, % of the pixels"]
    assert tcsc.get_shared_x_axes().joined(tcsc, adsc)
    assert tcsc.get_shared_y_axes().joined(tcsc, adsc)
    fast_adsc, slow_adsc, slow_ring = adsc.collections  # one colour and ring for a ClockSpeed in every panel
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


def test_without_an_accelerated_game_the_figure_says_so(tmp_path: Path, drawn: dict[str, Figure]) -> None:
    dp2.images_figure(report_of(tmp_path / "run", game("reference")))
    assert texts(drawn["figure7_images"].axes[0]) == ["no accelerated game to compare with a run at 1x"]
