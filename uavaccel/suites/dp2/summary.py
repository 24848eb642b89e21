"""DP2's summary.json: one entry a command and ClockSpeed, from rows and arrays alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from uavaccel.metrics.speedup import timing_provenance
from uavaccel.suites.dp2.cases import Dp2Row
from uavaccel.suites.dp2.scores import GameScore
from uavaccel.suites.report import Row, Summary, Values


def summary_of(config: Row, scores: Sequence[GameScore], guard: Summary | None) -> Values:
    """The summary of a run's scores; `guard` is its guard study. What cannot be known is None.

    Errors are over the images that a game shares with the same command's run at 1x; an ADSC game that collides
    ends there, and so do its pairs.
    """
    return {
        "suite": "dp2",
        "profile": config["profile"],
        "seed": config["seed"],
        "dvs_preset": config["dvs_preset"],
        "sensor_seed": config["sensor_seed"],
        "perturbed_share": config["perturbation"]["share"],
        "cells": [_cell(score) for score in scores],
        "guard_study": guard,
    }


def _cell(score: GameScore) -> Values:
    row = score.row
    return {
        "command": row["command"],
        "clock_speed": row["clock_speed"],
        "t_move_s": row["t_move_s"],
        "timing": row["timing"],
        "provenance": timing_provenance(row["timing"]),
        "reference": _reference(score),
        "images": row["samples"],
        "paired_images": len(score.position_error_m),
        "position_error_m_median": _median(score.position_error_m),
        "position_error_m_max": _max(score.position_error_m),
        "attitude_error_deg_median": _median(score.attitude_error_deg),
        "attitude_error_deg_max": _max(score.attitude_error_deg),
        "dvs_ed_percent_median": _median(score.dvs_ed_percent),
        "dvs_ed_percent_max": _max(score.dvs_ed_percent),
        "poses_equal_lockstep": score.equal_poses,
        "dvs_counts_equal_lockstep": score.equal_counts,
        "guard_retries": row["guard_retries"],
        "collision": row["collision"],
        "distance_m": row["distance_m"],
        "wall_s": row["wall_s"],
        "simulated_s_per_wall_s": _rate(row),
        "real_time_factor": row["real_time_factor"],
        "lost_wall_s": row["lost_wall_s"],
        **{key: row[key] for key in ("disturbed", "stalled_wall_s", "restarts") if key in row},
    }


def _reference(score: GameScore) -> Values | None:
    if score.reference is None:
        return None
    timing = score.reference["timing"]
    return {
        "case": score.reference["case"],
        "clock_speed": score.reference["clock_speed"],
        "timing": timing,
        "provenance": timing_provenance(timing),
        "is_this_cell": score.reference["case"] == score.row["case"],
    }


def _rate(row: Dp2Row) -> float | None:
    """Simulated seconds of commands over the wall time they took, images and guard included."""
    flown_s, wall_s = float(row["duration_s"]), float(row["wall_s"])
    return flown_s / wall_s if wall_s > 0 else None


def _median(values: NDArray[np.float64]) -> float | None:
    return float(np.median(values)) if values.size else None


def _max(values: NDArray[np.float64]) -> float | None:
    return float(np.max(values)) if values.size else None
