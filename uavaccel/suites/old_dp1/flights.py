"""DP1's games: which are flown, in canonical order, how one is flown, and what is recorded of it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from uavaccel.commands import COMMANDS
from uavaccel.commands.paths import velocities
from uavaccel.forms import ArrayForm, Count, Positive
from uavaccel.kinematics import Vector, VelocityGoal
from uavaccel.suites.experiment import t_th_ns
from uavaccel.suites.old_dp1.config import Dp1Config, Path
from uavaccel.suites.rows import FlightCase, FlightRow, flight_row, named_seed
from uavaccel.units import NS_PER_S

if TYPE_CHECKING:  # they load the simulation
    from uavaccel.wire.client import Client
    from uavaccel.wire.session import Session

SCENE = "blocks"


@dataclass(frozen=True)
class Case(FlightCase):
    """One game; beside "reference" (ADSC at 1x), "lockstep" and "game" its role may be "figure2"."""

    t_move_s: float
    rounds: int
    game: int
    path: Path | tuple[Vector, ...]

    @property
    def id(self) -> str:
        return f"{super().id}-t{self.t_move_s:g}-r{self.rounds}-g{self.game:02d}"

    def simulated_s(self) -> float:
        """Return the simulated time of the commands, without gaps between them."""
        return self.t_move_s * len(velocities(self.path, self.rounds))

    def seed(self, run_seed: int) -> np.random.SeedSequence:
        """Return the game's own seed, which references and games of one cell have in common."""
        name = f"{self.command} {self.clock_speed:g} {self.t_move_s:g} {self.rounds} {self.game} {self.path}"
        return named_seed(run_seed, name)


class Dp1Row(FlightRow):
    """The row of a game of DP1."""

    t_move_s: Positive
    rounds: Count
    game: Count
    commands: Count
    samples_dropped: Count


ARRAYS = {
    "time_s": ArrayForm("f8", ("samples",), ascends=True),
    "position_m": ArrayForm("f8", ("samples", 3)),
    "orientation_wxyz": ArrayForm("f8", ("samples", 4)),
    "linear_velocity_m_s": ArrayForm("f8", ("samples", 3)),
    "angular_velocity_rad_s": ArrayForm("f8", ("samples", 3)),
    "command_start_s": ArrayForm("f8", ("commands",), ascends=True),
    "command_end_s": ArrayForm("f8", ("commands",), ascends=True),
}
"""What `fly_game` records, as `Recording.arrays` makes it."""


def cases(config: Dp1Config) -> Iterator[Case]:
    """Yield every game of a run in canonical order: references, lockstep, the grid, Figure 2."""
    baseline = ("adsc", 1.0, config.reference_timing)
    grid = list(product(config.command, config.clock_speed, [config.timing]))
    paths = list(product(config.t_move_s, config.rounds))
    if baseline not in grid:
        for path, game in product(paths, range(config.reference_games)):
            yield Case("reference", "adsc", 1.0, config.reference_timing, *path, game, config.path)
    for path in paths:
        yield Case("lockstep", "tcsc", 1.0, "lockstep", *path, 0, config.path)
    for cell, path, game in product(grid, paths, range(config.games)):
        yield Case("reference" if cell == baseline else "game", *cell, *path, game, config.path)
    real_time, fastest = (1.0, config.reference_timing), (max(config.clock_speed), config.timing)
    for game, flown_at in enumerate((real_time, fastest)):
        yield Case("figure2", "adsc", *flown_at, max(config.t_move_s), 1, game, "two_forward_one_back")


def fly_game(config: Dp1Config, case: Case, session: Session) -> tuple[Dp1Row, dict[str, np.ndarray]]:
    """Fly one game, and return its row, without the arrays' path, and its arrays."""
    client = session.start_game(case.clock_speed, case.seed(config.seed))
    wall_s = fly_path(config, case, client)
    shared, recording = flight_row(case, config, client, wall_s)
    row: Dp1Row = {
        **shared,  # type: ignore[typeddict-item]
        "t_move_s": case.t_move_s,
        "rounds": case.rounds,
        "game": case.game,
        "commands": len(recording.commands),
        "samples_dropped": recording.dropped,
    }
    return row, recording.arrays()


def fly_path(config: Dp1Config, case: Case, client: Client) -> float:
    """Fly the case's path, and return the seconds of wall time from the first issue to the last return."""
    command, t_sample_s = COMMANDS[case.command], config.t_sample_s or case.t_move_s
    t_th = t_th_ns(config, case.clock_speed, t_sample_s)
    command.begin(client)
    start_ns = client.now_ns()
    for velocity in velocities(case.path, case.rounds, config.speed_m_s):
        goal = VelocityGoal(velocity, config.height_m)
        for _ in command.fly(client, goal, case.t_move_s, t_sample_s, t_th):
            pass
    return (client.now_ns() - start_ns) / NS_PER_S
