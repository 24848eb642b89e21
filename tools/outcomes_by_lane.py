"""Writes which lanes the policies of a run of the suite `rl` won in real time, a line for each policy and command.

    uavaccel run rl --jobs 4 --out runs/rl
    python -m tools.outcomes_by_lane runs/rl > docs/tables/rl_test_lanes.csv

`won` has a 1 or a 0 for each lane, from `first_lane` of its split on. Seeds that are not complete are left out.
"""

from __future__ import annotations

import sys

from uavaccel.suites.registry import open_run
from uavaccel.suites.rl import KEY, flights_of, where

COLUMNS = ["profile", "command", "clock_speed", "seed", "with", "first_lane", "won", "weights_sha256"]


def main(path: str) -> None:
    run = open_run(path)
    flights = where(flights_of(run.rows(), run.load_arrays), exact=False, at=1.0)
    flights = flights.drop_duplicates([*KEY, "seed", "with"]).sort_values([*KEY, "seed", "with"])
    count = flights.groupby("seed").size()
    lanes = flights.won.map(lambda won: won.sort_index())
    outcomes = lanes.map(lambda won: "".join("01"[each] for each in won))
    flights = flights.assign(first_lane=lanes.map(lambda won: won.index[0]), won=outcomes)
    flights[flights.seed.map(count) == count.max()][COLUMNS].to_csv(sys.stdout, index=False)


if __name__ == "__main__":
    main(sys.argv[1])
