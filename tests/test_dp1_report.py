"""DP1's report on synthetic runs: numbers known by hand, figures that show something, repeatable bytes."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from uavaccel.config import Config
from uavaccel.draw.trellis import Message, messages, running_spans
from uavaccel.errors import UserError
from uavaccel.records import RunDirectory
from uavaccel.suites.dp1.report import HEADER, table, write_report
from uavaccel.suites.dp1.summary import summarise

SQUARE = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0))
TWO_FORWARD_ONE_BACK = ((1.0, 0.0, 0.0), (1.0, 0.0, 0.0), (-1.0, 0.0, 0.0))
STEP_S, SAMPLE_S, LAG_S, GOAL_TIMEOUT_S = 0.01, 0.05, 0.9, 0.06

Arrays = dict[str, np.ndarray]
Row = dict[str, Any]


class SyntheticConfig(Config):
    suite: str = "dp1"
    seed: int = 0


def fly(velocities: Sequence[Sequence[float]], t_move_s: float, gap_s: np.ndarray) -> Arrays:
    """A drone that follows its goals with a lag of 0.9 s and holds after 60 ms without a goal."""
    goals, start_s, end_s, time_s = [], [], [], 0.0
    for velocity, gap in zip(velocities, gap_s, strict=True):
        start_s.append(time_s)
        end_s.append(time_s + t_move_s)
        held_s = min(gap, GOAL_TIMEOUT_S)
        goals += [velocity] * round((t_move_s + held_s) / STEP_S)
        goals += [(0.0, 0.0, 0.0)] * round((gap - held_s) / STEP_S)
        time_s += t_move_s + gap
    velocity_m_s = np.zeros((len(goals) + 1, 3))
    for i, goal in enumerate(goals):
        velocity_m_s[i + 1] = velocity_m_s[i] + (np.array(goal) - velocity_m_s[i]) * STEP_S / LAG_S
    position_m = np.cumsum(velocity_m_s, axis=0) * STEP_S - [0.0, 0.0, 10.0]
    every = round(SAMPLE_S / STEP_S)
    samples = len(velocity_m_s[::every])
    return {
        "time_s": np.arange(samples) * SAMPLE_S,
        "position_m": position_m[::every],
        "orientation_wxyz": np.tile([1.0, 0.0, 0.0, 0.0], (samples, 1)),
        "linear_velocity_m_s": velocity_m_s[::every],
        "angular_velocity_rad_s": np.zeros((samples, 3)),
        "command_start_s": np.array(start_s),
        "command_end_s": np.array(end_s),
    }


def game_row(case: Mapping[str, Any], arrays: Mapping[str, np.ndarray], wall_s: float) -> Row:
    """The row of a finished game as the suite writes it."""
    prefix = "" if case["role"] == "game" else f"{case['role']}-"
    name = f"{prefix}{case['command']}-k{case['clock_speed']:g}-t{case['t_move_s']:g}"
    name += f"-r{case['rounds']}-g{case['game']:02d}"
    duration_s = float(arrays["command_end_s"][-1])
    return {
        **case,
        "suite": "dp1",
        "case": name,
        "profile": "native",
        "seed": 0,
        "commands": len(arrays["command_start_s"]),
        "wall_s": wall_s,
        "sim_time_s": duration_s,
        "duration_s": duration_s,
        "real_time_factor": float(case["clock_speed"]),
        "lost_wall_s": 0.0,
        "arrays": f"arrays/{name}.npz",
        "error": None,
    }


def cell_games(
    role: str, command: str, clock: float, t_move_s: float, rounds: int, games: int, timing: str
) -> list[tuple[Row, Arrays]]:
    """Games whose latency is 1.5 ms of wall time a command under ADSC and nothing under TCSC."""
    rng = np.random.default_rng([round(clock), round(t_move_s * 10), rounds, command == "adsc"])
    path = TWO_FORWARD_ONE_BACK if role == "figure2" else SQUARE * rounds
    flown = []
    for game in range(games):
        latency_s = rng.gamma(3.0, 0.0005, len(path)) * (command == "adsc" and role != "lockstep")
        arrays = fly(path, t_move_s, latency_s * clock)
        case = {"role": role, "command": command, "clock_speed": clock, "t_move_s": t_move_s}
        case |= {"rounds": rounds, "game": game, "timing": timing}
        wall_s = arrays["command_end_s"][-1] / clock + len(path) * 0.0008
        flown.append((game_row(case, arrays, wall_s), arrays))
    return flown


def synthetic_games(
    clocks: Sequence[float] = (5.0, 100.0),
    t_moves_s: Sequence[float] = (0.2, 1.0),
    rounds: Sequence[int] = (1, 4),
    games: int = 3,
    timing: str = "virtual",
) -> list[tuple[Row, Arrays]]:
    flown = []
    for t_move_s in t_moves_s:
        for n in rounds:
            flown += cell_games("reference", "adsc", 1.0, t_move_s, n, games, "virtual")
            flown += cell_games("lockstep", "tcsc", 1.0, t_move_s, n, 1, "lockstep")
            for clock in clocks:
                for command in ("adsc", "tcsc"):
                    flown += cell_games("game", command, clock, t_move_s, n, games, timing)
    flown += cell_games("figure2", "adsc", 1.0, max(t_moves_s), 1, 1, "virtual")
    flown += cell_games("figure2", "adsc", max(clocks), max(t_moves_s), 1, 1, timing)
    return flown


def recorded_trace() -> list[Row]:
    steps = [
        ("client", "call move", 0.0, 0.0),
        ("server", "handle move", 1e-4, 0.0),
        ("client", "call continue", 2e-4, 0.0),
        ("server", "handle continue", 3e-4, 0.0),
        ("server", "run", 3e-4, 0.0),
        ("server", "end continue", 1.03e-2, 1.0),
        ("server", "pause", 1.03e-2, 1.0),
        ("client", "return continue", 1.05e-2, 1.0),
        ("client", "return move", 1.06e-2, 1.0),
    ]
    return [{"source": s, "event": e, "wall_s": w, "sim_s": t} for s, e, w, t in steps]


def write_run(path: Path, flown: Sequence[tuple[Row, Arrays]], traces: bool = True) -> Path:
    run = RunDirectory.create(path, SyntheticConfig(), {"host": "synthetic"})
    for row, arrays in flown:
        run.save_arrays(row["case"], arrays)
        run.append_row(row)
    if traces:
        run.write_json("traces/tcsc.json", recorded_trace())
        run.write_json("traces/adsc.json", recorded_trace())
    return path


def find(summary: Mapping[str, Any], **wanted: Any) -> dict[str, Any]:
    matching = [c for c in summary["cells"] if all(c[key] == value for key, value in wanted.items())]
    assert len(matching) == 1, matching
    return matching[0]


# --- summary values known by hand ---------------------------------------------------------------------------


def line_arrays(offset_m: float, duration_s: float = 4.0) -> Arrays:
    """Straight flight at 1 m/s beside the x axis: a shared grid, so STLC is 1 + e^-offset and RMSE offset."""
    time_s = np.arange(round(duration_s / SAMPLE_S) + 1) * SAMPLE_S
    position_m = np.column_stack([time_s, np.full_like(time_s, offset_m), np.full_like(time_s, -10.0)])
    starts = np.arange(4) * duration_s / 4
    return {
        "time_s": time_s,
        "position_m": position_m,
        "command_start_s": starts,
        "command_end_s": starts + duration_s / 4 - 0.01,
    }


def line_game(
    role: str, clock: float, game: int, offset_m: float, wall_s: float, timing: str = "wall"
) -> Row:
    case = {"role": role, "command": "adsc" if role == "reference" else "tcsc", "clock_speed": clock}
    case |= {"t_move_s": 1.0, "rounds": 1, "game": game, "timing": timing, "offset_m": offset_m}
    return game_row(case, line_arrays(offset_m), wall_s)


@pytest.fixture
def line_summary() -> dict[str, Any]:
    rows = [
        line_game("reference", 1.0, 0, 0.0, 4.1, timing="virtual"),
        line_game("reference", 1.0, 1, 0.2, 4.3, timing="virtual"),
        line_game("lockstep", 1.0, 0, 0.5, 4.0, timing="lockstep"),
        line_game("game", 50.0, 1, 0.1, 0.12),
        line_game("game", 50.0, 0, 0.1, 0.09),
    ]
    return summarise(rows, lambda row: line_arrays(row["offset_m"]))


def test_a_cell_is_compared_with_all_references(line_summary: dict[str, Any]) -> None:
    cell = find(line_summary, command="tcsc")
    assert cell["stlc_median"] == pytest.approx(1 + np.exp(-0.1), abs=1e-12)
    assert cell["stlc_q25"] == cell["stlc_q75"] == cell["stlc_median"]
    assert cell["position_rmse_m"] == pytest.approx(0.1)
    assert cell["position_rmse_vs_lockstep_m"] == pytest.approx(0.4)
    assert cell["duration_error_s"] == 0.0
    assert cell["command_gap_median_s"] == pytest.approx(0.01)
    assert (cell["games"], cell["distinct_games"], cell["failed_games"]) == (2, 1, 0)


def test_a_reference_is_not_compared_with_itself(line_summary: dict[str, Any]) -> None:
    cell = find(line_summary, command="adsc")
    assert cell["stlc_median"] == pytest.approx(1 + np.exp(-0.2), abs=1e-12)
    assert cell["position_rmse_m"] == pytest.approx(0.2)
    assert cell["reference"]["is_this_cell"] is True
    assert (cell["effective_speedup"], cell["effective_speedup_interval"]) == (1.0, None)


def test_speedup_is_the_ratio_of_means_and_says_what_it_mixes(line_summary: dict[str, Any]) -> None:
    cell = find(line_summary, command="tcsc")
    assert cell["effective_speedup"] == pytest.approx(4.2 / 0.105)
    low, high = cell["effective_speedup_interval"]
    assert 4.1 / 0.12 <= low < cell["effective_speedup"] < high <= 4.3 / 0.09
    assert cell["provenance"] == "measured"
    assert cell["effective_speedup_provenance"] == "mixed"
    assert cell["reference"] == {
        "command": "adsc",
        "clock_speed": 1.0,
        "timing": "virtual",
        "provenance": "modelled",
        "games": 2,
        "is_this_cell": False,
    }


def test_without_references_or_lockstep_the_numbers_are_unknown() -> None:
    summary = summarise([line_game("game", 50.0, 0, 0.1, 0.1)], lambda row: line_arrays(row["offset_m"]))
    (cell,) = summary["cells"]
    unknown = ("reference", "stlc_median", "position_rmse_m", "position_rmse_vs_lockstep_m")
    assert [cell[key] for key in (*unknown, "duration_error_s", "effective_speedup")] == [None] * 6
    assert cell["real_time_factor"] == 50.0


def test_a_failed_game_is_counted_and_left_out() -> None:
    failed = line_game("game", 50.0, 1, 9.0, 0.1) | {"error": "the drone crashed", "arrays": None}
    rows = [line_game("reference", 1.0, 0, 0.0, 4.0), line_game("game", 50.0, 0, 0.1, 0.1), failed]
    cell = find(summarise(rows, lambda row: line_arrays(row["offset_m"])), command="tcsc")
    assert (cell["games"], cell["failed_games"]) == (1, 1)
    assert cell["position_rmse_m"] == pytest.approx(0.1)


def test_cells_come_in_canonical_order_whatever_the_rows_order() -> None:
    flown = synthetic_games(games=2)
    arrays = {row["case"]: sample for row, sample in flown}
    rows = [row for row, _ in flown]
    forwards = summarise(rows, lambda row: arrays[row["case"]])
    backwards = summarise(rows[::-1], lambda row: arrays[row["case"]])
    assert json.dumps(forwards) == json.dumps(backwards)
    keys = [(c["command"], c["clock_speed"], c["t_move_s"], c["rounds"]) for c in forwards["cells"]]
    assert keys == sorted(keys)


# --- the written report -------------------------------------------------------------------------------------

FIGURES = (
    "figure2_velocity",
    "figure3_trajectories",
    "figure4_trellis",
    "figure5_accuracy",
    "figure6_speedup",
)


def assert_shows_something(path: Path) -> None:
    image = cv2.imread(str(path))
    assert image is not None
    assert min(image.shape[:2]) > 300
    assert np.mean(np.any(image != 255, axis=-1)) > 0.01


def test_the_report_of_a_run(tmp_path: Path) -> None:
    run_dir = write_run(tmp_path / "run", synthetic_games())
    summary = write_report(RunDirectory(run_dir))
    assert json.loads((run_dir / "summary.json").read_text()) == summary
    for name in FIGURES:
        assert_shows_something(run_dir / "figures" / f"{name}.png")
    markdown, html = ((run_dir / f"report.{suffix}").read_text() for suffix in ("md", "html"))
    for name in FIGURES:
        assert f"(figures/{name}.png)" in markdown
    assert html.count("data:image/png;base64,") == len(FIGURES)
    assert 'src="http' not in html
    assert "modelled (no latency): 4 games · modelled (virtual clock): 62 games" in markdown
    fast = {"clock_speed": 100.0, "t_move_s": 1.0, "rounds": 4}
    adsc, tcsc = (find(summary, command=command, **fast) for command in ("adsc", "tcsc"))
    assert tcsc["position_rmse_vs_lockstep_m"] == 0.0
    assert tcsc["distinct_games"] == 1
    assert adsc["position_rmse_vs_lockstep_m"] > 0.2
    assert adsc["command_gap_median_s"] == pytest.approx(0.15, rel=0.4)


@pytest.mark.slow
def test_the_summary_is_the_same_bytes_every_time_and_for_any_jobs(tmp_path: Path) -> None:
    flown = synthetic_games(clocks=(100.0,), rounds=(1,), games=2)
    written = []
    for name, jobs in (("first", 1), ("second", 2)):
        run_dir = write_run(tmp_path / name, flown)
        write_report(RunDirectory(run_dir), jobs=jobs)
        files = ["summary.json", "report.html", *(f"figures/{figure}.png" for figure in FIGURES)]
        written.append([(run_dir / file).read_bytes() for file in files])
    assert written[0] == written[1]
    write_report(RunDirectory(tmp_path / "first"), jobs=1)
    assert (tmp_path / "first" / "summary.json").read_bytes() == written[0][0]


SPARSE_RUNS: dict[str, Callable[[], list[tuple[Row, Arrays]]]] = {
    "references alone": lambda: cell_games("reference", "adsc", 1.0, 1.0, 1, 1, "virtual"),
    "one cell without references": lambda: cell_games("game", "tcsc", 50.0, 0.1, 1, 1, "wall"),
    "one ClockSpeed": lambda: synthetic_games(clocks=(50.0,), t_moves_s=(0.5,), rounds=(2,), timing="wall"),
}


@pytest.mark.parametrize("name", SPARSE_RUNS)
def test_little_data_still_makes_a_report(tmp_path: Path, name: str) -> None:
    run_dir = write_run(tmp_path / "run", SPARSE_RUNS[name](), traces=False)
    summary = write_report(RunDirectory(run_dir))
    for figure in FIGURES:
        assert_shows_something(run_dir / "figures" / f"{figure}.png")
    assert all(len(line) == len(HEADER) for line in table(summary))


def test_the_table_says_what_is_known(line_summary: dict[str, Any]) -> None:
    reference, game = table(line_summary)
    assert reference[:5] == ("ADSC", "1x", "1", "1", "2")
    assert game == (
        "TCSC",
        "50x",
        "1",
        "1",
        "2",
        "1.905 [1.905, 1.905]",
        "0.100",
        "0.400",
        "+0.000",
        "40.00 (mixed)",
        "50.00",
        "measured",
    )


def test_a_run_without_games_is_the_users_mistake(tmp_path: Path) -> None:
    run_dir = write_run(tmp_path / "run", [])
    with pytest.raises(UserError, match=r"rows\.jsonl: holds no dp1 game"):
        write_report(RunDirectory(run_dir))


def test_missing_arrays_are_named(tmp_path: Path) -> None:
    flown = cell_games("reference", "adsc", 1.0, 1.0, 1, 2, "virtual")
    run_dir = write_run(tmp_path / "run", flown)
    (run_dir / flown[1][0]["arrays"]).unlink()
    with pytest.raises(UserError, match="reference-adsc-k1-t1-r1-g01"):
        write_report(RunDirectory(run_dir))


# --- the trellis --------------------------------------------------------------------------------------------


def test_answers_leave_where_their_work_ended() -> None:
    assert messages(recorded_trace()) == [Message(0, 1), Message(2, 3), Message(5, 7), Message(5, 8)]


def test_simulated_time_runs_between_run_and_pause() -> None:
    trace = recorded_trace()
    assert running_spans(trace) == [(4, 6)]
    assert running_spans(trace[:4]) == [(0, 3)]
    assert running_spans(trace[5:]) == [(0, 1)]
