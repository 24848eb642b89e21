"""Does the simulated wall clock agree with the machine's? The same games on both, interleaved, quantiles side by side.

Every game is flown three times in turn: on the machine's clock, on the simulated one, and on the machine's again, since
two runs on one clock differ too: their difference is the floor below which no model can be blamed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from uavaccel.bench.square import SquareGame, fly_square
from uavaccel.commands import COMMANDS
from uavaccel.metrics.trajectory import mean_position_rmse
from uavaccel.wire.latency import LatencyConfig
from uavaccel.wire.session import Session, VirtualSession, WallSession

CLOCK_SPEEDS = (50.0, 100.0)
T_MOVES_S = (0.2, 1.0)
ROUNDS = 24
LEVELS = (0.1, 0.5, 0.9)
MEDIAN_WITHIN = 0.20  # of the machine's median
TAIL_FACTOR = 1.5  # of the difference between two runs on the machine's clock

Quantiles = NDArray[np.float64]
OnGame = Callable[[int, int], None]


class Agreement(NamedTuple):
    """One quantity of one cell: its 10, 50 and 90 % quantiles in both runs on the machine's clock, and in the model."""

    command: str
    clock_speed: float
    t_move_s: float
    quantity: str
    wall: Quantiles
    wall_again: Quantiles
    virtual: Quantiles

    @property
    def median_off(self) -> float:
        """Relative difference of the modelled median from the mean of the measured ones; 0 between zeros."""
        measured = float(self.wall[1] + self.wall_again[1]) / 2
        return abs(float(self.virtual[1]) - measured) / measured if measured else abs(float(self.virtual[1]))

    @property
    def agrees(self) -> bool:
        """The median within 20 %, the outer quantiles within 1.5 times the difference between the measured runs."""
        measured, floor = (self.wall + self.wall_again) / 2, abs(self.wall - self.wall_again)
        allowed = np.maximum(TAIL_FACTOR * floor, MEDIAN_WITHIN * measured)
        return self.median_off <= MEDIAN_WITHIN and bool(
            (abs(self.virtual - measured)[[0, 2]] <= allowed[[0, 2]]).all()
        )


def check_agreement(
    latency: LatencyConfig, profile: str, games: int, on_game: OnGame = lambda done, total: None
) -> Iterator[Agreement]:
    """Fly `games` of each command, ClockSpeed and T_move on both clocks; the gap between commands, and the error.

    The gap is simulated seconds between a command's end and the next one's start; the error is each game's RMSE in
    metres against the flight without latency.
    """
    cells = list(product(sorted(COMMANDS), CLOCK_SPEEDS, T_MOVES_S))
    with (
        WallSession("blocks", profile) as wall,
        VirtualSession("blocks", profile, latency) as virtual,
        VirtualSession("blocks", profile) as lockstep,
    ):
        for number, (command, clock_speed, t_move_s) in enumerate(cells):
            flown: list[list[SquareGame]] = [[], [], []]
            for game in range(games):
                sessions: list[Session] = [wall, virtual, wall]
                for session, results in zip(sessions, flown, strict=True):
                    results.append(fly_square(session, command, clock_speed, t_move_s, ROUNDS, game))
                on_game(number * games + game + 1, len(cells) * games)
            ideal = fly_square(lockstep, command, clock_speed, t_move_s, ROUNDS, 0)
            for quantity, values in (("gap s", _gaps), ("error m", _errors)):
                first, model, again = (np.quantile(values(results, ideal), LEVELS) for results in flown)
                yield Agreement(command, clock_speed, t_move_s, quantity, first, again, model)


def _gaps(games: Sequence[SquareGame], ideal: SquareGame) -> NDArray[np.float64]:
    return np.concatenate([game.gap_s for game in games])


def _errors(games: Sequence[SquareGame], ideal: SquareGame) -> NDArray[np.float64]:
    return np.asarray(mean_position_rmse([game.flight for game in games], [ideal.flight]))
