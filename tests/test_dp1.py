"""DP1 end to end: the paper's grid, its subsets, and what a game flies."""

from __future__ import annotations

import os
import signal
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from tests import made_runs as made
from tests.made_runs import line_row
from tests.test_reports import ALIKE, accelerated_rows
from uavaccel.commands import COMMANDS, SynchronousCommand
from uavaccel.config import validate
from uavaccel.errors import UserError
from uavaccel.records import RunDirectory
from uavaccel.suites import dp1, runner
from uavaccel.suites.dp1 import Dp1, Dp1Config, Game
from uavaccel.suites.experiment import disturbances
from uavaccel.suites.path_suite import flight_row, fly_path
from uavaccel.suites.registry import merged, read_mapping
from uavaccel.wire.session import VirtualSession, open_session

pytestmark = pytest.mark.usefixtures("whole_messages")


def config_of(**options: Any) -> Dp1Config:
    mapping, source = read_mapping("dp1")
    return validate(Dp1Config, merged(mapping, options), source)


def cases_of(config: Dp1Config, **wanted: Any) -> list[Game]:
    """The cases with these attributes."""
    return [case for case in Dp1().cases(config) if all(getattr(case, key) == value for key, value in wanted.items())]


def fly_case(config: Dp1Config, case: Game, *earlier: Game) -> tuple[Any, Any]:
    """The row and the arrays of a case, after others in the same session."""
    with open_session(case.timing, config.profile, "blocks", config.latency) as session:
        *_, flown = [Dp1().fly(config, own, session) for own in (*earlier, case)]
    return flown.row, flown.arrays


def game(command: str, t_move_s: float, rounds: int, **keys: Any) -> tuple[Any, Any]:
    """The row and the arrays of a game at 100x unless the keys say otherwise."""
    keys = {"clock_speed": [100.0], "t_move_s": [t_move_s], "rounds": [rounds], "games": 1} | keys
    config = config_of(**keys)
    return fly_case(config, cases_of(config, role="game", command=command)[0])


# --- the grid -----------------------------------------------------------------------------------------------


def test_more_games_than_may_be_are_refused_and_none_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    config, count = config_of(), len(cases_of(config_of()))
    for most in (count, count - 1):
        monkeypatch.setattr(runner, "MOST_GAMES", most)
        with pytest.raises(UserError, match=r"^more than") if most < count else nullcontext():
            assert len(runner.cases_of(Dp1(), config)) == count


def test_the_papers_grid_has_4800_games_and_79200_seconds() -> None:
    cases = cases_of(config_of())
    grid = [case for case in cases if case.role in ("game", "reference")]
    assert len(grid) == 4_800
    assert sum(case.simulated_s() for case in grid) == pytest.approx(79_200)
    assert len({case.id for case in cases}) == len(cases)
    references = [(case.command, case.clock_speed) for case in grid if case.role == "reference"]
    assert references == [("adsc", 1.0)] * 20 * 4 * 6
    flown = [case for case in cases if case.role != "lockstep"]
    assert len({case.seed(0).spawn_key for case in flown}) == len(flown), "each has a seed of its own"
    assert cases[0].seed(0).generate_state(4).tolist() != cases[0].seed(1).generate_state(4).tolist()


def test_another_timing_brings_references_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside a cell of ADSC at 1x: they first, flights without latency, games, Figure 2's, and traces for Figure 4."""
    keys = {"clock_speed": [50.0, 1.0], "t_move_s": [0.2, 1.0], "rounds": [4], "timing": "wall"}
    config = config_of(**keys, games=1, reference_games=2)
    assert [(case.id, case.timing) for case in cases_of(config)] == [
        *((f"reference-adsc-k1-t{t}-r4-g0{game}", "virtual") for t in ("0.2", "1") for game in (0, 1)),
        *((f"lockstep-tcsc-k1-t{t}-r4-g00", "lockstep") for t in ("0.2", "1")),
        *((f"{command}-k{k}-t{t}-r4-g00", "wall")
          for command in ("adsc", "tcsc") for k in (50, 1) for t in ("0.2", "1")),
        ("figure2-adsc-k1-t1-r1-g00", "virtual"),
        ("figure2-adsc-k50-t1-r1-g01", "wall"),
    ]  # fmt: skip
    assert {case.path for case in cases_of(config, role="figure2")} == {"two_forward_one_back"}
    monkeypatch.setattr("uavaccel.calibration.calibrate.record_trace", lambda _, *asked: list(asked))
    run = RunDirectory.create(tmp_path / "run", config, {})
    Dp1().finish(config.model_copy(update={"timing": "virtual"}), run)
    traces = [run.read_json(f"traces/{command}.json") for command in ("adsc", "tcsc")]
    assert traces == [["adsc", 50.0, 1.0], ["tcsc", 50.0, 1.0]]


