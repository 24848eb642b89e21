"""Each claim of the paper: what decides it holds on numbers made to show it, and fails on numbers made not to."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.stats import binomtest, hypergeom

from uavaccel.suites.paper import claims
from uavaccel.suites.paper.config import PaperConfig, read_claims
from uavaccel.suites.paper.evidence import Images, NoEvidence, Policies, Trajectories
from uavaccel.suites.paper.verdicts import _judged, _paper_p, at_the_papers_n
from uavaccel.suites.parts import Part

CLOCKS = (1.0, 5.0, 10.0, 50.0, 100.0)
ROUNDS = (1, 24)
T_MOVES_S = (0.5, 1.0)
CLAIMS = read_claims(PaperConfig(suite="paper", parts={"dp1-airsim": Part(experiment="dp1")}))

Change = Callable[[dict[str, Any]], None]


def paper_cell(command: str, clock_speed: float, t_move_s: float, rounds: int) -> dict[str, Any]:
    """A cell as the paper describes it: ADSC worsens with ClockSpeed and rounds, TCSC stays above 1.8."""
    adsc = command == "adsc"
    loss = 0.06 * np.log(clock_speed) * (1 + np.log(rounds)) if adsc else 0.001 * clock_speed
    beyond_s = 0.020 if adsc else 0.007
    speedup = t_move_s / (t_move_s / clock_speed + beyond_s)
    spread = 0.002 * clock_speed * np.array([-2.0, -1.0, 0.0, 2.0]) if adsc else np.zeros(4)
    return {
        "command": command,
        "clock_speed": clock_speed,
        "t_move_s": t_move_s,
        "rounds": rounds,
        "stlc": (1.99 - loss + spread).tolist(),
        "effective_speedup": speedup,
        "effective_speedup_interval": [speedup - 1, speedup + 1],
        "command_gap_median_s": 0.002 * clock_speed,
    }


def trajectories(change: Change = lambda cell: None) -> Trajectories:
    cells = [
        paper_cell(command, k, t_move_s, rounds)
        for command in ("adsc", "tcsc")
        for k in CLOCKS
        for rounds in ROUNDS
        for t_move_s in T_MOVES_S
    ]
    for cell in cells:
        change(cell)
    return Trajectories(cells, cells, seed=0)


def only(command: str, clock_speed: float | None = None, **keys: Any) -> Change:
    """Sets keys in the cells of a command, of all its ClockSpeeds or of one."""

    def change(cell: dict[str, Any]) -> None:
        if cell["command"] == command and clock_speed in (None, cell["clock_speed"]):
            cell.update(keys)

    return change


DP1_FAILURES: dict[str, Change] = {
    "command_delay_grows": only("adsc", 50.0, command_gap_median_s=0.0),
    "replicas_differ": only("adsc", 100.0, stlc=[1.9, 1.95]),
    "reference_near_2": only("adsc", 1.0, stlc=[1.9, 1.9]),
    "variance_grows": only("adsc", 100.0, stlc=[1.2, 1.2]),
    "accuracy_falls_with_length": only("adsc", 10.0, stlc=[1.7, 1.7]),
    "tcsc_beats_adsc": only("tcsc", 5.0, stlc=[1.5, 1.5]),
    "tcsc_above_1_8": only("tcsc", 50.0, stlc=[1.79, 1.79]),
    "adsc_only_below_5x": only("adsc", 5.0, stlc=[1.85, 1.85]),
    "tcsc_closer_to_ideal": only("tcsc", 50.0, effective_speedup=1.0),
    "adsc_speedup_grows_with_duration": only("adsc", 100.0, effective_speedup=20.0),
    "callback_costs_most": only("tcsc", 100.0, effective_speedup=10.0),
    "speedup_62x": only("tcsc", 100.0, effective_speedup=49.0),
    "speedup_65x": only("tcsc", 100.0, stlc=[1.79, 1.79]),
    "speedup_50x": only("tcsc", 100.0, effective_speedup=66.0),
}


@pytest.mark.parametrize("claim", DP1_FAILURES)
def test_a_claim_of_section_iv_b(claim: str) -> None:
    decide = getattr(claims, claim)
    assert decide(trajectories()).holds
    assert not decide(trajectories(DP1_FAILURES[claim])).holds


def test_findings_say_their_numbers() -> None:
    dp1 = trajectories(only("tcsc", 100.0, stlc=[1.84, 1.88]))
    assert claims.speedup_62x(dp1).value == "58.8x [57.8, 59.8], error 7.0%"
    assert claims.command_delay_grows(dp1).value == "2 < 10 < 20 < 100 < 200 ms"
    # Wall time per command beyond the flight, as the cells were made.
    assert claims.callback_costs_most(dp1).value == "20 v 7 ms"


def images(**changes: tuple[float, float]) -> Images:
    """Cells by ClockSpeed: position error in metres and DVS-ED in percent, median as the largest."""
    values = {"k5": (0.03, 2.5), "k10": (0.04, 4.5), "k50": (0.06, 12.0), "k100": (0.08, 20.0), **changes}
    return Images(
        {
            float(name[1:]): {
                "position_error_m_median": metres,
                "position_error_m_max": metres,
                "dvs_ed_percent_median": percent,
                "dvs_ed_percent_max": percent,
            }
            for name, (metres, percent) in values.items()
        }
    )


@pytest.mark.parametrize(
    ("claim", "failing"),
    [
        ("images_at_5x", {"k5": (0.051, 2.5)}),
        ("images_at_5x", {"k5": (0.03, 3.1)}),
        ("images_at_10x", {"k10": (0.04, 5.1)}),
        ("images_at_10x", {"k10": (0.06, 4.5)}),
        ("images_beyond_10x", {"k100": (0.30, 20.0)}),
        ("images_beyond_10x", {"k50": (0.06, 4.0)}),
    ],
)
def test_a_claim_of_section_iv_c(claim: str, failing: dict[str, tuple[float, float]]) -> None:
    assert getattr(claims, claim)(images()).holds
    assert not getattr(claims, claim)(images(**failing)).holds


PAPER_TABLE = {"adsc": (23, 1, 0, 0, 0), "tcsc": (21, 30, 23, 14, 13)}
WHOLE_SPEEDUPS = {5.0: 3.6, 10.0: 5.2}
SPEEDUPS = dict(zip(CLOCKS, (1.0, 4.0, 6.4, 14.8, 15.4), strict=True))


def policies(games: int = 100, **changes: float) -> Policies:
    """The paper's Table I with ten times the games, or whatever `changes` says of a cell."""
    cells = []
    for command, successes in PAPER_TABLE.items():
        for k, count in zip(CLOCKS, successes, strict=True):
            ratio = changes.get(f"{command}{k:g}", count / 100)
            cells.append(
                {
                    "profile": "airsim",
                    "command": command,
                    "clock_speed": k,
                    "games": games,
                    "successes": round(ratio * games),
                    "training_speedup": changes.get(f"speed{k:g}", SPEEDUPS[k]),
                    "whole_training_speedup": changes.get(f"whole{k:g}", WHOLE_SPEEDUPS.get(k)),
                }
            )
    with_tcsc, with_adsc = round(0.21 * games), round(changes.get("both", 0.20) * games)
    flown = [
        {"command": command, "successes": won, "games": games}
        for command, won in (("tcsc", with_tcsc), ("adsc", with_adsc))
    ]
    alone = with_tcsc - with_adsc + 20  # and 20 lanes with ADSC alone
    p_value = float(binomtest(alone, alone + 20).pvalue)
    return Policies(cells, [{"flown_with": flown, "mcnemar_p": p_value}])


