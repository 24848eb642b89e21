"""DP1 games made up for the tests of its report: straight lines of known errors, and a drone with a lag and latency."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tests.test_trellis import recorded_trace
from uavaccel.config import Config
from uavaccel.records import RunDirectory

SQUARE = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0))
TWO_FORWARD_ONE_BACK = ((1.0, 0.0, 0.0), (1.0, 0.0, 0.0), (-1.0, 0.0, 0.0))
STEP_S, SAMPLE_S, LAG_S, GOAL_TIMEOUT_S = 0.01, 0.05, 0.9, 0.06

Arrays = dict[str, np.ndarray]
Row = Any


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


def write_run(path: Path, flown: Sequence[tuple[Row, Arrays]], traces: bool = True) -> Path:
    run = RunDirectory.create(path, SyntheticConfig(), {"host": "synthetic"})
    for row, arrays in flown:
        run.save_arrays(row["case"], arrays)
        run.append_row(row)
    if traces:
        run.write_json("traces/tcsc.json", recorded_trace())
        run.write_json("traces/adsc.json", recorded_trace())
    return path


def line_arrays(row: Mapping[str, Any]) -> Arrays:
    """The samples of a `line_row`: at 1 m/s beside the x axis, on a grid that all share.

    Two such flights d metres aside have an STLC of 1 + e^-d and an RMSE of d.
    """
    time_s = np.arange(81) * SAMPLE_S
    position_m = np.column_stack([time_s, np.full(81, row["offset_m"]), np.full(81, -10.0)])
    starts = np.concatenate([[0.0], np.cumsum(1.0 + np.array(row["gaps_s"]))])
    return {
        "time_s": time_s,
        "position_m": position_m,
        "command_start_s": starts,
        "command_end_s": starts + 1.0,
    }


def line_row(role: str, command: str, clock_speed: float, game: int, offset_m: float, **keys: Any) -> Row:
    """The row of a straight flight: four commands of 1 s with `gaps_s` between them; `keys` stand in it as they are."""
    row: Row = {
        "role": role,
        "command": command,
        "clock_speed": clock_speed,
        "game": game,
        "offset_m": offset_m,
    }
    row |= {"t_move_s": 1.0, "rounds": 1, "timing": "virtual", "gaps_s": [0.0] * 3, "wall_s": 4.0} | keys
    finished = game_row(row, line_arrays(row), row["wall_s"])
    return finished | keys


def quantile(values: Sequence[float], share: float) -> float:
    """Linear between the neighbours of the place `share` (n - 1), counted from 0 in ascending order."""
    ordered, place = sorted(values), share * (len(values) - 1)
    below = min(int(place), len(ordered) - 2) if len(ordered) > 1 else 0
    above = min(below + 1, len(ordered) - 1)
    return ordered[below] + (place - below) * (ordered[above] - ordered[below])
