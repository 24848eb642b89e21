"""DP2's games in canonical order, and the path that they fly."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TypedDict

import numpy as np

from uavaccel.sim.lane.path import plan_path
from uavaccel.suites.dp2.config import Dp2Config, Velocity
from uavaccel.suites.experiment import CommandName, Timing
from uavaccel.suites.report import GameRow


@dataclass(frozen=True)
class Case:
    """One game. `role`: "reference" (at 1x, its images clean), "lockstep" (TCSC without latency) or "game"."""

    role: str
    command: CommandName
    clock_speed: float
    timing: Timing
    planned_s: float

    @property
    def id(self) -> str:
        prefix = "" if self.role == "game" else f"{self.role}-"
        return f"{prefix}{self.command}-k{self.clock_speed:g}"

    def simulated_s(self) -> float:
        """Simulated time of the commands, without gaps between them."""
        return self.planned_s

    def seed(self, run_seed: int) -> np.random.SeedSequence:
        """The game's own generator: the same in any subset of a run, and in any order."""
        return np.random.SeedSequence(run_seed, spawn_key=(zlib.crc32(self.id.encode()),))


class Dp2Collision(TypedDict):
    """What a flight hit: seconds since the start, and NED."""

    object: str
    time_s: float
    position_m: list[float]


class Dp2Row(GameRow):
    """What is kept of a game beside its arrays."""

    role: str
    command: CommandName
    clock_speed: float
    t_move_s: float
    t_sample_s: float
    timing: Timing
    profile: str
    seed: int
    commands: int
    planned_commands: int
    samples: int
    distance_m: float
    collision: Dp2Collision | None
    guard_retries: int
    wall_s: float
    sim_time_s: float
    duration_s: float
    real_time_factor: float
    error: str | None
    """What ended the flight, if anything did."""


def cases(config: Dp2Config) -> Iterator[Case]:
    """Every game of a run in canonical order: references, lockstep, games."""
    planned_s = len(velocities(config)) * config.t_move_s
    grid = [(command, clock_speed) for command in config.command for clock_speed in config.clock_speed]
    clean = config.perturbation.share == 0
    flown_anyway = {command for command, clock_speed in grid if clock_speed == 1.0} if clean else set()
    if config.timing != config.reference_timing:
        flown_anyway = set()
    for command in config.command:
        if command not in flown_anyway:
            yield Case("reference", command, 1.0, config.reference_timing, planned_s)
    yield Case("lockstep", "tcsc", 1.0, "lockstep", planned_s)
    for command, clock_speed in grid:
        role = "reference" if clock_speed == 1.0 and command in flown_anyway else "game"
        yield Case(role, command, clock_speed, config.timing, planned_s)


def velocities(config: Dp2Config) -> tuple[Velocity, ...]:
    """One velocity a command: north, east, m/s. Raises UserError where no path is free."""
    if config.path != "planned":
        return config.path
    key = config.model_dump_json(include={"lane", "height_m", "t_move_s"})
    if key not in _planned:
        _planned[key] = tuple(plan_path(config.layout(), -config.height_m, command_s=config.t_move_s))
    return _planned[key]


_planned: dict[str, tuple[Velocity, ...]] = {}
