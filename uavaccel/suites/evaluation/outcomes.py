"""What became of each lane of an evaluation, as arrays: for suites whose parts are evaluations."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavaccel.records import RunDirectory


def outcomes(run: RunDirectory) -> dict[str, NDArray[Any]]:
    """Of an evaluation's games (n,): lane, success, and metres north."""
    rows = run.rows()
    return {
        "lane": np.array([row["lane"] for row in rows], np.int64),
        "is_success": np.array([row["is_success"] for row in rows], bool),
        "distance_m": np.array([row["distance_m"] for row in rows], np.float64),
    }