@pytest.mark.parametrize("case_id", ["adsc-k50-t0.2-r2-g03", "reference-adsc-k1-t0.1-r1-g01"])
def test_a_game_of_a_subset_is_that_game_of_the_full_grid(case_id: str) -> None:
    full = config_of()
    [case] = cases_of(full, id=case_id)
    keys = {"clock_speed": [case.clock_speed], "t_move_s": [case.t_move_s], "command": [case.command]}
    subset = config_of(**keys, rounds=[case.rounds])
    [same] = cases_of(subset, id=case_id)
    (row, arrays), (whole_row, whole) = (
        fly_case(subset, same, *cases_of(subset, timing="virtual")[-3:]),
        fly_case(full, case),
    )
    assert row == whole_row
    assert {name: array.tobytes() for name, array in arrays.items()} == {n: each.tobytes() for n, each in whole.items()}


# --- what a game is -------------------------------------------------------------------------------------------


def test_a_row_tells_what_was_flown() -> None:
    row, arrays = game("tcsc", 0.2, 2)
    assert (row["commands"], row["sim_time_s"], row["duration_s"], row["error"]) == (8, 1.6, 1.6, None)
    assert [row[name] for name in ("role", "t_move_s", "rounds", "game")] == ["game", 0.2, 2, 0]
    assert (row["real_time_factor"], row["lost_wall_s"], row["samples_dropped"]) == (100.0, 0.0, 0)
    assert (row["wall_s"] > 0.016, len(arrays["time_s"])) == (True, 33)
    sampled_row, sampled = game("tcsc", 0.2, 2, t_sample_s=0.05)  # which costs time and no accuracy
    assert (sampled_row["wall_s"] > row["wall_s"], np.array_equal(sampled["position_m"], arrays["position_m"])) == (
        True,
    ) * 2
    row, _ = game("adsc", 0.2, 2)
    assert 1.6 < row["duration_s"] < row["sim_time_s"] < 100 * row["wall_s"]
    assert game("tcsc", 0.1, 1, timing="lockstep")[0]["wall_s"] == 0.004


def test_paths_speeds_and_heights_are_those_of_the_keys() -> None:
    def ends(**keys: Any) -> np.ndarray:
        """The velocity at the end of each command."""
        _, arrays = game("tcsc", 1.0, 1, **keys)
        return arrays["linear_velocity_m_s"][np.searchsorted(arrays["time_s"], arrays["command_end_s"] - 1e-6)]

    assert ends(path="two_forward_one_back")[:, 0] == pytest.approx([0.674, 0.89, -0.5], abs=0.25)
    up, east = ends(path=[[0.0, 0.0, -1.0], [0.0, 2.0, 0.0]])
    assert (up[2] < -0.5, east[1] > 1.2) == (True, True)
    assert ends(speed_m_s=2.0)[0, 0] == pytest.approx(1.35, abs=0.03)
    (_, plain), (_, held) = game("tcsc", 1.0, 4), game("tcsc", 1.0, 4, height_m=-10.0)
    assert plain["position_m"][-1, 2] < -11.0
    np.testing.assert_allclose(held["position_m"][:, 2], -10.0, atol=0.2)


