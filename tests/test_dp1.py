"""DP1 end to end: the paper's grid, repeatable bytes, resumes, subsets, paths, and one line for each mistake."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from tests.running import configured
from uavaccel.cli.experiments import run_experiment
from uavaccel.cli.terminal import Progress
from uavaccel.commands import COMMANDS, SynchronousCommand
from uavaccel.config import validate
from uavaccel.errors import UserError
from uavaccel.records import RunDirectory
from uavaccel.suites import dp1
from uavaccel.suites.dp1 import Dp1, Dp1Config, Game
from uavaccel.suites.registry import merged, read_mapping
from uavaccel.suites.session import RunRequest
from uavaccel.wire.session import VirtualSession, open_session

SMALL: dict[str, Any] = {"clock_speed": [10.0, 100.0], "t_move_s": [0.1, 0.2], "rounds": [1], "games": 2}


def paper_config(**options: Any) -> Dp1Config:
    mapping, source = read_mapping("dp1")
    return validate(Dp1Config, merged(mapping, options), source)


def request(out: Path, timing: str = "virtual", **changes: Any) -> RunRequest:
    options = {**SMALL, "timing": timing}
    return replace(RunRequest("dp1", options, ["reference_games=2"], out=out), **changes)


def contents(run: Path) -> dict[str, bytes]:
    """What has to be the same twice: rows, arrays, summary, configuration, traces."""
    names = ["rows.jsonl", "summary.json", "config.yaml", "traces/adsc.json", "traces/tcsc.json"]
    arrays = sorted(path.relative_to(run).as_posix() for path in (run / "arrays").iterdir())
    return {name: (run / name).read_bytes() for name in [*names, *arrays]}


def cases_of(config: Dp1Config, **wanted: Any) -> list[Game]:
    """The cases with these attributes."""
    return [case for case in Dp1().cases(config) if all(getattr(case, key) == value for key, value in wanted.items())]


def fly_case(config: Dp1Config, case: Game, *earlier: Game) -> tuple[Any, Any]:
    """The row and the arrays of a case, after others in the same session."""
    with open_session(case.timing, config.profile, "blocks", config.latency) as session:
        *_, flown = [Dp1().fly(config, own, session) for own in (*earlier, case)]
    return flown.row, flown.arrays


def same_arrays(a: Mapping[str, np.ndarray], b: Mapping[str, np.ndarray]) -> bool:
    return a.keys() == b.keys() and all(np.array_equal(a[name], b[name]) for name in a)


# --- the grid -----------------------------------------------------------------------------------------------


def test_the_papers_grid_has_4800_games_and_79200_simulated_seconds() -> None:
    cases = cases_of(paper_config())
    grid = [case for case in cases if case.role in ("game", "reference")]
    assert len(grid) == 4_800
    assert sum(case.simulated_s() for case in grid) == pytest.approx(79_200)
    assert len({case.id for case in cases}) == len(cases)
    references = [case for case in grid if case.role == "reference"]
    assert {(case.command, case.clock_speed) for case in references} == {("adsc", 1.0)}
    assert len(references) == 20 * 4 * 6
    keys = {case.seed(0).spawn_key for case in cases if case.role != "lockstep"}
    assert len(keys) == sum(case.role != "lockstep" for case in cases), "seeds belong to games alone"
    assert cases[0].seed(0).generate_state(4).tolist() != cases[0].seed(1).generate_state(4).tolist()


def test_a_single_clock_brings_references_of_its_own() -> None:
    """They come first, then the flights without latency, the games, and those of Figure 2."""
    config = paper_config(
        clock_speed=[50.0, 5.0], t_move_s=[0.2, 1.0], rounds=[4], games=1, reference_games=2, timing="wall"
    )
    assert [(case.id, case.timing) for case in cases_of(config)] == [
        *((f"reference-adsc-k1-t{t}-r4-g0{game}", "virtual") for t in ("0.2", "1") for game in (0, 1)),
        *((f"lockstep-tcsc-k1-t{t}-r4-g00", "lockstep") for t in ("0.2", "1")),
        *((f"{command}-k{k}-t{t}-r4-g00", "wall")
          for command in ("adsc", "tcsc") for k in (50, 5) for t in ("0.2", "1")),
        ("figure2-adsc-k1-t1-r1-g00", "virtual"),
        ("figure2-adsc-k50-t1-r1-g01", "wall"),
    ]  # fmt: skip
    assert {case.path for case in cases_of(config, role="figure2")} == {"two_forward_one_back"}


def test_figure_4_is_of_the_longest_command_at_the_fastest_clock(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = paper_config(clock_speed=[5.0, 50.0, 10.0], t_move_s=[0.2, 1.0, 0.5])
    monkeypatch.setattr("uavaccel.calibration.calibrate.record_trace", lambda _, *asked: list(asked))
    run = RunDirectory.create(tmp_path / "run", config, {})
    Dp1().finish(config, run)
    traces = {command: run.read_json(f"traces/{command}.json") for command in ("adsc", "tcsc")}
    assert traces == {command: [command, 50.0, 1.0] for command in traces}


@pytest.mark.parametrize("case_id", ["adsc-k50-t0.2-r2-g03", "tcsc-k100-t0.1-r1-g19", "reference-adsc-k1-t0.1-r1-g01"])
def test_a_game_of_a_subset_is_that_game_of_the_full_grid(case_id: str) -> None:
    full = paper_config()
    [case] = cases_of(full, id=case_id)
    keys = {"clock_speed": [case.clock_speed], "t_move_s": [case.t_move_s], "command": [case.command]}
    subset = paper_config(**keys, rounds=[case.rounds])
    [same] = cases_of(subset, id=case_id)
    row, arrays = fly_case(subset, same, *cases_of(subset, timing="virtual")[-3:])
    whole_row, whole_arrays = fly_case(full, case)
    assert row == whole_row
    assert same_arrays(arrays, whole_arrays)


# --- the same bytes -------------------------------------------------------------------------------------------


@pytest.fixture
def without_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Drawing takes most of a small run's time, and has tests of its own."""
    monkeypatch.setattr(Dp1, "page", lambda *_: iter(()))


