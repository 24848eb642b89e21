"""Runs made up for the tests of reports: rows and arrays of every suite whose numbers are plain to see."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.learning import tiny_config
from tests.running import configured
from uavaccel.config import validate
from uavaccel.envs.obstacle_lane import LaneTask
from uavaccel.envs.stopwatch import PHASES
from uavaccel.files import append_lines, to_json
from uavaccel.records import RunDirectory
from uavaccel.rl.config import LearnerConfig
from uavaccel.suites.dp1 import Dp1
from uavaccel.suites.dp2 import Dp2
from uavaccel.suites.evaluate import EvaluateConfig, Evaluation
from uavaccel.suites.realtime import Realtime
from uavaccel.suites.report import Report
from uavaccel.suites.rl import KEY, Rl
from uavaccel.suites.train import Training, game_case

Row = Any
SEED = 7


def run_of(path: Path, suite: Any, config: Any, rows: Sequence[Row], timings: Sequence[Row] = ()) -> Report:
    """The report of a run of these rows, whose `arrays` are kept beside them."""
    run = RunDirectory.create(path, config, {"host": "synthetic"})
    for row in rows:
        kept = {key: value for key, value in row.items() if key != "arrays"}
        run.append_row(
            {"suite": suite.name} | kept | (run.save_arrays(row["case"], row["arrays"]) if "arrays" in row else {})
        )
    for entry in timings:
        run.append_timing(entry)
    return suite.report(run)


def phases(*seconds: float) -> dict[str, float]:
    return dict(zip(PHASES, seconds, strict=True))


# --- DP1: straight lines of known errors --------------------------------------------------------------------------


def line_arrays(row: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """The samples of a `line_row`: at 1 m/s beside the x axis, rising 1.5 times as fast, on a grid that all share.

    Two such flights d metres aside have an STLC of 1 + e^-d and an RMSE of d.
    """
    time_s = np.arange(81) * 0.05
    starts = np.concatenate([[0.0], np.cumsum(1.0 + np.array(row["gaps_s"]))])
    return {
        "time_s": time_s,
        "position_m": np.column_stack([time_s, np.full(81, row["offset_m"]), -10.0 - 1.5 * time_s]),
        "orientation_wxyz": np.tile([1.0, 0.0, 0.0, 0.0], (81, 1)),
        "linear_velocity_m_s": np.tile(row.get("velocity_m_s", [row["clock_speed"]] * 3), (81, 1)),
        "angular_velocity_rad_s": np.zeros((81, 3)),
        "command_start_s": starts,
        "command_end_s": starts + 1.0,
    }


def line_row(role: str, command: str, clock_speed: float, game: int, offset_m: float, **keys: Any) -> Row:
    """The row of a straight flight: four commands of 1 s with `gaps_s` between them; `keys` stand in it as they are."""
    row: Row = {"role": role, "command": command, "clock_speed": clock_speed, "game": game, "offset_m": offset_m}
    row |= {"t_move_s": 1.0, "rounds": 1, "timing": "virtual", "gaps_s": [0.0] * 3, "wall_s": 4.0} | keys
    duration_s = 4.0 + sum(row["gaps_s"])
    prefix = "" if role == "game" else f"{role}-"
    return {
        "suite": "dp1", "profile": "native", "seed": SEED, "commands": 4, "error": None, "samples_dropped": 0,
        "case": f"{prefix}{command}-k{clock_speed:g}-t{row['t_move_s']:g}-r{row['rounds']}-g{game:02d}",
        "sim_time_s": duration_s, "duration_s": duration_s, "real_time_factor": clock_speed, "lost_wall_s": 0.0, **row,
    }  # fmt: skip


def dp1(path: Path, rows: Sequence[Row], **keys: Any) -> Report:
    flown = [row | {"arrays": line_arrays(row)} for row in rows]
    return run_of(path, Dp1(), configured("dp1", seed=SEED, **keys), flown)


# --- DP2: events in eighths of the pixels, metres aside -----------------------------------------------------------

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


def dp2_game(
    role: str, command: str = "tcsc", clock_speed: float = 1.0, *errors: tuple[int, float], **keys: Any
) -> Row:
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
        "role": role, "command": command, "clock_speed": clock_speed, "profile": "native",
        "timing": "lockstep" if role == "lockstep" else "virtual", "seed": 3, "t_move_s": 1.0, "t_sample_s": 0.33,
        "samples": n, "commands": len(arrays["command_velocity_m_s"]), "planned_commands": 2, "guard_retries": 2,
        "collision": None, "distance_m": 12.34, "wall_s": 0.03, "duration_s": 0.66, "sim_time_s": 9.0,
        "real_time_factor": 21.5, "lost_wall_s": 0.0, "error": None, "arrays": arrays,
    }  # fmt: skip
    return row | keys


def uncounted(made: Row) -> Row:
    """The game without the counts of its flight."""
    return made | {"arrays": {name: array for name, array in made["arrays"].items() if not name.startswith("dvs")}}


def hit(thing: str) -> dict[str, Any]:
    return {"collision": {"object": thing, "time_s": 0.5, "position_m": [1.0, 2.0, 3.0]}}


def dp2(path: Path, games: Sequence[Row], *overrides: str, changes: Any = None, **keys: Any) -> Report:
    config = configured("dp2", *overrides, **{"seed": 3} | keys)
    return run_of(path, Dp2(), config.model_copy(update=changes or {}), games)


# --- trainings ----------------------------------------------------------------------------------------------------

STATE = {"observation": "state"}


def trained(
    path: Path, rows: Sequence[Row], timings: Sequence[Row] = (), evaluations: Sequence[Row] = (), **keys: Any
) -> Report:
    """The report of a training of these rows; `keys` are of the task if they are not of the training."""
    task = {key: keys.pop(key) for key in list(keys) if key in LaneTask.model_fields}
    usual: Row = {"environment": 0, "return": 0.0, "is_success": False, "collision": None, "commands": 7}
    usual |= {"sim_time_s": 7.0, "phase_s": phases(1, 0, 0, 0, 0), **dict.fromkeys(("exploration", "loss", "mean_q"))}
    flown = [
        usual
        | {"case": game_case(number), "game": number, "lane": number}
        | {"distance_m": 150.0 if row.get("is_success") else 7.0}
        | row
        for number, row in enumerate(rows)
    ]
    spent = {"host_phase_s": phases(1, 0, 0, 0, 0), "learner_s": phases(0, 0, 0, 0, 1)}
    config: LearnerConfig = tiny_config(STATE | task, mirror=False, **keys)
    report = run_of(path, Training(), config, flown, [spent | entry for entry in timings])
    for line in evaluations:
        won_lanes = [number < line["successes"] for number in range(len(line["lanes"]))]
        known = {"weights_sha256": "f00", "is_success": won_lanes, "distance_m": [1.0] * len(won_lanes)}
        append_lines(report.run.path / "evaluations.jsonl", [to_json(known | line)])
    return report


def won(*games: bool) -> list[Row]:
    return [{"is_success": each} for each in games]


def walls(*walls_s: float) -> list[Row]:
    return [{"wall_s": wall_s} for wall_s in walls_s]


# --- evaluations --------------------------------------------------------------------------------------------------


def evaluated(path: Path, *rows: Row, task: dict[str, Any] | None = None, **keys: Any) -> Report:
    """A run with a row for each game, of lanes 0, 1, ... and lost by default."""
    plain = {"agent": "straight", "task": {"split": "evaluation", "timing": "virtual", **(task or {})}} | keys
    usual: Row = {"collision": None, "commands": 3, "is_success": False, "wall_s": 0.5, "distance_m": 9.0}
    usual |= {"phase_s": phases(0.1, 0.02, 0.3, 0.04, 0.005)}
    flown = [
        usual
        | {"case": f"lane-{row.get('lane', lane):06d}", "lane": lane, "sim_time_s": 10.0 + lane}
        | {"actions": [1] * row.get("commands", 3)}
        | row
        for lane, row in enumerate(rows)
    ]
    return run_of(path, Evaluation(), validate(EvaluateConfig, plain, "test"), flown)


def ended_at(*distances_m: float) -> list[Row]:
    """Games that ended at these distances, of which 150 m is a success."""
    return [{"distance_m": distance_m, "is_success": distance_m == 150.0} for distance_m in distances_m]


def outcomes_of(lanes_won: np.ndarray) -> dict[str, np.ndarray]:
    """The arrays of an evaluation of which these lanes were won."""
    lanes = len(lanes_won)
    return {"lane": np.arange(lanes), "is_success": lanes_won, "distance_m": np.full(lanes, 75.0)}


# --- the suite rl -------------------------------------------------------------------------------------------------

LANES = 40


def rl_rows(command: str, clock_speed: float, won: Sequence[Any], wall_s: float = 1.0, **keys: Any) -> list[Row]:
    """A row for each seed, won in flights or in real time alone; of a command `wall_s` less .25 s fly, .25 s draw."""
    rows = []
    spent_s = {"simulation": 0.75 * wall_s, "rendering": 0.25}
    spent_s |= {"image_processing": 0.001, "inference": 0.002, "learning": 0.007}
    for seed, lanes in enumerate(won):
        flights: Mapping[tuple[str, float], Sequence[int]] = (
            lanes if isinstance(lanes, Mapping) else {(command, 1.0): lanes}
        )
        commands = 100 * (seed + 1)
        row: Row = {"variant": "", "profile": "airsim", "timing": "virtual", "seed": seed}
        row |= {"command": command, "clock_speed": clock_speed, **keys}
        row["case"] = "-".join(str(row[name]) for name in (*KEY, "seed"))
        row["training"] = {"games": 10, "successes": 3 + seed, "commands": commands, "sim_time_s": float(commands)}
        row["training"] |= {"weights_sha256": "f00", "phase_s": {name: commands * s for name, s in spent_s.items()}}
        row["evaluations"] = [flight(*conditions, len(some)) for conditions, some in flights.items()]
        row["lanes"] = {f"{name}" if at == 1.0 else f"{name}-{at:g}x": some for (name, at), some in flights.items()}
        rows.append(row)
    return rows


def flight(command: str, clock_speed: float, successes: int) -> dict[str, Any]:
    conditions = {"command": command, "clock_speed": clock_speed, "timing": "virtual", "simulator": "kernels"}
    return {**conditions, "successes": successes, "games": LANES}


def exact_of(row: Row, lanes: Sequence[int]) -> Row:
    """The row of a policy's flight in the exact simulator."""
    exact = {key: value for key, value in row.items() if key != "training"}
    flown = [flight(row["command"], 1.0, len(lanes)) | {"simulator": "mujoco"}]
    return exact | {"case": f"{row['case']}-exact", "evaluations": flown, "lanes": {"exact": lanes}}


