"""DP1 games made up for the tests of its report: straight lines of known errors, written into a run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tests.running import configured
from uavaccel.records import RunDirectory
from uavaccel.suites.dp1 import Dp1
from uavaccel.suites.report import Report

Row = Any
SEED = 7


def line_arrays(row: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """The samples of a `line_row`: at 1 m/s beside the x axis, on a grid that all share.

    Two such flights d metres aside have an STLC of 1 + e^-d and an RMSE of d.
    """
    time_s = np.arange(81) * 0.05
    starts = np.concatenate([[0.0], np.cumsum(1.0 + np.array(row["gaps_s"]))])
    return {
        "time_s": time_s,
        "position_m": np.column_stack([time_s, np.full(81, row["offset_m"]), np.full(81, -10.0)]),
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
        "suite": "dp1",
        "case": f"{prefix}{command}-k{clock_speed:g}-t{row['t_move_s']:g}-r{row['rounds']}-g{game:02d}",
        "profile": "native",
        "seed": SEED,
        "commands": 4,
        "sim_time_s": duration_s,
        "duration_s": duration_s,
        "real_time_factor": clock_speed,
        "lost_wall_s": 0.0,
        "samples_dropped": 0,
        "error": None,
        **row,
    }


def report_of(path: Path, rows: Sequence[Row], **keys: Any) -> Report:
    """The report of a run of these rows, whose configuration has these keys."""
    run = RunDirectory.create(path, configured("dp1", seed=SEED, **keys), {"host": "synthetic"})
    for row in rows:
        run.append_row({**row, **run.save_arrays(row["case"], line_arrays(row))})
    return Dp1().report(run)
