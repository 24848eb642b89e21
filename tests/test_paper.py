"""The paper's report: which run decides a claim under which profile, read from the files that the parts leave."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.test_claims import only, trajectories
from uavaccel.config import validate
from uavaccel.errors import UserError
from uavaccel.records import RunDirectory
from uavaccel.resources import experiment
from uavaccel.suites.dp1.config import Dp1Config
from uavaccel.suites.dp2.config import Dp2Config
from uavaccel.suites.paper.config import PaperConfig
from uavaccel.suites.paper.evidence import Images, NoEvidence, Trajectories
from uavaccel.suites.paper.suite import Paper
from uavaccel.suites.report import Report
from uavaccel.yaml_io import load_yaml


def config(*parts: str, **keys: Any) -> PaperConfig:
    given = {name: {"experiment": "dp1" if name.startswith("dp1") else "dp2"} for name in parts}
    return validate(PaperConfig, {"suite": "paper", "parts": given, **keys}, "test")


def part(run: RunDirectory, name: str, summary: dict[str, Any], scores: Any = None) -> RunDirectory:
    """A part's folder as its report leaves it."""
    kind = Dp1Config if name.startswith("dp1") else Dp2Config
    shipped = validate(kind, load_yaml(experiment(f"{name[:3]}.yaml")), "test")
    made = RunDirectory.create(run.path / "parts" / name, shipped, {})
    made.write_json("summary.json", summary)
    if scores is not None:
        made.write_json("scores.json", scores)
    return made


def flown_dp1(run: RunDirectory, name: str, change: Any = None) -> None:
    dp1 = trajectories(change) if change else trajectories()
    part(run, name, {"seed": 0, "cells": list(dp1.cells)}, list(dp1.games))


def flown_dp2(run: RunDirectory, name: str, error_m: float, percent: float) -> None:
    """Of TCSC those numbers at 5x and worse ones above; of ADSC hopeless ones, which decide nothing."""
    scores = [
        {
            "command": command,
            "clock_speed": k,
            "position_error_m": [worse * error_m] * 120,
            "dvs_ed_percent": [worse * percent * k / 5] * 120,
        }
        for command, worse in (("tcsc", 1), ("adsc", 50))
        for k in (5.0, 10.0, 50.0, 100.0)
    ]
    part(run, name, {"guard_study": None}, scores)


@pytest.fixture
def judged(tmp_path: Path) -> Report:
    """DP1 in which native's commands are not delayed more and more; DP2 under airsim alone."""
    names = ("dp1-airsim", "dp1-native", "dp2-airsim")
    run = RunDirectory.create(tmp_path / "run", config(*names), {})
    for name in names:
        run.append_row({"suite": "paper", "case": name, "cells": 1})
    flown_dp1(run, "dp1-airsim")
    flown_dp1(run, "dp1-native", only("adsc", 50.0, command_gap_median_s=0.0))
    flown_dp2(run, "dp2-airsim", 0.03, 2.5)
    report = Paper().report(run)
    report.write()
    return report


def test_each_profile_is_judged_by_its_own_runs(judged: Report) -> None:
    summary = judged.summary
    assert summary == judged.run.read_json("summary.json")
    claims = {row["claim"]: row for row in summary["claims"]}
    delay = claims["command_delay_grows"]
    assert delay["airsim"] == {"value": "2 < 10 < 20 < 100 < 200 ms", "verdict": "holds"}
    assert delay["native"] == {"value": "2 < 10 < 20 < 0 < 200 ms", "verdict": "fails"}
    images = claims["images_at_5x"]
    assert images["airsim"]["verdict"] == "holds"
    assert images["native"] == {"value": "", "verdict": "not flown"}
    training = claims["adsc_collapses_at_5x"]
    assert training["airsim"] == training["native"] == {"value": "", "verdict": "pending"}
    assert claims["speedup_62x"]["airsim"]["verdict"] == "holds"


def test_the_page_has_a_line_for_each_claim_and_counts_the_verdicts(judged: Report) -> None:
    summary = judged.summary
    page = (judged.run.path / "report.md").read_text(encoding="utf-8").replace("\\_", "_")
    lines = [
        [cell.strip() for cell in line.strip("| \n").split("|")] for line in page.splitlines() if "|" in line
    ]
    by_claim = {line[0]: line for line in lines}
    for row in summary["claims"]:
        told = by_claim[row["says"]]
        assert told[1:4] == [row["place"], row["paper"], row["basis"]]
        assert (told[4], told[6]) == (row["airsim"]["verdict"], row["native"]["verdict"])
    counts = {
        profile: [row[profile]["verdict"] for row in summary["claims"]].count("holds")
        for profile in ("airsim", "native")
    }
    assert counts["airsim"] > counts["native"] > 5
    headline = judged.headline()
    assert f"under airsim {counts['airsim']} holds" in headline
    assert f"{counts['native']} holds" in headline.split("under native")[1]
    assert "significant at n = 100" in page


def test_trajectories_are_read_as_they_were_written(judged: Report) -> None:
    dp1 = Trajectories.of(RunDirectory(judged.run.path / "parts/dp1-airsim"))
    assert dp1.clocks == [5.0, 10.0, 50.0, 100.0]
    assert dp1.rounds == [1, 24]
    assert len(dp1.stlc("adsc", 5.0)) == 32
    assert [len(stlc) for stlc in dp1.stlc_by_cell("adsc", 5.0, rounds=24)] == [8, 8]
    assert dp1.median("adsc", 5.0).value == np.median(dp1.stlc("adsc", 5.0))
    assert dp1.stlc("adsc", 5.0, rounds=24).max() < dp1.stlc("adsc", 5.0, rounds=1).min()
    assert [each.value for each in dp1.speedups("tcsc", 100.0)] == pytest.approx([0.5 / 0.012, 1.0 / 0.017])
    assert dp1.longest("tcsc", 100.0, 0.5).value == pytest.approx(0.5 / 0.012)
    with pytest.raises(NoEvidence, match="tcsc at 7x"):
        dp1.stlc("tcsc", 7.0)


def test_speed_ups_are_those_of_the_longest_path() -> None:
    """On the shorter one they are out of all proportion."""

    def faster_on_one_round(cell: dict[str, Any]) -> None:
        if cell["rounds"] == 1:
            cell.update(effective_speedup=999.0, effective_speedup_interval=[998.0, 1000.0])

    dp1 = trajectories(faster_on_one_round)
    beyond_s = {"tcsc": 0.007, "adsc": 0.020}
    for command, lost_s in beyond_s.items():
        expected = [t_move_s / (t_move_s / 50 + lost_s) for t_move_s in (0.5, 1.0)]
        assert [each.value for each in dp1.speedups(command, 50.0)] == pytest.approx(expected)
        longest = dp1.longest(command, 50.0, 1.0)
        assert longest == pytest.approx((expected[1], 0.995 * expected[1], 1.005 * expected[1]))


def test_images_are_those_of_tcsc(judged: Report) -> None:
    clouds = Images.of(RunDirectory(judged.run.path / "parts/dp2-airsim")).clouds
    assert {k: cloud.position_error_m.max() for k, cloud in clouds.items()} == dict.fromkeys(
        (5, 10, 50, 100), 0.03
    )


def test_policies_come_from_a_run_of_rl_alone(judged: Report) -> None:
    with pytest.raises(UserError, match="is a run of paper, not of rl"):
        Paper().check(config("dp1-airsim", with_run=str(judged.run.path)))
