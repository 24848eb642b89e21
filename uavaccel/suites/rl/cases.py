"""A cell of the experiment: a training, and the evaluations of its policy, each a run directory of its own."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from uavaccel.rl.agents import FLIGHT, SENSES
from uavaccel.suites.experiment import CommandName, ProfileName
from uavaccel.suites.parts import Part
from uavaccel.suites.rl.config import RlConfig, SimulatedTiming, pairs

OF_DECISIONS = ("inference_s",)  # keys of a training that its evaluations have too
EVALUATION_SEED = 0  # the same lanes and latencies for every policy
EXACT = "exact"  # what an evaluation in the exact simulator is called


class Size(NamedTuple):
    """About how much a cell is."""

    games: int = 0
    simulated_s: float = 0.0
    wall_s: float = 0.0
    disk_bytes: float = 0.0


@dataclass(frozen=True)
class TrainingCase:
    """One training of a command at a ClockSpeed, by its seed, and what is flown with it."""

    variant: str
    profile: ProfileName
    clock: SimulatedTiming
    command: CommandName
    clock_speed: float
    seed: int
    timing: str = "virtual"  # all cells run side by side, whichever simulated clock they have
    task: dict[str, Any] = field(default_factory=dict, compare=False)
    learner: dict[str, Any] = field(default_factory=dict, compare=False)
    exact: bool = False
    """Whether this is no training, but the exact simulator's evaluation of what it gave."""
    size: Size = field(default=Size(), compare=False)

    @property
    def trained(self) -> str:
        """Name of the training."""
        names = [self.variant, self.profile, self.clock, self.command, f"{self.clock_speed:g}x"]
        return "-".join([name for name in names if name] + [f"seed{self.seed}"])

    @property
    def id(self) -> str:
        return f"{self.trained}-{EXACT}" if self.exact else self.trained

    def simulated_s(self) -> float:
        return self.size.simulated_s


def cases(config: RlConfig) -> Iterator[TrainingCase]:
    """Seed by seed, so that a run that is stopped has whole tables; in each the blocks in order, slow clocks first.

    The exact simulator's evaluations follow, in the same order.
    """
    for exact, seeds in ((False, config.seeds), (True, min(config.exact_seeds, config.seeds))):
        for seed in range(config.seed, config.seed + seeds):
            for block in config.cells:
                for clock_speed, command in pairs(block):
                    if config.selects(block, (clock_speed, command)):
                        yield TrainingCase(
                            block.variant,
                            block.profile,
                            block.timing,
                            command,
                            clock_speed,
                            seed,
                            task={f"task.{key}": value for key, value in block.task.items()},
                            learner=block.training,
                            exact=exact,
                        )


def training_part(config: RlConfig, cell: TrainingCase) -> Part:
    """The cell's training."""
    keys = {
        **config.training.keys,
        "games": config.games,
        "task.command": cell.command,
        "task.clock_speed": cell.clock_speed,
        "task.timing": cell.clock,
        "task.profile": cell.profile,
        **cell.task,
        **cell.learner,
    }
    return Part(experiment=config.training.experiment, keys=keys)


class Flight(NamedTuple):
    """How a policy is evaluated."""

    command: CommandName
    clock_speed: float
    name: str
    """Of its folder, and before the names of its arrays."""


def flights(config: RlConfig, cell: TrainingCase) -> list[Flight]:
    """In real time first, with the cell's own command and then the other; as it was trained, in that order too."""
    real_time = config.evaluation_clock_speed
    if cell.exact:
        return [Flight(cell.command, real_time, EXACT)]
    commands = [cell.command, other_command(cell.command)] if config.interchange else [cell.command]
    flown = [Flight(command, real_time, command) for command in commands]
    if config.as_trained and cell.clock_speed != real_time:
        flown += [Flight(each, cell.clock_speed, f"{each}-{cell.clock_speed:g}x") for each in commands]
    return flown


def other_command(command: CommandName) -> CommandName:
    """Of the two the one that it is not."""
    return "adsc" if command == "tcsc" else "tcsc"


def evaluation_part(config: RlConfig, cell: TrainingCase, flight: Flight, agent: str | Path) -> Part:
    """A flight of the cell's policy, on the clock that it was trained by; what it sees is the policy's own affair."""
    part = config.exact if cell.exact else config.evaluation
    own = {key: value for key, value in cell.task.items() if key.split(".")[1] not in SENSES + FLIGHT}
    keys = {
        **part.keys,
        "agent": str(agent),
        "task.command": flight.command,
        "task.clock_speed": flight.clock_speed,
        "task.timing": cell.clock,
        "task.profile": cell.profile,
        **own,
        **{key: cell.learner[key] for key in OF_DECISIONS if key in cell.learner},
    }
    return Part(experiment=part.experiment, keys=keys)
