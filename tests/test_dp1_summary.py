"""DP1's summary and tables: every number against a few independent lines, on games whose errors are known by hand."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from tests.dp1_games import line_arrays, line_row, quantile, synthetic_games
from uavaccel.suites.old_dp1 import scores
from uavaccel.suites.old_dp1.report import overview, table, verdict
from uavaccel.suites.old_report import LoadArrays

Row = Any


def summarise(rows: list[Row], load_arrays: LoadArrays) -> Row:
    return scores.summarise(rows, scores.score_cells(scores.cells_of(rows), load_arrays))


REFERENCES_M, GAMES_M = [0.0, 0.2, 0.5], [0.1, 0.9, 0.3, 0.35]
REFERENCE_WALL_S, WALL_S = [4.1, 4.3, 4.9], [0.12, 0.09, 0.1, 0.2]
GAPS_S = [[0.01, 0.02, 0.03], [0.04, 0.05, 0.06], [0.07, 0.08, 0.3], [0.2, 0.21, 0.22]]
SEED = 7


def rows() -> list[Row]:
    """Two cells, their references, what is to be left out, and another path whose references are far off."""
    made = [
        line_row("reference", "adsc", 1.0, i, offset_m, wall_s=wall_s, gaps_s=[0.0, 0.01 * i, 0.0])
        for i, (offset_m, wall_s) in enumerate(zip(REFERENCES_M, REFERENCE_WALL_S, strict=True))
    ]
    made += [
        line_row("lockstep", "adsc", 1.0, 0, 0.05, timing="lockstep"),
        line_row("lockstep", "tcsc", 1.0, 0, 0.6, timing="lockstep"),
        line_row("game", "tcsc", 50.0, 4, 5.0, error="the drone crashed", timing="wall"),
        line_row("figure2", "tcsc", 50.0, 0, 7.0, timing="wall"),
        line_row("reference", "adsc", 1.0, 0, 30.0, t_move_s=0.5),
        line_row("reference", "adsc", 1.0, 0, 40.0, rounds=2),
        line_row("game", "adsc", 1.0, 0, 50.0),  # a reference once more, not to be counted twice
    ]
    made += [
        line_row(
            "game", "tcsc", 50.0, i, GAMES_M[i], timing="wall", wall_s=WALL_S[i], gaps_s=GAPS_S[i],
            real_time_factor=[40.0, 48.0, 50.0, 45.0][i], lost_wall_s=[0.1, 0.0, 0.25, 0.0][i],
        )
        for i in (2, 0, 3, 1)
    ]  # fmt: skip
    return [{**row, "seed": SEED} for row in made]


def find(summary: dict[str, Any], **wanted: Any) -> dict[str, Any]:
    (cell,) = (c for c in summary["cells"] if all(c[key] == value for key, value in wanted.items()))
    return dict(cell)


def bootstrap_medians(values: np.ndarray) -> list[float]:
    drawn = values[np.random.default_rng(SEED).integers(len(values), size=(2000, len(values)))]
    medians = np.median(drawn, axis=1).tolist()
    return [quantile(medians, 0.025), quantile(medians, 0.975)]


def approximately(expected: dict[str, Any]) -> dict[str, Any]:
    return {
        key: value if isinstance(value, dict | None | str | bool) else pytest.approx(value)
        for key, value in expected.items()
    }


def test_every_number_of_a_cell() -> None:
    summary = summarise(rows(), line_arrays)
    assert (summary["suite"], summary["profile"], summary["seed"]) == ("dp1", "native", SEED)
    aside_m = np.abs(np.subtract.outer(GAMES_M, REFERENCES_M))
    stlc, rmse_m = (1 + np.exp(-aside_m)).mean(axis=1), aside_m.mean(axis=1)
    lockstep_m = np.abs(np.array(GAMES_M) - 0.6)
    duration_s = [4.0 + sum(gaps) for gaps in GAPS_S]
    rng = np.random.default_rng(SEED)
    baseline, wall_s = (
        np.array(values)[rng.integers(len(values), size=(2000, len(values)))].mean(axis=1)
        for values in (REFERENCE_WALL_S, WALL_S)
    )
    ratios = (baseline / wall_s).tolist()
    cell = find(summary, command="tcsc", t_move_s=1.0)
    assert cell == approximately(
        {
            "command": "tcsc",
            "clock_speed": 50.0,
            "t_move_s": 1.0,
            "rounds": 1,
            "games": 4,
            "failed_games": 1,
            "distinct_games": 4,
            "timing": "wall",
            "provenance": "measured",
            "seed": SEED,
            "reference": {
                "command": "adsc",
                "clock_speed": 1.0,
                "timing": "virtual",
                "provenance": "modelled",
                "games": 3,
                "is_this_cell": False,
            },
            "stlc_median": quantile(stlc.tolist(), 0.5),
            "stlc_q25": quantile(stlc.tolist(), 0.25),
            "stlc_q75": quantile(stlc.tolist(), 0.75),
            "stlc_median_interval": bootstrap_medians(stlc),
            "position_rmse_m": quantile(rmse_m.tolist(), 0.5),
            "position_rmse_interval_m": bootstrap_medians(rmse_m),
            "position_rmse_vs_lockstep_m": quantile(lockstep_m.tolist(), 0.5),
            "duration_error_s": quantile(duration_s, 0.5) - (4.0 + 4.01 + 4.02) / 3,
            "command_gap_median_s": 0.065,  # of twelve: between 0.06 and 0.07
            "command_gap_q95_s": quantile([gap for gaps in GAPS_S for gap in gaps], 0.95),
            "effective_speedup": (13.3 / 3) / (0.51 / 4),
            "effective_speedup_interval": [quantile(ratios, 0.025), quantile(ratios, 0.975)],
            "effective_speedup_provenance": "mixed",
            "real_time_factor": 183.0 / 4,
            "lost_wall_s": 0.35,
        }
    )


def test_references_are_a_cell_of_their_own_and_not_compared_with_themselves() -> None:
    cell = find(summarise(rows(), line_arrays), command="adsc", t_move_s=1.0, rounds=1)
    others_m = [(0.2 + 0.5) / 2, (0.2 + 0.3) / 2, (0.5 + 0.3) / 2]
    stlc = [1 + (np.exp(-a) + np.exp(-b)) / 2 for a, b in ((0.2, 0.5), (0.2, 0.3), (0.5, 0.3))]
    assert cell["reference"]["is_this_cell"] is True
    assert (cell["games"], cell["failed_games"], cell["provenance"]) == (3, 0, "modelled")
    assert cell["position_rmse_m"] == pytest.approx(quantile(others_m, 0.5))
    assert [cell["stlc_q25"], cell["stlc_q75"]] == pytest.approx([quantile(stlc, 0.25), quantile(stlc, 0.75)])
    assert cell["position_rmse_vs_lockstep_m"] == pytest.approx(0.15)  # the lockstep game of its own command
    assert (cell["effective_speedup"], cell["effective_speedup_interval"]) == (1.0, None)
    assert cell["effective_speedup_provenance"] == "modelled"
    assert cell["duration_error_s"] == pytest.approx(0.0)
    lone = find(summarise(rows(), line_arrays), command="adsc", t_move_s=0.5)
    assert (lone["games"], lone["stlc_median"], lone["stlc_median_interval"]) == (1, None, None)


def test_without_references_lockstep_or_games_the_numbers_are_unknown() -> None:
    (cell,) = summarise([line_row("game", "tcsc", 50.0, 0, 0.1)], line_arrays)["cells"]
    known = {
        "command",
        "clock_speed",
        "t_move_s",
        "rounds",
        "games",
        "failed_games",
        "distinct_games",
        "timing",
    }
    known |= {
        "provenance",
        "seed",
        "command_gap_median_s",
        "command_gap_q95_s",
        "real_time_factor",
        "lost_wall_s",
    }
    assert {key for key, value in cell.items() if value is not None} == known
    failed = line_row("game", "tcsc", 50.0, 0, 0.1, error="crashed")
    (cell,) = summarise([failed], line_arrays)["cells"]
    assert (cell["games"], cell["failed_games"], cell["real_time_factor"]) == (0, 1, None)
    with pytest.raises(ValueError, match="at least one row"):
        summarise([], line_arrays)


def test_cells_come_in_canonical_order_whatever_the_rows_order() -> None:
    flown = synthetic_games(games=2)
    arrays = {row["case"]: sample for row, sample in flown}
    rows = [row for row, _ in flown]
    forwards = summarise(rows, lambda row: arrays[row["case"]])
    backwards = summarise(rows[::-1], lambda row: arrays[row["case"]])
    assert json.dumps(forwards) == json.dumps(backwards)
    keys = [(c["command"], c["clock_speed"], c["t_move_s"], c["rounds"]) for c in forwards["cells"]]
    assert keys == sorted(keys)


# --- tables -------------------------------------------------------------------------------------------------

CELL: dict[str, Any] = {
    "command": "tcsc",
    "clock_speed": 2.5,
    "t_move_s": 0.1,
    "rounds": 24,
    "games": 19,
    "failed_games": 1,
    "timing": "wall",
    "provenance": "measured",
    "stlc_median": 1.9154,
    "stlc_q25": 1.8024,
    "stlc_q75": 1.9876,
    "position_rmse_m": 0.1234,
    "position_rmse_vs_lockstep_m": 0.000012,
    "duration_error_s": 0.0123,
    "effective_speedup": 2.345,
    "effective_speedup_provenance": "mixed",
    "real_time_factor": 2.499,
}
UNKNOWN = dict.fromkeys(
    ("stlc_median", "position_rmse_m", "position_rmse_vs_lockstep_m", "duration_error_s", "effective_speedup")
)


def test_a_line_of_the_table() -> None:
    exact = {"position_rmse_m": 0.0, "duration_error_s": -0.0001, "failed_games": 0}
    unknown = UNKNOWN | {"effective_speedup_provenance": None, "real_time_factor": None}
    shown = table({"cells": [CELL, CELL | exact, CELL | unknown]})
    lines = shown.rows
    assert dict(zip(shown.header, lines[0], strict=True)) == {
        "command": "TCSC",
        "clock": "2.5x",
        "T_move s": "0.1",
        "rounds": "24",
        "games": "19 (1 failed)",
        "STLC median [q25, q75]": "1.915 [1.802, 1.988]",
        "RMSE m": "0.123",
        "v. lockstep": "1.2e-05",
        "duration s": "+0.012",
        "speed-up": "2.35 (mixed)",
        "achieved": "2.50",
        "source": "measured",
    }
    assert (lines[1][4], lines[1][6], lines[1][8]) == ("19", "0", "+0.000")
    assert lines[2][5:11] == ("-",) * 6


def test_the_overview_has_the_worst_of_each_command_and_clock_speed() -> None:
    better = {"stlc_median": 1.99, "position_rmse_m": 0.5, "position_rmse_vs_lockstep_m": 0.02, "games": 5}
    better |= {"effective_speedup": 2.4, "real_time_factor": 2.1}
    cells = [
        CELL | {"rounds": 1},
        CELL | better,
        CELL | UNKNOWN,
        CELL | {"clock_speed": 50.0, "timing": "virtual"},
    ]
    cells.append(cells[-1] | UNKNOWN | {"command": "adsc", "effective_speedup_provenance": None})
    shown = overview({"cells": cells})
    first, *others = shown.rows
    assert dict(zip(shown.header, first, strict=True)) == {
        "command": "TCSC",
        "ClockSpeed": "2.5x",
        "games": "43",
        "lowest STLC median": "1.9154",
        "largest RMSE v. reference, m": "0.500",
        "largest RMSE v. lockstep, m": "0.020",
        "effective speed-up": "2.35 to 2.40 (mixed)",
        "real-time factor": "2.10 to 2.50",
        "source": "measured",
    }
    assert others[0][:4] == ("TCSC", "50x", "19", "1.9154")
    assert others[0][6] == "2.35 (mixed)"
    assert others[1] == ("ADSC", "50x", "19", "-", "-", "-", "-", "2.50", "measured")


# --- the sentence above a report --------------------------------------------------------------------------------


def flown(
    command: str,
    clock_speed: float,
    stlc: float | None,
    error_m: float,
    speedup: float,
    timing: str = "virtual",
) -> dict[str, Any]:
    return {
        "command": command, "clock_speed": clock_speed, "timing": timing, "stlc_median": stlc, "games": 4,
        "position_rmse_m": error_m, "effective_speedup": speedup, "provenance": "modelled",
    }  # fmt: skip


def test_the_verdict_is_of_each_commands_worst_cells_beyond_real_time() -> None:
    """As in real time up to the last ClockSpeed before a cell that is not; error and speed-up are at the fastest."""
    adsc = [
        *(flown("adsc", 1.0, 1.0, 5.0, 1.0), flown("adsc", 2.0, 1.9, 0.1, 2.0)),
        *(flown("adsc", 5.0, 1.81, 0.2, 4.0), flown("adsc", 5.0, 1.95, 0.2, 4.5)),
        *(flown("adsc", 10.0, 1.99, 0.9, 8.0), flown("adsc", 10.0, 1.8, 0.9, 8.0)),
        *(flown("adsc", 50.0, 1.9, 0.25, 30.0), flown("adsc", 50.0, 1.9, 0.125, 20.0)),
        flown("adsc", 100.0, 0.1, 9.0, 99.0, "lockstep"),
    ]
    tcsc = [flown("tcsc", 5.0, 1.5, 0.3, 4.0), flown("tcsc", 10.0, 1.9, 0.004, 8.0)]
    assert verdict({"cells": [*tcsc, *adsc]}) == (
        "ADSC flies as in real time up to 5x (STLC above 1.8); at 50x it is up to 0.250 m off (RMSE) and 20.00 to "
        "30.00 times as fast; TCSC no longer flies as in real time at 5x (STLC above 1.8); at 10x it is up to 4.0e-03 "
        "m off (RMSE) and 8.00 times as fast (modelled)"
    )
    nothing = [flown("adsc", 1.0, 2.0, 0.0, 1.0), flown("adsc", 5.0, None, 0.0, 1.0)]
    assert verdict({"cells": nothing}) == ("8 games, none of them accelerated and comparable with real time")
