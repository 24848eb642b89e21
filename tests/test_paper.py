"""The paper's report: which run decides a claim under which profile, and what its page has."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.made_runs import line_row
from tests.running import configured
from tests.test_claims import images, only, trained, trajectories
from uavaccel.config import validate
from uavaccel.envs.stopwatch import PHASES
from uavaccel.errors import UserError
from uavaccel.files import to_json
from uavaccel.records import RunDirectory
from uavaccel.suites import claims
from uavaccel.suites.dp1 import Dp1
from uavaccel.suites.dp2 import Dp2
from uavaccel.suites.paper import Paper, PaperConfig
from uavaccel.suites.report import Report
from uavaccel.suites.rl import flights_of

pytestmark = pytest.mark.usefixtures("whole_messages")

AIRSIM = {"profile": "airsim", "timing": "virtual", "variant": ""}
NATIVE = {**AIRSIM, "profile": "native"}
OTHERS = [{**AIRSIM, "variant": "told"}, {**AIRSIM, "timing": "lockstep"}]


def config(*parts: str, **keys: Any) -> PaperConfig:
    given = {name: {"experiment": name[:3]} for name in parts}
    return validate(PaperConfig, {"suite": "paper", "parts": given, **keys}, "test")


FLOWN = line_row("game", "adsc", 5.0, 0, 0.0)
DP2 = {"suite": "dp2", "case": "adsc-k5", "t_sample_s": 0.5, "planned_commands": 4, "samples": 8, "distance_m": 4.0}
DP2 |= {"collision": None, "guard_retries": 0}
ROWS = {"dp1": FLOWN, "dp2": FLOWN | DP2}  # a row of each kind of part
TRAINING = {"games": 5000, "successes": 0, "commands": 100, "sim_time_s": 100.0, "weights_sha256": "0" * 64}
TRAINING |= {"phase_s": dict.fromkeys(PHASES, 0.0)}


def rl_run(path: Path, *trainings: tuple[dict[str, str], dict[str, Any]]) -> str:
    """A run of the suite rl: the paper's Table I, changed, for each kind of training.

    The games that were won ended far from any obstacle, and so did those in the exact simulator. At 1x TCSC's policies
    flew with both commands.
    """
    run = RunDirectory.create(path, configured("rl_smoke"), {})
    for number, (kind, changes) in enumerate(trainings):
        made = trained(**changes)
        ended_m = made.distance_m.iloc[0]
        for place, ((command, clock_speed, _), flights) in enumerate(made.groupby(["command", "clock_speed", "seed"])):
            success = dict(zip(flights["with"], flights.success, strict=True))
            row: dict[str, Any] = {"suite": "rl", "seed": 0, **kind, "command": command, "clock_speed": clock_speed}
            cell = flights.iloc[0]
            phase_s = cell[list(PHASES)].to_dict()
            learned = TRAINING | {"games": int(cell.trained_games), "commands": int(cell.commands), "phase_s": phase_s}
            how = {"clock_speed": 1.0, "timing": "virtual", "simulator": "kernels"}
            for name, of in {"training": {"training": learned}, "exact": {}}.items():
                flown = [how | {"command": each, **vars(won)} for each, won in success.items() if of or each == command]
                arrays: dict[str, Any] = {}
                for each, won in success.items():
                    outcome = (np.arange(won.games) < won.successes) & (name == "training")
                    kept = {"is_success": outcome, "lane": np.arange(won.games)}
                    kept["distance_m"] = np.where(outcome, 5.0, np.resize(ended_m, won.games))
                    arrays |= {f"{each if of else name}_{key}": values for key, values in kept.items()}
                case = f"{number}-{place}-{name}"
                saved = run.save_arrays(case, arrays)
                run.append_row(row | {"case": case, "evaluations": flown} | of | saved)
    return str(path)


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Report]:
    """DP1 in which native's commands are not delayed more and more; DP2 under airsim alone, and trainings.

    Native's policies keep their success with ADSC at 5x, end far from obstacles, and are trained 3x as fast.
    """
    folder, delayed = tmp_path_factory.mktemp("paper"), trajectories()
    prompt = trajectories(only("adsc", 50.0, command_gap_median_s=0.0))
    made = {"dp1-airsim": delayed, "dp1-native": prompt, "dp2-airsim": images()}
    native = {"adsc5": 0.23, "with_adsc": 0.1, "off_rows_m": 5.0, "speed5": 3.0}
    hopeless: dict[str, Any] = {"tcsc10": 0.0, "off_rows_m": 5.0}
    kinds = [(AIRSIM, {}), (NATIVE, native), *((kind, hopeless) for kind in OTHERS)]
    run = RunDirectory.create(folder / "run", config(*made, with_run=rl_run(folder / "rl", *kinds)), {})
    for name in made:
        run.append_row({"suite": "paper", "case": name, "cells": 1})
        part = RunDirectory.create(run.path / "parts" / name, configured(name[:3]), {})
        part.append_row(ROWS[name[:3]])
        part.write_bytes("figures/figure5_two_words.png", name.encode())
    with pytest.MonkeyPatch.context() as patch:
        for suite in (Dp1, Dp2):
            patch.setattr(suite, "score", lambda _, report: made[report.run.path.name].scores)
            patch.setattr(suite, "summary", lambda _, report: made[report.run.path.name].summary)
        report = Paper().report(run)
        report.write()
        yield report


def test_each_profile_is_judged_by_its_own_runs(report: Report) -> None:
    claims = {row["claim"]: row for row in report.run.read_json("summary.json")["claims"]}
    said = {name: (row["airsim"]["verdict"], row["native"]["verdict"]) for name, row in claims.items()}
    delay = claims["command_delay_grows"]
    assert delay["airsim"] == {"value": "2 < 10 < 20 < 100 < 200 ms", "verdict": "holds"}
    assert delay["native"] == {"value": "2 < 10 < 20 < 0 < 200 ms", "verdict": "fails"}
    assert (said["images_at_5x"], claims["images_at_5x"]["native"]["value"]) == (("holds", "not flown"), "")
    worse = ["adsc_collapses_at_5x", "policy_flies_with_both", "lines_peak_at_obstacles", "training_speedup_5x"]
    assert {name for name, each in said.items() if each == ("holds", "fails")} == {
        *("command_delay_grows", "adsc_fails_accelerated", "week_to_two_days", *worse)
    }
    assert set(said.values()) == {("holds", "holds"), ("holds", "fails"), ("holds", "not flown")}
    assert claims["training_speedup_10x"]["native"] == {"value": "6.4x", "verdict": "holds"}


def test_the_page_has_a_line_for_each_claim(report: Report) -> None:
    page = re.sub(r"\\(.)", r"\1", (report.run.path / "report.md").read_text(encoding="utf-8"))
    lines = [[cell.strip() for cell in line.strip("| \n").split(" | ")] for line in page.splitlines() if "|" in line]
    by_claim = {line[0]: line for line in lines}
    for row in report.summary["claims"]:
        judged = [row[profile][key] for profile in ("airsim", "native") for key in ("verdict", "value")]
        told = by_claim[row["says"]]
        assert [each for each in told[1:8] if each] == [row["place"], row["paper"], row["basis"], *filter(None, judged)]
    overview = report.overview()
    assert overview is not None
    assert tuple(overview.rows[14][:3]) == ("images_at_5x", "IV-C", "predicted")
    assert [row[4] for row in overview.rows if row[0] == "images_at_5x"] == ["not flown"]
    assert report.headline().startswith(
        "Of 36 claims of the paper under airsim 36 holds; under native 7 fails, 24 holds, 5 not flown"
    )
    assert "significant at n = 100" in page
    assert "dp1-native: Figure 5, two words." in page
    assert (report.run.path / "figures/dp2-airsim-figure5_two_words.png").read_bytes() == b"dp2-airsim"


def test_airsims_hours_are_told_by_phase(report: Report) -> None:
    """ADSC at 1x takes 1.0435 s a command, which are the paper's 182 hours; TCSC at 5x a fourth of its 1 s."""
    at_5x = next(row for row in report.summary["phases"] if row["clock_speed"] == 5.0)
    assert at_5x["simulation_h"] == pytest.approx(182 * 0.25 / 1.0435)
    assert at_5x["image_processing_h"] == pytest.approx(182 * 0.0435 / 1.0435)
    page = (report.run.path / "report.md").read_text().splitlines()
    assert next(line for line in page if line.startswith("| 5x | 43.6 |")).split(" | ")[3] == "7.6"


