"""Writes which lanes the policies of a run of the suite `rl` won, a line for each policy and flight of it.

    uavaccel run rl --jobs 4 --out runs/rl
    python -m tools.outcomes_by_lane runs/rl > docs/tables/rl_test_lanes.csv
    python -m tools.outcomes_by_lane runs/rl exact > docs/tables/rl_exact.csv

`won` has a 1 or a 0 for each lane, from `first_lane` of its split on; `ended_m`, of flights in real time with the
command of the training, how far north each lost one ended, m. Seeds that are not complete are left out.
"""

from __future__ import annotations

import sys

import pandas as pd

from uavaccel.suites.registry import open_run
from uavaccel.suites.rl import KEY, flights_of, where

SAME = [name for name in KEY if name != "timing"] + ["seed", "with", "at"]
COLUMNS = [*SAME, "first_lane", "won", "ended_m", "weights_sha256"]


def main(path: str, simulator: str = "kernels") -> None:
    run = open_run(path)
    flights = flights_of(run.rows(), run.load_arrays)
    # A policy's flights in the exact simulator are a row of their own, which has no training.
    flights["weights_sha256"] = flights.groupby(SAME[:-2]).weights_sha256.transform("first")
    flights = where(flights, exact=simulator == "exact").drop_duplicates(SAME).sort_values(SAME)
    lines = pd.DataFrame(map(by_lane, flights.to_dict("records")))
    count = lines.groupby("seed").size()
    lines[lines.seed.map(count) == count.max()][COLUMNS].to_csv(sys.stdout, index=False)


def by_lane(flight: dict[str, object]) -> dict[str, object]:
    """Return a flight with its outcome on each lane, in order, and the ends of those lost, in words."""
    won = flight["won"]
    assert isinstance(won, pd.Series)
    lost_m = pd.Series(flight["distance_m"], won.index)[~won].sort_index() if flight["flight"] == 0 else []
    won = won.sort_index()
    words = {"won": "".join("01"[each] for each in won), "ended_m": " ".join(f"{each:.3f}" for each in lost_m)}
    return flight | words | {"first_lane": won.index[0]}


if __name__ == "__main__":
    main(*sys.argv[1:])