@pytest.mark.parametrize(
    ("profile", "clock_speed", "t_sample_s", "t_th_ms"),
    [
        ("airsim", 20.0, 0.5, 20),  # the client's millisecond, 20 times as fast
        ("airsim", 100.0, 0.5, 50),  # a tenth of T_sample
        ("airsim", 20.0, 0.1, 10),
        ("airsim", 1.0, 0.5, 3),  # a tick
        ("native", 20.0, 0.5, 0),  # whose continue-for is exact
    ],
)
def test_tcsc_allows_for_the_clients_latency_at_the_clock_speed(
    profile: str, clock_speed: float, t_sample_s: float, t_th_ms: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Commands begin once, before the clock is read, and fly as they are asked for."""
    told: list[Any] = []
    command = SynchronousCommand(told.append, cast(Any, lambda client, *asked: iter([asked])))
    monkeypatch.setitem(COMMANDS, "tcsc", command)
    config, client = config_of(profile=profile, t_th_wall_s=0.001), SimpleNamespace(now_ns=lambda: len(told))
    case = Game("game", "tcsc", clock_speed, "virtual", 0.5, 1, 0, "square")
    start_ns, commands = fly_path(case, config, client, [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0)], 0.5, t_sample_s)
    assert (start_ns, told) == (1, [client])
    flown = [asked for [asked] in commands]
    assert [goal.velocity_m_s for goal, *_ in flown] == [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0)]
    assert [tuple(asked[1:]) for asked in flown] == [(0.5, t_sample_s, t_th_ms * 1_000_000)] * 2


def test_airsims_profile_flies_both_commands() -> None:
    for command in ("adsc", "tcsc"):
        row, arrays = game(command, 0.1, 1, profile="airsim")
        lengths_s = arrays["command_end_s"] - arrays["command_start_s"]
        assert (row["error"], bool((lengths_s <= 0.105 + 1e-9).all())) == (None, True)
        assert command == "tcsc" or lengths_s == pytest.approx(0.105)


def test_a_flight_that_diverges_is_a_row_with_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)  # MuJoCo writes a log
    config = config_of(clock_speed=[100.0], t_move_s=[0.1], rounds=[1], games=1, command=["adsc"])
    with VirtualSession("blocks", "native", config.latency) as session:
        [case] = cases_of(config, role="game")
        session._world(1.0).lead.state["wind"] = 1e200
        assert "mjWARN_BAD" in str(Dp1().fly(config, case, session).row["error"])
        session._world(1.0).lead.state["wind"] = 0.0
        again = Dp1().fly(config, case, session)
    assert (again.row["error"], bool(np.isfinite(again.arrays["position_m"]).all())) == (None, True)


# --- reports: tests/test_reports.py has their numbers -----------------------------------------------------------


def test_a_run_without_rows_or_arrays_is_the_users_mistake(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"rows\.jsonl: holds no finished game of dp1"):
        made.dp1(tmp_path / "none", [])
    with pytest.raises(UserError, match="path: has no games but those of Figure 2 yet"):
        made.dp1(tmp_path / "path", [line_row("figure2", "adsc", 5.0, 0, 0.0)]).write_summary()
    lost = made.dp1(tmp_path / "lost", ALIKE)
    (lost.run.path / lost.games.arrays[0]).unlink()
    with pytest.raises(UserError, match=ALIKE[0]["case"]):
        lost.write_summary()


def test_summaries_are_the_same_in_any_order_and_processes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rows, written, here, score_path = accelerated_rows()[:11], set(), os.getpid(), dp1.score_path

    def unheard(run: RunDirectory, path: Any) -> Any:
        assert os.getpid() == here or signal.getsignal(signal.SIGINT) is signal.SIG_IGN, "Ctrl-C is this process's"
        return score_path(run, path)

    monkeypatch.setattr(dp1, "score_path", unheard)
    for name, order, least in (("a", 1, 400), ("b", -1, 400), ("c", 1, 0)):
        monkeypatch.setattr(dp1, "PARALLEL_FROM_GAMES", least)
        report = made.dp1(tmp_path / name, rows[::order])
        report.write_summary()
        written.add((report.run.path / "summary.json").read_bytes())
    keys = [[cell[name] for name in dp1.CELL] for cell in report.summary["cells"]]
    assert (len(written), keys) == (1, sorted(keys))


# --- figures ------------------------------------------------------------------------------------------------------


def report_of_cells(*cells: tuple[Any, ...]) -> Any:
    """A report whose summary has these cells: command, ClockSpeed, STLC, error, speed-up, and the timing if another."""
    names = ("command", "clock_speed", "stlc_median", "position_rmse_m", "effective_speedup", "timing")
    found = [dict(zip(names, (*cell, "virtual")[:6], strict=True)) | {"games": 4} for cell in cells]
    return SimpleNamespace(summary={"cells": found})


def test_the_headline_is_of_each_commands_fastest_cells() -> None:
    """As in real time up to the last ClockSpeed before a cell that is not; error and speed-up are at the fastest."""
    report = report_of_cells(
        *(("tcsc", 5.0, 1.5, 0.3, 4.0), ("tcsc", 10.0, 1.9, 0.004, 8.0), ("adsc", 1.0, 1.0, 5.0, 1.0)),
        *(("adsc", 2.0, 1.9, 0.1, 2.0), ("adsc", 5.0, 1.81, 0.2, 4.0), ("adsc", 10.0, 1.99, 0.9, 8.0)),
        *(("adsc", 10.0, 1.8, 0.9, 8.0), ("adsc", 50.0, 1.9, 0.25, 30.0), ("adsc", 50.0, 1.9, 0.125, 20.0)),
        ("adsc", 100.0, 0.1, 9.0, 99.0, "lockstep"),
    )
    assert Dp1().headline(report) == (
        "At 50x ADSC strays up to 0.25 m (RMSE; median STLC 1.90, above 1.8 counts as alike). At 10x TCSC strays up to "
        "0.004 m (RMSE; median STLC 1.90, above 1.8 counts as alike). Speed-up over real time: ADSC 20 to 30, "
        "TCSC 8"
    )
    same = report_of_cells(("adsc", 50.0, 1.66, 2.8512, 40.0), ("tcsc", 50.0, 2.0, 0.0, 45.25))
    assert Dp1().headline(same) == (
        "At 50x ADSC strays up to 2.85 m (RMSE; median STLC 1.66, above 1.8 counts as alike). TCSC is identical to "
        "real time. Speed-up over real time: ADSC 40, TCSC 45.2"
    )
    exact = report_of_cells(("adsc", 1.0, 2.0, 0.0, 1.0), ("adsc", 50.0, 2.0, 0.0, 50.0, "lockstep"))
    assert Dp1().headline(exact) == "At 50x ADSC is identical to real time. Speed-up over real time: ADSC 50"
    few = report_of_cells(("adsc", 1.0, 2.0, 0.0, 1.0), ("adsc", 5.0, None, 0.0, 1.0))
    assert Dp1().headline(few) == "8 games, none of them accelerated and comparable with real time"


def test_a_flight_has_the_commands_of_its_path(tmp_path: Path) -> None:
    rows = [line_row("game", "tcsc", 50.0, 0, 0.1), line_row("figure2", "adsc", 5.0, 0, 0.2)]
    report = made.dp1(tmp_path / "run", rows, speed_m_s=2.0)
    square, forward = (Dp1().flight(report, game) for _, game in report.games.iterrows())
    assert (square.title, square.clock_speed, square.position_m[0, 1]) == ("TCSC at 50x", 50.0, 0.1)
    assert square.commands.velocity_m_s.tolist() == [[2, 0, 0], [0, 2, 0], [-2, 0, 0], [0, -2, 0]]
    assert square.commands.end_ns.tolist() == [second * 10**9 for second in (1, 2, 3, 4)]
    assert forward.commands.velocity_m_s.tolist() == [[2, 0, 0], [2, 0, 0], [-2, 0, 0]]
    fell = line_row("game", "adsc", 50.0, 0, 0.1, commands=2, error="it fell")
    arrays = made.line_arrays(fell)
    arrays |= {f"command_{end}_s": arrays[f"command_{end}_s"][:2] for end in ("start", "end")}
    report = made.run_of(tmp_path / "fell", Dp1(), config_of(), [fell | {"arrays": arrays}])
    assert Dp1().flight(report, report.games.iloc[0]).commands.velocity_m_s.tolist() == [[1, 0, 0], [0, 1, 0]]


@pytest.mark.parametrize(
    ("row", "restarts", "marks"),
    [
        ({"lost_wall_s": 0.0, "restarts": 0}, 0, {}),
        *((row, 0, {"disturbed": True}) for row in ({"lost_wall_s": 0.25}, {"stalled_wall_s": 0.5}, {"restarts": 1})),
        ({"lost_wall_s": 0.0}, 2, {"restarts": 2, "disturbed": True}),
    ],
)
def test_a_measured_game_is_marked_by_what_disturbed_it(row: dict[str, Any], restarts: int, marks: Any) -> None:
    assert disturbances(row, restarts) == marks


@pytest.mark.parametrize(("stalled_ns", "told"), [(0, {}), (1_500_000_000, {"stalled_wall_s": 1.5})])
def test_a_row_tells_what_was_lost_and_stalled_in_seconds(stalled_ns: int, told: dict[str, float]) -> None:
    speed = {"simulated_ns": 2 * 10**9, "real_time_factor": 4.0, "lost_wall_ns": 250_000_000, "failure": "it fell"}
    recording = SimpleNamespace(commands=np.array([[0, 3], [3, 700]]), tick_ns=2_000_000)
    client: Any = SimpleNamespace(speed=lambda: speed, recording=lambda: recording)
    client.transport = SimpleNamespace(stalled_ns=stalled_ns)
    row, _ = flight_row(Game("game", "adsc", 4.0, "wall", 1.0, 1, 0, "square"), config_of(), client, 0.5)
    times = {"wall_s": 0.5, "sim_time_s": 2.0, "duration_s": 1.4, "lost_wall_s": 0.25}
    assert {name: value for name, value in row.items() if name.endswith("_s")} == times | told
    assert (row["error"], row["real_time_factor"]) == ("it fell", 4.0)


@pytest.mark.parametrize(
    ("damaged", "complaint"),
    [("no JSON", "not JSON"), ("[]", "needs at least one value"), ('[{"event": "run"}]', "key '0.source' is missing")],
)
def test_a_damaged_trace_is_the_users_mistake(damaged: str, complaint: str, tmp_path: Path) -> None:
    report = made.dp1(tmp_path / "run", ALIKE)
    report.run.write_text("traces/tcsc.json", damaged)
    with pytest.raises(UserError, match=rf"tcsc\.json: {complaint}"):
        dp1.trellis_figure(report)