def test_parts_are_scored_once_for_the_same_games(
    report: Report, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def scored_again(*_: Any) -> Any:
        raise AssertionError("scored again")

    monkeypatch.setattr(Dp1, "score", scored_again)
    monkeypatch.setattr(Dp2, "score", scored_again)
    more = to_json(line_row("game", "adsc", 5.0, 1, 0.0))
    for name, changed in (("rows.jsonl", f"{more}\n"), ("config.yaml", "# read otherwise\n")):
        run = RunDirectory(shutil.copytree(report.run.path, tmp_path / name))
        assert Paper().report(run).summary == report.summary
        with (run.path / "parts/dp1-native" / name).open("a") as file:
            file.write(changed)
        with pytest.raises(AssertionError, match="scored again"):
            assert Paper().report(run).summary


def test_rows_alone_decide_all_but_where_games_ended(report: Report) -> None:
    """Without their arrays nobody knows who won which lane: intervals are those of unpaired games."""
    run = RunDirectory(Path(report.config.with_run))
    whole = claims.trainings(flights_of(run.rows(), run.load_arrays), "airsim")
    alone = claims.trainings(flights_of(run.rows(), lambda row: {}), "airsim")
    assert claims.won(whole, "tcsc", 5.0).won is not None
    assert claims.won(alone, "tcsc", 5.0).won is None
    with pytest.raises(claims.NoEvidence):
        claims.lines_peak_at_obstacles(alone)
    paired, plain = (claims.policy_flies_with_both(rl).value.rpartition("times ")[2] for rl in (whole, alone))
    low, high, least, most = (float(end) for text in (paired, plain) for end in text.strip("[]").split(", "))
    assert least < low <= high < most


def test_without_trainings_their_claims_are_pending(report: Report) -> None:
    run = RunDirectory.create(report.run.path.parent / "without", config("dp1-airsim"), {})
    run.append_row({"suite": "paper", "case": "dp1-airsim", "cells": 1})
    shutil.copytree(report.run.path / "parts", run.path / "parts")
    (written := Paper().report(run)).write()
    summary, texts = written.summary, [(each.run.path / "report.md").read_text() for each in (report, written)]
    lacking = {row["claim"]: row["airsim"]["verdict"] for row in summary["claims"]}
    assert (lacking["adsc_collapses_at_5x"], lacking["images_at_5x"]) == ("pending", "not flown")
    assert summary["phases"] == []
    assert ["Hours of TCSC's training" in text for text in texts] == [True, False]


def test_trainings_come_from_a_run_of_rl_alone(report: Report) -> None:
    with pytest.raises(UserError, match="is a run of paper, not of rl"):
        Paper().check(config("dp1-native", with_run=str(report.run.path)))


@pytest.mark.parametrize(
    ("name", "experiment"), [("dp1-airsim", "dp1"), ("dp2-native", "dp1"), ("dp1-native", "rl_smoke")]
)
def test_a_part_of_another_suite_or_profile_is_refused(name: str, experiment: str) -> None:
    part = validate(PaperConfig, {"suite": "paper", "parts": {name: {"experiment": experiment}}}, "test")
    with pytest.raises(
        UserError, match=rf"parts.{name}: {experiment} and its keys fly {'rl' * (experiment[0] == 'r')}"
    ):
        Paper().check(part)


@pytest.mark.parametrize(
    ("parts", "draws"),
    [(["dp1-airsim", "dp1-native"], False), (["dp1-airsim", "dp2-native"], True), (["dp2-airsim"], True)],
)
def test_opengl_is_needed_where_a_part_draws(parts: list[str], draws: bool) -> None:
    assert Paper().renders(config(*parts)) is draws


def test_a_part_is_as_long_as_all_of_its_games() -> None:
    """Rounds of 1 and of 2 squares take 2 and 4 s: two references, the one in lockstep and three games of each.

    The two of Figure 2 take 1.5 s.
    """
    keys: dict[str, Any] = {"command": ["tcsc"], "clock_speed": [5], "t_move_s": [0.5], "rounds": [1, 2]}
    keys |= {"games": 3, "reference_games": 2}
    [case] = Paper().cases(validate(PaperConfig, {"suite": "paper", "parts": {
        "dp1-native": {"experiment": "dp1", "keys": keys},
    }}, "test"))  # fmt: skip
    assert case.simulated_s() == pytest.approx((2 + 1 + 3) * (2 + 4) + 2 * 1.5)
