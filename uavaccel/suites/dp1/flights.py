"""DP1: trajectory accuracy and speed on a square path (paper, sections III-C2a and IV-B).

A suite is a configuration, its cases in canonical order, and `run_case`, which flies one.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from typing import Any, Literal

import numpy as np
from pydantic import field_validator, model_validator

from uavaccel.commands import COMMANDS
from uavaccel.commands.paths import PATHS, velocities
from uavaccel.commands.slices import samples_due
from uavaccel.kinematics import Vector, VelocityGoal
from uavaccel.sim.profile import PROFILES
from uavaccel.suites.experiment import CommandName, Experiment, Timing, positive, t_th_ns
from uavaccel.units import NS_PER_S
from uavaccel.wire.client import Client
from uavaccel.wire.session import Session

SCENE = "blocks"
Path = Literal["square", "two_forward_one_back"]


class Dp1Config(Experiment):
    """`suite: dp1`."""

    suite: Literal["dp1"]
    path: Path | tuple[tuple[float, float, float], ...] = "square"
    """A named path, or velocities of one's own: one command each, NED in m/s."""
    speed_m_s: float = 1.0
    """Of a named path."""
    height_m: float | None = None
    """NED z to hold, as moveByVelocityZ does; none: plain moveByVelocity, as in the paper."""
    rounds: tuple[int, ...] = (1, 2, 4, 8, 16, 24)
    t_move_s: tuple[float, ...] = (0.1, 0.2, 0.5, 1.0)
    t_sample_s: float | None = None
    """How often the client gathers the state itself; none: once a command, the server's recorder samples."""
    games: int = 20
    """A cell: command, ClockSpeed, T_move and rounds."""
    reference_games: int = 20
    """Real-time ADSC games of each T_move and rounds, unless the run flies that cell anyway."""
    reference_timing: Timing = "virtual"

    @field_validator("rounds", "t_move_s")
    @classmethod
    def _above_zero(cls, values: tuple[float, ...]) -> tuple[float, ...]:
        return positive(values)

    @field_validator("games", "reference_games", "speed_m_s", "t_sample_s")
    @classmethod
    def _one_above_zero(cls, value: float | None) -> float | None:
        return None if value is None else positive((value,))[0]

    @field_validator("path")
    @classmethod
    def _not_empty(cls, path: Any) -> Any:
        if not path:
            raise ValueError(f"needs at least one velocity, or one of {', '.join(PATHS)}")
        return path

    @model_validator(mode="after")
    def _times_fit(self) -> Dp1Config:
        for t_move_s in self.t_move_s:
            PROFILES[self.profile].check_duration(t_move_s, "t_move_s")
            if self.t_sample_s is not None:
                check_samples(self.profile, t_move_s, self.t_sample_s)
        return self


def check_samples(profile: str, t_move_s: float, t_sample_s: float) -> None:
    """Raise UserError where a sample's slice is no whole number of ticks and the profile refuses that."""
    if PROFILES[profile].exact_times:
        for due_ns in samples_due(t_move_s, t_sample_s):
            PROFILES[profile].check_duration(due_ns / NS_PER_S, "t_sample_s")


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


def run_case(config: Dp1Config, case: Case, session: Session) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Fly one game: its row, without the arrays' path, and its arrays."""
    client = session.start_game(case.clock_speed, case.seed(config.seed))
    wall_s = fly(config, case, client)
    speed, recording = client.speed(), client.recording()
    tick_s = recording.tick_ns / NS_PER_S
    row = {
        "suite": "dp1",
        "case": case.id,
        "role": case.role,
        "command": case.command,
        "clock_speed": case.clock_speed,
        "t_move_s": case.t_move_s,
        "rounds": case.rounds,
        "game": case.game,
        "timing": case.timing,
        "profile": config.profile,
        "seed": config.seed,
        "commands": len(recording.commands),
        "samples_dropped": recording.dropped,
        "wall_s": wall_s,
        "sim_time_s": speed["simulated_ns"] / NS_PER_S,
        "duration_s": round(int(recording.commands[-1, 1]) * tick_s, 9),
        "real_time_factor": speed["real_time_factor"],
        "lost_wall_s": speed["lost_wall_ns"] / NS_PER_S,
        "error": speed["failure"],
    }
    return row, recording.arrays()


def fly(config: Dp1Config, case: Case, client: Client) -> float:
    """Fly the case's path; seconds of wall time from the first issue to the last return."""
    command = COMMANDS[case.command]
    t_sample_s = config.t_sample_s or case.t_move_s
    t_th = t_th_ns(config, case.clock_speed, t_sample_s)
    command.begin(client)
    start_ns = client.now_ns()
    for velocity in velocities(case.path, case.rounds, config.speed_m_s):
        for _ in command.fly(
            client, VelocityGoal(velocity, config.height_m), case.t_move_s, t_sample_s, t_th
        ):
            pass
    return (client.now_ns() - start_ns) / NS_PER_S
