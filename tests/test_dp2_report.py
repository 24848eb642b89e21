"""DP2's summary, table and report: every number against a few independent lines on small made-up games."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.drawing import headline, record_figures
from uavaccel.draw.document import Paragraph
from uavaccel.errors import UserError
from uavaccel.records import RunDirectory
from uavaccel.suites.experiment import read_mapping, resolve
from uavaccel.suites.old_dp2.config import Dp2Config
from uavaccel.suites.old_dp2.report import Dp2Report, guard_sentence, guard_table, table
from uavaccel.suites.old_dp2.scores import (
    ObservedFlight,
    count_events,
    counts_of,
    score_game,
    score_games,
    study_guard,
    summary_of,
)
from uavaccel.vision.dvs import PRESETS, DvsParameters
from uavaccel.vision.guard import GuardSettings
from uavaccel.vision.guard_study import guard_study

PIXELS = (2, 5)


def row_of(role: str, command: str = "tcsc", clock_speed: float = 1.0, **keys: Any) -> Any:
    prefix = "" if role == "game" else f"{role}-"
    return {
        "case": f"{prefix}{command}-k{clock_speed:g}",
        "suite": "dp2",
        "role": role,
        "command": command,
        "clock_speed": clock_speed,
        "t_move_s": 0.66,
        "timing": "virtual",
        "profile": "native",
        "seed": 3,
        "samples": 5,
        "guard_retries": 2,
        "collision": None,
        "distance_m": 12.34,
        "wall_s": 0.03,
        "duration_s": 0.66,
        "real_time_factor": 21.5,
        "lost_wall_s": 0.0,
        "error": None,
    } | keys


def counts(*active: int) -> np.ndarray:
    """Event counts (n, 2, 5) in which so many pixels have seen something."""
    images = np.zeros((len(active), 10), np.uint16)
    for image, pixels in zip(images, active, strict=True):
        image[:pixels] = 1 + np.arange(pixels)
    return images.reshape(-1, *PIXELS)


def yaw(*degrees: float) -> np.ndarray:
    half = np.radians(degrees) / 2
    return np.column_stack([np.cos(half), 0 * half, 0 * half, np.sin(half)])


def seen(row: Any, index: list[int], position_m: Any, *senses: np.ndarray) -> ObservedFlight:
    return ObservedFlight(row, np.array(index, np.int32), np.array(position_m, float), *senses)


# Shared are the samples 0, 1, 2 and 5, of which the first is the start.
REFERENCE = seen(
    row_of("reference"), [0, 1, 2, 4, 5], [[9, 9, 9], [1, 0, 0], [2, 0, 0], [4, 0, 0], [5, 0, 0]],
    yaw(0, 0, 0, 0, 10), counts(0, 3, 3, 9, 4), counts(0, 1, 5, 9, 2),
)  # fmt: skip
GAME = seen(
    row_of("game", clock_speed=50.0, timing="wall", guard_retries=4, lost_wall_s=0.25,
           collision={"object": "wall_east"}),
    [0, 1, 2, 3, 5], [[0, 0, 0], [1, 0.3, 0.4], [2, 0, 0], [3, 0, 0], [5, 1.2, -0.9]],
    yaw(0, 5, 0, 0, 40), counts(9, 4, 3, 0, 9), counts(9, 1, 2, 0, 0),
)  # fmt: skip
CONFIG = {
    "profile": "native",
    "seed": 3,
    "dvs_preset": "noisy",
    "sensor_seed": 8,
    "perturbation": {"share": 0.1},
}


def test_every_number_of_a_summary() -> None:
    lockstep = replace(GAME, row=row_of("lockstep"), off=REFERENCE.off)
    score = score_game(GAME, REFERENCE, lockstep)
    # |4 - 3| + |1 - 1|, |3 - 3| + |2 - 5| and |9 - 4| + |0 - 2| of 10 pixels.
    assert score.dvs_ed_percent.tolist() == [10.0, 30.0, 70.0]
    assert score.position_error_m == pytest.approx([0.5, 0.0, 1.5])
    assert score.attitude_error_deg == pytest.approx([5.0, 0.0, 30.0])
    summary = summary_of(CONFIG, [score, score_game(REFERENCE, REFERENCE, None)], {"a": "study"})
    game, reference = summary.pop("cells")
    assert summary == {
        "suite": "dp2",
        "profile": "native",
        "seed": 3,
        "dvs_preset": "noisy",
        "sensor_seed": 8,
        "perturbed_share": 0.1,
        "guard_study": {"a": "study"},
    }
    exact = {
        "command": "tcsc",
        "clock_speed": 50.0,
        "t_move_s": 0.66,
        "timing": "wall",
        "provenance": "measured",
        "reference": {
            "case": "reference-tcsc-k1",
            "clock_speed": 1.0,
            "timing": "virtual",
            "provenance": "modelled",
            "is_this_cell": False,
        },
        "images": 5,
        "paired_images": 3,
        "poses_equal_lockstep": True,
        "dvs_counts_equal_lockstep": False,
        "guard_retries": 4,
        "collision": {"object": "wall_east"},
        "distance_m": 12.34,
        "wall_s": 0.03,
        "real_time_factor": 21.5,
        "lost_wall_s": 0.25,
    }
    near = {
        "position_error_m_median": 0.5,
        "position_error_m_max": 1.5,
        "attitude_error_deg_median": 5.0,
        "attitude_error_deg_max": 30.0,
        "dvs_ed_percent_median": 30.0,
        "dvs_ed_percent_max": 70.0,
        "simulated_s_per_wall_s": 22.0,
    }
    assert game == exact | {key: pytest.approx(value) for key, value in near.items()}
    assert reference["reference"]["is_this_cell"] is True
    assert (reference["position_error_m_max"], reference["poses_equal_lockstep"]) == (0.0, None)


def test_without_a_run_at_1x_or_wall_time_the_numbers_are_unknown() -> None:
    score = score_game(replace(GAME, row={**GAME.row, "wall_s": 0.0}), None, None)
    (cell,) = summary_of(CONFIG, [score], None)["cells"]
    assert (cell["paired_images"], cell["simulated_s_per_wall_s"], cell["reference"]) == (0, None, None)
    errors = ("position_error_m", "attitude_error_deg", "dvs_ed_percent")
    assert {cell[f"{error}_{kind}"] for error in errors for kind in ("median", "max")} == {None}


def test_games_are_scored_by_command_and_clock_speed_against_their_own_run_at_1x() -> None:
    rows = [row_of("lockstep"), row_of("game", clock_speed=100.0), row_of("game", clock_speed=9.0)]
    rows += [row_of("game", "adsc", 5.0), row_of("reference"), row_of("reference", "adsc"), row_of("game")]
    rows.append(row_of("game", clock_speed=7.0, error="crashed"))
    still = {
        "sample_index": np.arange(2),
        "time_s": np.array([0.0, 0.33]),
        "position_m": np.zeros((2, 3)),
        "orientation_wxyz": yaw(0, 0),
        "image": np.full((2, *PIXELS), 100, np.uint8),
    }
    scores = list(score_games(rows, lambda _: still, "clean", 0))
    assert [(score.row["case"], score.reference and score.reference["case"]) for score in scores] == [
        ("reference-adsc-k1", "reference-adsc-k1"),
        ("adsc-k5", "reference-adsc-k1"),
        ("reference-tcsc-k1", "reference-tcsc-k1"),
        ("tcsc-k1", "reference-tcsc-k1"),
        ("tcsc-k9", "reference-tcsc-k1"),
        ("tcsc-k100", "reference-tcsc-k1"),
    ]
    assert {(score.equal_poses, score.equal_counts) for score in scores} == {(True, True)}


def test_the_first_image_makes_no_events() -> None:
    images = np.stack([np.full((4, 4), level, np.uint8) for level in (10, 200, 200, 10)])
    on, off = count_events(images, np.array([0.0, 0.33, 0.66, 1.0]), PRESETS["clean"], 0)
    assert [bool(events.any()) for events in on] == [False, True, False, False]
    assert [bool(events.any()) for events in off] == [False, False, False, True]
    counted = {"dvs_on": on, "dvs_off": off}  # in flight: these stand
    assert [id(each) for each in counts_of(counted, "clean", 0)] == [id(on), id(off)]


@pytest.mark.parametrize(
    "uneven", [DvsParameters(shot_noise_rate_hz=5.0), DvsParameters(threshold_sigma=0.1)]
)
def test_noise_and_thresholds_are_of_the_sensors_seed(uneven: DvsParameters) -> None:
    brighter = np.stack([np.full((20, 20), level, np.uint8) for level in (90, 130, 170)])
    once, again, other = (
        np.array(count_events(brighter, np.array([0.0, 0.3, 0.6]), uneven, seed)) for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(once, again)
    assert (once != other).any()


def test_a_line_of_the_table() -> None:
    game, reference = summary_of(CONFIG, [score_game(f, REFERENCE, f) for f in (GAME, REFERENCE)], None)[
        "cells"
    ]
    game["position_error_m_median"], game["dvs_counts_equal_lockstep"] = 0.0004, False
    shown = table(
        {"cells": [game, reference, game | {"attitude_error_deg_max": None, "poses_equal_lockstep": None}]}
    )
    lines = shown.rows
    assert dict(zip(shown.header, lines[0], strict=True)) == {
        "command": "TCSC",
        "ClockSpeed": "50x",
        "images": "3",
        "position error, m: median, max": "4e-04, 1.500",
        "attitude error, deg: max": "30.00",
        "DVS-ED, %: median, max": "30.00, 70.00",
        "guard retries": "4",
        "poses, counts v. lockstep": "equal, differ",
        "distance, m": "12.3 (hit wall_east)",
        "simulated s a wall s": "22.00",
        "source": "measured",
    }
    assert lines[1][1:7] == ("1x (reference)", "4", "0, 0", "0", "0, 0", "2")
    assert (lines[1][8], lines[1][10]) == ("12.3", "modelled")
    assert (lines[2][4], lines[2][7]) == ("-", "-, differ")


def test_the_headline_is_of_each_commands_fastest_game_that_can_be_compared() -> None:
    def cell(
        command: str, clock_speed: float, error_m: float | None, percent: float | None, **keys: Any
    ) -> Any:
        errors = {"position_error_m_max": error_m, "dvs_ed_percent_max": percent}
        return {"command": command, "clock_speed": clock_speed, "timing": "virtual", **errors} | keys

    cells = [
        *(cell("tcsc", 1.0, 0.0, 0.0), cell("tcsc", 20.0, 0.0, 0.0), cell("tcsc", 5.0, 0.125, 7.5)),
        *(cell("adsc", 50.0, 0.25, 12.5), cell("adsc", 100.0, None, None), cell("adsc", 9.0, 0.75, 1.5)),
        cell("tcsc", 90.0, 3.0, 50.0, timing="lockstep"),
    ]
    told: Any = SimpleNamespace(summary={"cells": cells}, rows=[None] * 8)
    assert Dp2Report.headline(told) == (
        "ADSC at 50x takes its images up to 0.250 m from those of 1x, with a DVS-ED of up to 12.50 %; "
        "TCSC at 20x takes the images of 1x, each at the same place with as many events"
    )
    told.summary = {"cells": [cell("adsc", 1.0, 0.0, 0.0), cell("adsc", 5.0, None, None), cells[-1]]}
    assert Dp2Report.headline(told) == "8 games, none of them accelerated and comparable with 1x"
    for error_m, percent, said in ((0.0, 2.5, "0 m from"), (0.5, 0.0, "of up to 0 %")):
        told.summary = {"cells": [cell("adsc", 5.0, error_m, percent)]}
        assert said in Dp2Report.headline(told)


HIT = {"collision": {"object": "post"}, "distance_m": 3.25}
NO_DRAWING = "The modelled wall times leave out drawing the images"
SHARE = "Modelled: 10.0% of the images of the games were perturbed on their way"


@pytest.mark.parametrize(
    ("changes", "options", "begin"),
    [
        ([], {}, []),
        ([HIT], {}, ["tcsc-k5 hit post after 3.2 m and stood still from there"]),
        ([{"error": "crashed"}], {}, ["Warning: tcsc-k5 failed and are left out"]),
        ([{"lost_wall_s": 0.5}, {"lost_wall_s": 0.25}], {}, [
            "Warning: the machine could not keep up and lost 0.750 s of wall time."]),
        ([{"disturbed": True}, {}], {}, ["Warning: tcsc-k5 lost wall time, or the server stalled"]),
        ([{}, {"disturbed": True}, {"disturbed": True}], {}, ["Warning: tcsc-k6, tcsc-k7 lost wall time"]),
        ([{}], {"share": 0.1}, [f"{SHARE}; those of the runs at 1x"]),
        ([{}], {"share": 0.1, "half_excess": 9.0}, [f"{SHARE}, fewer where the ClockSpeed is low; those"]),
        ([{}], {"channels": ["state"]}, [NO_DRAWING]),
        ([{"timing": "wall"}, {}], {"channels": []}, [NO_DRAWING]),
        ([{"timing": "wall"}, {"timing": "lockstep"}], {"channels": []}, []),
    ],
)  # fmt: skip
def test_the_page_warns_of_what_a_reader_has_to_know(
    changes: list[dict[str, Any]], options: dict[str, Any], begin: list[str]
) -> None:
    """Game by game: the first flew at 5x, and each at 1x more than the one before."""
    rows = [row_of("game", clock_speed=5.0 + n, **change) for n, change in enumerate(changes)]
    share, channels = options.get("share", 0.0), options.get("channels", ["state", "image"])
    perturbation = {"half_excess": options.get("half_excess"), "share": share}
    told: Any = SimpleNamespace(
        rows=rows,
        summary={"perturbed_share": share, "guard_study": None},
        config={"perturbation": perturbation, "latency": {"reply_us": dict.fromkeys(channels, 1.0)}},
        overview=lambda: None,
    )
    said = [block.text for block in Dp2Report.blocks(told, ()) if isinstance(block, Paragraph)][1:-1]
    assert [text[: len(start)] for text, start in zip(said, begin, strict=True)] == begin


# --- the written report -------------------------------------------------------------------------------------


@pytest.fixture
def run(tmp_path: Path) -> RunDirectory:
    """A game without latency, a run at 1x, a measured one that differs in its second image, and a failed one."""
    mapping, source = read_mapping("dp2")
    config = resolve(Dp2Config, mapping, source, {"seed": 3}, ["perturbation.share=0.1"])
    run = RunDirectory.create(tmp_path / "run", config, {"host": "synthetic"})
    rows = [
        row_of("lockstep", timing="lockstep"),
        row_of("reference"),
        row_of("game", "adsc", 5.0, error="crashed"),
    ]
    rows.append(
        row_of("game", clock_speed=50.0, timing="wall", collision={"object": "post"}, lost_wall_s=0.125)
    )
    for row in rows:
        images = np.full((3, *PIXELS), 100, np.uint8)
        images[1:, 0, 0] = 200
        position_m = np.zeros((3, 3))
        if row["role"] == "game":
            images[1, 0, :3], position_m[1] = 200, (0.0, 0.3, 0.4)
        arrays = {
            "sample_index": np.arange(3),
            "time_s": np.array([0.0, 0.33, 0.66]),
            "position_m": position_m,
        }
        arrays |= {"orientation_wxyz": yaw(0, 0, 0), "image": images}
        if row["role"] == "lockstep":
            arrays["colour"] = np.repeat(images[..., None], 3, axis=-1)
        run.append_row(row | run.save_arrays(row["case"], arrays))
    return run


def test_the_written_report(run: RunDirectory, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = record_figures(monkeypatch)
    summary = Dp2Report(run, "dp2").write()
    assert run.read_json("summary.json") == summary
    assert [(cell["command"], cell["clock_speed"]) for cell in summary["cells"]] == [
        ("tcsc", 1.0),
        ("tcsc", 50.0),
    ]
    axes: Any = drawn["figure7_images"].axes[0]
    shown = sorted(tuple(point) for group in axes.collections for point in group.get_offsets().tolist())
    # In the second image two more of ten pixels turn on than at 1x, in the third those two turn off.
    errors = summary["cells"][1]
    assert shown[-2:] == [(20.0, 0.0), (20.0, 0.5)]
    assert (errors["position_error_m_max"], errors["dvs_ed_percent_max"]) == (0.5, pytest.approx(20.0))
    by_image = run.read_json("scores.json")
    assert [(each["clock_speed"], each["position_error_m"]) for each in by_image] == [
        (1.0, [0, 0]),
        (50.0, [0.5, 0]),
    ]
    assert by_image[1]["dvs_ed_percent"] == pytest.approx([20.0, 20.0])
    source = "measured (wall clock): 1 game · modelled (virtual clock): 1 game · native profile · seed 3"
    assert sorted(headline(drawn["figure7_images"])[1].split(" · ")) == sorted(source.split(" · "))
    text = (run.path / "report.md").read_text()
    assert text.startswith("# DP2, native profile, seed 3\n")
    assert f"Source: {headline(drawn['figure7_images'])[1]}." in text
    assert "Figure 7. " in text
    assert "linear up to 0.1 % and 1 mm" in text
    for said in (
        "tcsc-k50 hit post after 12.3 m and stood still from there",
        "Warning: adsc-k5 failed and are left out",
        "Warning: the machine could not keep up and lost 0.125 s of wall time.",
        "Modelled: 10.0% of the images of the games were perturbed",
        "sent 20 times",
        "| " + " | ".join(table(summary).rows[1]) + " |",
        "False alarms: 0 of 3 clean images.",
    ):
        assert said in text, said


def test_a_run_without_games_is_the_users_mistake(run: RunDirectory) -> None:
    (run.path / "rows.jsonl").write_text("")
    with pytest.raises(UserError, match=r"rows\.jsonl: holds no finished game of dp2"):
        Dp2Report(run, "dp2").write()


def test_the_guard_study_is_the_sum_of_its_streams() -> None:
    images = np.random.default_rng(0).integers(0, 256, (40, 6, 6, 3), np.uint8)
    settings = GuardSettings(max_retries=2)
    result = study_guard(images, settings, seed=5)
    streams = [guard_study(list(images), 0.05, 5 + i, settings) for i in range(20)]
    assert (result["modelled"], result["images"], result["share"], result["streams"]) == (True, 40, 0.05, 20)
    for kind, modes in result["by_kind"].items():
        for mode, counted in modes.items():
            sent, passed = (sum(s[mode]["by_kind"][kind][key] for s in streams) for key in ("sent", "passed"))
            assert counted == {
                "sent": sent,
                "passed": passed,
                "share_passed": passed / sent if sent else None,
            }
    for mode, share in result["perturbed_share_handed_on"].items():
        assert share == pytest.approx(sum(s[mode]["perturbed_share_handed_on"] for s in streams) / 20)
    assert result["perturbed_share_handed_on"]["on"] < result["perturbed_share_handed_on"]["off"]
    assert result["clean_false_alarms"] == streams[0]["clean"]["false_alarms"]
    assert result["clean_retries"] == streams[0]["clean"]["retries"]


def test_the_guards_table_and_sentence() -> None:
    def kind(off: tuple[int, int], on: tuple[int, int]) -> dict[str, Any]:
        return {
            mode: {"sent": sent, "passed": passed, "share_passed": passed / sent if sent else None}
            for mode, (sent, passed) in (("off", off), ("on", on))
        }

    guard = {
        "by_kind": {"salt_and_pepper": kind((10, 9), (16, 4)), "empty": kind((0, 0), (4, 0))},
        "perturbed_share_handed_on": {"off": 0.049, "on": 0.0123},
        "clean_false_alarms": 3,
        "images": 200,
        "share": 0.05,
    }
    table = guard_table(guard)
    assert table.header[1:] == ["perturbed images sent", "pass without guard", "pass the guard"]
    assert table.rows == [
        ("salt and pepper", "16", "90.0%", "25.0%"),
        ("empty", "4", "-", "0.0%"),
        ("all", "20", "90.0%", "20.0%"),
    ]
    assert guard_sentence(guard) == (
        "False alarms: 3 of 200 clean images. With 5% of the images perturbed, 4.9% of those handed on are "
        "perturbed without the guard and 1.2% with it."
    )
