"""An evaluation as a part of another run, for suites whose every case is one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavaccel.records import RunDirectory
from uavaccel.suites.parts import Part, fly_part, part_run
from uavaccel.suites.report import Row
from uavaccel.suites.suite import Flown

OF_SUMMARY = ("games", "successes", "distance_m_median", "sim_time_s")


def fly_evaluation(
    run: RunDirectory, row: Row, part: Part, seed: int, of_summary: Sequence[str] = OF_SUMMARY
) -> Flown:
    """Fly the part named as the row's case; that row with what its summary says, and what became of each lane."""
    summary = fly_part(run, row["case"], part, seed)
    found = {name: summary[name] for name in of_summary}
    return Flown({**row, **found}, outcomes(part_run(run, row["case"])))


def won(row: Row) -> str:
    """A row of `fly_evaluation` in a few words."""
    return f"{row['case']} won {row['successes']} of {row['games']}"


def outcomes(run: RunDirectory) -> dict[str, NDArray[Any]]:
    """Of an evaluation's games (n,): lane, success, and metres north."""
    rows = run.rows()
    return {
        "lane": np.array([row["lane"] for row in rows], np.int64),
        "is_success": np.array([row["is_success"] for row in rows], bool),
        "distance_m": np.array([row["distance_m"] for row in rows], np.float64),
    }