@pytest.mark.parametrize(
    ("claim", "failing"),
    [
        ("adsc_collapses_at_5x", {"adsc5": 0.23}),
        ("tcsc_preserved_at_10x", {"tcsc10": 0.10}),
        ("tcsc_loses_at_100x", {"tcsc100": 0.21}),
        ("tcsc_loses_at_50x", {"tcsc50": 0.30}),
        ("tcsc_improves_at_5x", {"tcsc5": 0.15}),
        ("commands_interchange_at_1x", {"adsc1": 0.40}),
        ("training_speedup_5x", {"speed5": 3.0}),
        ("training_speedup_10x", {"speed10": 9.0}),
        ("training_speedup_50x", {"speed50": 20.0}),
        ("training_speedup_100x", {"speed100": 12.0}),
        ("week_to_two_days", {"whole5": 2.0, "whole10": 3.0}),
        ("adsc_fails_accelerated", {"adsc50": 0.08}),
        ("policy_flies_with_both", {"both": 0.10}),
    ],
)
def test_a_claim_of_section_iv_d(claim: str, failing: dict[str, float]) -> None:
    decide = getattr(claims, claim)
    assert decide(policies(games=1000)).holds
    assert not decide(policies(games=1000, **failing)).holds
    with pytest.raises(NoEvidence):
        decide(Policies([]))


def test_the_papers_n_tells_of_the_collapse_alone() -> None:
    """Fisher's exact test by the hypergeometric distribution itself."""

    def p_value(a: int, b: int) -> float:
        chances = hypergeom(200, 100, a + b).pmf(np.arange(a + b + 1))
        return float(chances[chances <= chances[a] * (1 + 1e-9)].sum())

    said = {}
    for claim in CLAIMS:
        if claim.paper_counts is not None:
            found = _paper_p(claim)
            assert found == pytest.approx(p_value(*claim.paper_counts))
            said[claim.id] = at_the_papers_n({"paper_p": found}).split()[0]
    assert {claim for claim, word in said.items() if word == "significant"} == {"adsc_collapses_at_5x"}


def test_every_claim_has_a_decision_and_a_test_of_it() -> None:
    tested = {*DP1_FAILURES, "images_at_5x", "images_at_10x", "images_beyond_10x"}
    by_training = {claim.id for claim in CLAIMS if claim.decided_by == "rl"}
    assert {claim.id for claim in CLAIMS} == tested | by_training
    assert all(callable(getattr(claims, claim.id)) for claim in CLAIMS)
    assert len({claim.id for claim in CLAIMS}) == len(CLAIMS)


@pytest.mark.parametrize("claim", DP1_FAILURES)
def test_what_was_not_flown_decides_nothing(claim: str) -> None:
    """A run of ADSC alone at 1x has no accelerated games, and no TCSC."""
    cells = [cell for cell in trajectories().cells if (cell["command"], cell["clock_speed"]) == ("adsc", 1.0)]
    if claim == "reference_near_2":
        assert getattr(claims, claim)(Trajectories(cells, cells, seed=0)).holds
        return
    with pytest.raises(NoEvidence):
        getattr(claims, claim)(Trajectories(cells, cells, seed=0))


def test_a_summary_that_lacks_a_key_is_a_mistake_and_no_verdict() -> None:
    cells = [{key: value for key, value in cell.items() if key != "stlc"} for cell in trajectories().cells]
    claim = next(claim for claim in CLAIMS if claim.id == "reference_near_2")
    with pytest.raises(KeyError, match="stlc"):
        _judged(claim, {"dp1": Trajectories(cells, cells, seed=0)})
    assert _judged(claim, {"dp1": Trajectories([], [], seed=0)})["verdict"] == "not flown"
