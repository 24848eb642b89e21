"""DP1's games: what is flown, in canonical order."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np

from uavaccel.commands.paths import velocities
from uavaccel.kinematics import Vector
from uavaccel.suites.dp1.config import Dp1Config, Path
from uavaccel.suites.experiment import CommandName, Timing
from uavaccel.suites.report import GameRow


@dataclass(frozen=True)
class Case:
    """One game. `role`: "reference" (ADSC at 1x), "lockstep", "figure2" or plain "game"."""

    role: str
    command: CommandName
    clock_speed: float
    t_move_s: float
    rounds: int
    game: int
    timing: Timing
    path: Path | tuple[Vector, ...]

    @property
    def id(self) -> str:
        prefix = "" if self.role == "game" else f"{self.role}-"
        return (
            f"{prefix}{self.command}-k{self.clock_speed:g}-t{self.t_move_s:g}-r{self.rounds}-g{self.game:02d}"
        )

    def simulated_s(self) -> float:
        """Simulated time of the commands, without gaps between them."""
        return self.t_move_s * len(velocities(self.path, self.rounds))

    def seed(self, run_seed: int) -> np.random.SeedSequence:
        """The game's own generator: the same in any subset of a run, and in any order."""
        name = f"{self.command} {self.clock_speed:g} {self.t_move_s:g} {self.rounds} {self.game} {self.path}"
        return np.random.SeedSequence(run_seed, spawn_key=(zlib.crc32(name.encode()),))


class Dp1Row(GameRow):
    """What is kept of a game beside its arrays."""

    role: str
    command: CommandName
    clock_speed: float
    t_move_s: float
    rounds: int
    game: int
    timing: Timing
    profile: str
    seed: int
    commands: int
    samples_dropped: int
    wall_s: float
    sim_time_s: float
    duration_s: float
    """Simulated, from the first command's start to the last one's end."""
    real_time_factor: float
    error: str | None
    """What ended the flight, if anything did."""


def cases(config: Dp1Config) -> Iterator[Case]:
    """Every game of a run in canonical order: references, lockstep, the grid, Figure 2."""
    baseline = ("adsc", 1.0, config.reference_timing)
    grid = list(product(config.command, config.clock_speed, [config.timing]))
    paths = list(product(config.t_move_s, config.rounds))
    if baseline not in grid:
        for (t_move_s, rounds), game in product(paths, range(config.reference_games)):
            yield Case("reference", "adsc", 1.0, t_move_s, rounds, game, config.reference_timing, config.path)
    for t_move_s, rounds in paths:
        yield Case("lockstep", "tcsc", 1.0, t_move_s, rounds, 0, "lockstep", config.path)
    for cell, (t_move_s, rounds), game in product(grid, paths, range(config.games)):
        role = "reference" if cell == baseline else "game"
        yield Case(role, cell[0], cell[1], t_move_s, rounds, game, cell[2], config.path)
    for game, (clock_speed, timing) in enumerate(
        [(1.0, config.reference_timing), (max(config.clock_speed), config.timing)]
    ):
        yield Case(
            "figure2", "adsc", clock_speed, max(config.t_move_s), 1, game, timing, "two_forward_one_back"
        )
