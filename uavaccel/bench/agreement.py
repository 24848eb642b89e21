"""The agreement of the simulated wall clock with the machine's: quantiles of the same games on both.

Each game is flown on the machine's clock, on the simulated one, and on the machine's again, as two measured runs differ
too: their difference is the floor of what a model can be blamed for.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavaccel.bench.square import fly_square
from uavaccel.commands import COMMANDS
from uavaccel.metrics.trajectory import mean_position_rmse
from uavaccel.wire.latency import LatencyConfig
from uavaccel.wire.session import Session, VirtualSession, WallSession

CLOCK_SPEEDS = (50.0, 100.0)
T_MOVES_S = (0.2, 1.0)
ROUNDS = 24
LEVELS = (0.1, 0.5, 0.9)
MEDIAN_WITHIN = 0.20  # relative to the measured median
TAIL_FACTOR = 1.5  # relative to the difference between the two measured runs

Quantiles = NDArray[np.float64]


class Agreement(NamedTuple):
    """The 10, 50 and 90 % quantiles of one quantity in one cell, in both measured runs and in the model."""

    command: str
    clock_speed: float
    t_move_s: float
    quantity: str
    wall: Quantiles
    wall_again: Quantiles
    virtual: Quantiles

    @property
    def median_off(self) -> float:
        """The relative difference of the modelled median from the mean of the measured ones; 0 between zeros."""
        measured = float(self.wall[1] + self.wall_again[1]) / 2
        return abs(float(self.virtual[1]) - measured) / measured if measured else abs(float(self.virtual[1]))

    @property
    def agrees(self) -> bool:
        """Whether the median agrees within 20 %, the outer quantiles within 1.5 times the measured difference."""
        measured, floor = (self.wall + self.wall_again) / 2, abs(self.wall - self.wall_again)
        allowed = np.maximum(TAIL_FACTOR * floor, MEDIAN_WITHIN * measured)
        return self.median_off <= MEDIAN_WITHIN and bool(
            (abs(self.virtual - measured)[[0, 2]] <= allowed[[0, 2]]).all()
        )


def check_agreement(latency: LatencyConfig, profile: str, games: int) -> Iterator[Agreement]:
    """Fly `games` of each command, ClockSpeed and T_move on both clocks, and yield the agreement of gaps and errors.

    A gap is the simulated time in seconds between two commands, an error the RMSE in metres of a game against the
    flight without latency.
    """
    with (
        WallSession("blocks", profile) as wall,
        VirtualSession("blocks", profile, latency) as virtual,
        VirtualSession("blocks", profile) as lockstep,
    ):
        sessions: list[Session] = [wall, virtual, wall]
        for cell in product(sorted(COMMANDS), CLOCK_SPEEDS, T_MOVES_S):
            games_on_all = [
                [fly_square(session, *cell, ROUNDS, game) for session in sessions] for game in range(games)
            ]
            ideal = fly_square(lockstep, *cell, ROUNDS, 0).flight
            flown = list(zip(*games_on_all, strict=True))
            gaps = [np.concatenate([game.gap_s for game in results]) for results in flown]
            errors = [mean_position_rmse([game.flight for game in results], [ideal]) for results in flown]
            for quantity, values in (("gap s", gaps), ("error m", errors)):
                first, model, again = (np.quantile(each, LEVELS) for each in values)
                yield Agreement(*cell, quantity, first, again, model)