def rl(path: Path, rows: Sequence[Row], took_s: Sequence[float] = (), **options: Any) -> Report:
    """A run of these rows; games that were not won ended at 10 m on lane 0, 11 m on lane 1 and so on."""
    lane, kept = np.arange(LANES), []
    for row in rows:
        arrays: dict[str, np.ndarray] = {}
        for name, lanes in row["lanes"].items():
            of_them = np.isin(lane, lanes)
            distance_m = np.where(of_them, 150.0, 10.0 + lane)
            arrays |= {f"{name}_lane": lane, f"{name}_is_success": of_them, f"{name}_distance_m": distance_m}
        kept.append({key: value for key, value in row.items() if key != "lanes"} | {"arrays": arrays})
    timings = [{"case": row["case"], "training_s": s} for row, s in zip(rows, took_s, strict=False)]
    return run_of(path, Rl(), configured("rl_smoke", **options), kept, timings)


# --- the suite realtime -------------------------------------------------------------------------------------------


def thinking_row(agent: str, command: str, latency_s: float, clock_speed: float, mean: float, **keys: Any) -> Row:
    """An evaluation of three episodes that return 1 and .5 less and 1.5 more than the mean."""
    case = f"{agent}-{command}-{latency_s:g}-{clock_speed:g}-{keys.get('seed', 0)}"
    row: Row = {"kind": "evaluation", "case": case, "timing": "virtual", "environment": "pendulum", "agent": agent}
    row |= {"seed": 0, "command": command, "latency_s": latency_s, "clock_speed": clock_speed, "late_s": 0.0}
    return row | {"returns": [mean - 1, mean - 0.5, mean + 1.5], "delays_s": [latency_s * clock_speed] * 3} | keys


def realtime(path: Path, *rows: Row, **options: Any) -> Report:
    keys = (
        "environments={pendulum: {id: InvertedPendulum-v5, train_steps: 512}}",
        "agents={naive: {}, chunk: {chunk: 2}}",
    )
    more = "latency_s=[0, 0.05]", "clock_speed=[1, 4]", "episodes=3"
    return run_of(path, Realtime(), configured("realtime_smoke", *keys, *more, **options), rows)