def interrupt_after(games: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C when so many games have been flown."""
    flown, done = Progress.flown, 0

    def counting(self: Progress, case: Any, row: dict[str, Any]) -> None:
        nonlocal done
        flown(self, case, row)
        done += 1
        if done == games:
            raise KeyboardInterrupt

    monkeypatch.setattr(Progress, "flown", counting)


@pytest.mark.slow
@pytest.mark.usefixtures("without_figures")
def test_the_same_bytes_whatever_jobs_and_interruptions(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Once in one go; once in two processes, stopped, a row cut short, and resumed in one, which plans what is left."""
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    run_experiment(request(whole))
    with monkeypatch.context() as patch:
        interrupt_after(7, patch)
        with pytest.raises(UserError, match=r"^interrupted; go on with: uavaccel run --out .*broken --resume"):
            run_experiment(request(broken, jobs=2))
    rows = (broken / "rows.jsonl").read_bytes()
    assert rows.count(b"\n") == 7
    (broken / "rows.jsonl").write_bytes(rows + b'{"case": "adsc-k10')
    (broken / "arrays" / "tcsc-k100-t0.2-r1-g01.npz").write_bytes(b"cut short")
    capsys.readouterr()
    run_experiment(request(broken, resume=True))
    assert contents(broken) == contents(whole)
    cases = [case.id for case in cases_of(paper_config(**SMALL, reference_games=2, timing="virtual"))]
    assert [row["case"] for row in RunDirectory(whole).rows()] == cases
    assert capsys.readouterr().out.startswith(f"{len(cases) - 7} games (")
    run_experiment(request(broken, resume=True, dry_run=True))
    assert capsys.readouterr().out.startswith("no game is left to be flown in ")


@pytest.mark.usefixtures("without_figures")
def test_lockstep_gives_the_same_bytes_after_a_crash(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The process dies in the worst place: after a game's arrays are written and before its row is."""
    keys = {**SMALL, "timing": "lockstep", "t_move_s": [0.1]}
    whole, broken = (replace(request(tmp_path / name), options=keys) for name in ("whole", "broken"))
    run_experiment(whole)
    with monkeypatch.context() as patch:
        append_row = RunDirectory.append_row

        def dying(self: RunDirectory, row: dict[str, Any], on_disk: bool = True) -> None:
            if len(self.rows()) == 5:
                raise OSError("power cut")
            append_row(self, row, on_disk)

        patch.setattr(RunDirectory, "append_row", dying)
        with pytest.raises(OSError, match="power cut"):
            run_experiment(broken)
    run_experiment(replace(broken, resume=True))
    assert contents(tmp_path / "broken") == contents(tmp_path / "whole")
    games = [row for row in RunDirectory(tmp_path / "whole").rows() if row["role"] == "game"]
    assert {(row["real_time_factor"], row["wall_s"]) for row in games} == {(10.0, 0.04), (100.0, 0.004)}


# --- what a game is -------------------------------------------------------------------------------------------


def game(command: str, t_move_s: float, rounds: int, **keys: Any) -> tuple[Any, Any]:
    config = paper_config(**{"clock_speed": [100.0], "t_move_s": [t_move_s], "rounds": [rounds], "games": 1, **keys})
    return fly_case(config, cases_of(config, role="game", command=command)[0])


def test_a_row_tells_what_was_flown() -> None:
    row, arrays = game("tcsc", 0.2, 2)
    assert (row["commands"], row["sim_time_s"], row["duration_s"], row["error"]) == (8, 1.6, 1.6, None)
    assert [row[name] for name in ("role", "t_move_s", "rounds", "game")] == ["game", 0.2, 2, 0]
    assert row["real_time_factor"] == 100.0
    assert row["wall_s"] > 0.016
    assert (row["lost_wall_s"], row["samples_dropped"]) == (0.0, 0)
    assert len(arrays["time_s"]) == 33
    row, _ = game("adsc", 0.2, 2)
    assert 1.6 < row["duration_s"] < row["sim_time_s"] < 100 * row["wall_s"]


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


def test_sampling_through_the_client_costs_time_and_no_accuracy() -> None:
    (row, arrays), (sampled_row, sampled) = game("tcsc", 0.2, 1), game("tcsc", 0.2, 1, t_sample_s=0.05)
    assert same_arrays(arrays, sampled)
    assert sampled_row["wall_s"] > row["wall_s"]


@pytest.mark.parametrize(
    ("profile", "clock_speed", "t_sample_s", "t_th_ms"),
    [
        ("airsim", 20.0, None, 20),  # the client's millisecond, 20 times as fast
        ("airsim", 100.0, None, 50),  # a tenth of T_sample, which is T_move
        ("airsim", 20.0, 0.1, 10),
        ("airsim", 1.0, None, 3),  # a tick
        ("native", 20.0, None, 0),  # whose continue-for is exact
    ],
)
def test_tcsc_allows_for_the_clients_latency_at_the_clock_speed(
    profile: str, clock_speed: float, t_sample_s: float | None, t_th_ms: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    flown: list[Any] = []

    def fly(*asked: Any) -> tuple[()]:
        flown.append(asked)
        return ()

    monkeypatch.setitem(COMMANDS, "tcsc", SynchronousCommand(lambda _: None, cast(Any, fly)))
    monkeypatch.setattr(dp1, "flight_row", lambda *_: ({}, SimpleNamespace(commands=(), dropped=0, arrays=dict)))
    keys: dict[str, Any] = {"clock_speed": [clock_speed], "t_move_s": [0.5], "rounds": [1], "profile": profile}
    config = paper_config(**keys, t_sample_s=t_sample_s, t_th_wall_s=0.001)
    session: Any = SimpleNamespace(start_game=lambda *_: SimpleNamespace(now_ns=lambda: 0))
    Dp1().fly(config, cases_of(config, role="game", command="tcsc")[0], session)
    assert [asked[2:] for asked in flown] == [(0.5, t_sample_s or 0.5, t_th_ms * 1_000_000)] * 4


def test_airsims_profile_flies_both_commands() -> None:
    for command in ("adsc", "tcsc"):
        row, arrays = game(command, 0.1, 1, profile="airsim")
        assert row["error"] is None
        lengths_s = arrays["command_end_s"] - arrays["command_start_s"]
        assert (lengths_s <= 0.105 + 1e-9).all()
        if command == "adsc":
            assert lengths_s == pytest.approx(0.105)


def test_a_flight_that_diverges_is_a_row_with_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)  # MuJoCo writes a log
    config = paper_config(clock_speed=[100.0], t_move_s=[0.1], rounds=[1], games=1)
    with VirtualSession("blocks", "native", config.latency) as session:
        for case in cases_of(config, role="game"):
            session._world(1.0).lead.state["wind"] = 1e200
            assert "mjWARN_BAD" in str(Dp1().fly(config, case, session).row["error"])
            session._world(1.0).lead.state["wind"] = 0.0
            again = Dp1().fly(config, case, session)
            assert again.row["error"] is None
            assert np.isfinite(again.arrays["position_m"]).all()


# --- mistakes -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("gmaes=3", "unknown key 'gmaes'; did you mean 'games'?"),
        ("t_move_s=[0.333]", "t_move_s: 0.333 s is not a positive multiple of the physics step of 2 ms; 0.332 and"),
        ("t_sample_s=0.0333", "t_sample_s"),
        ("t_sample_s=-1", "t_sample_s = -1: should be greater than 0"),
        ("t_move_s=[0]", "t_move_s.0 = 0: should be greater than 0"),
        ("clock_speed=[50, 50]", "clock_speed = [50, 50]: has 50 twice"),
        ("rounds=[2, 2]", "rounds = [2, 2]: has 2 twice"),
        ("rounds=[]", "rounds = []: needs at least one value"),
        ("rounds=[100001]", "rounds.0 = 100001: should be less than or equal to 100000"),
        ("games=0", "games = 0: should be greater than or equal to 1"),
        ("path=triangle", "path"),
        ("path=[]", "path = []"),
        ("path=[[1,0]]", "path"),
        ("height_m=1", "height_m = 1"),
        ("clock_speed=50", "clock_speed = 50: should be a list"),
        ("latency.issue_us=[1]", "latency.issue_us = [1]: needs 12 values"),
        ("latency.timer_us=[1,0,0,0,0,0,0,0,0,0,0,0]", "must not fall"),
    ],
)
def test_a_mistake_is_one_line(override: str, message: str) -> None:
    with pytest.raises(UserError) as mistake:
        configured("dp1", override)
    assert str(mistake.value).startswith("dp1.yaml: ")
    assert message in str(mistake.value)
    assert "\n" not in str(mistake.value)
