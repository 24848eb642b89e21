"""Cases of the RL experiment, each a training and the evaluations of its policy, and estimates of their cost."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, NotRequired

from typing_extensions import TypedDict

from uavaccel.forms import ArrayForm, Count, NotNegative, Positive
from uavaccel.limits import Games, Seed
from uavaccel.rl.agents import DEFAULT, FLIGHT, SENSES
from uavaccel.suites.experiment import CommandName, ProfileName, Timing
from uavaccel.suites.parts import OUTCOMES, Part, part_simulated_s, part_suite
from uavaccel.suites.rl.config import RlConfig, SimulatedTiming, pairs
from uavaccel.suites.rows import GameRow, Phases

OF_DECISIONS = ("inference_s",)  # keys of a training that also apply to its evaluations
EVALUATION_SEED = 0  # the same lanes and latencies for every policy
EXACT = "exact"  # name of an evaluation in the exact simulator


class TrainingResult(TypedDict):
    """What a row keeps of the summary of its training."""

    games: Games
    successes: Count
    commands: Count
    sim_time_s: NotNegative
    phase_s: Phases
    weights_sha256: str


class EvaluationResult(TypedDict):
    """What a row keeps of the summary of one evaluation."""

    command: CommandName
    clock_speed: Positive
    timing: Timing
    simulator: str
    games: Games
    successes: Count


class RlRow(GameRow):
    """The row of a training with the evaluations of its policy, or of its evaluation in the exact simulator alone."""

    variant: str
    profile: ProfileName
    timing: SimulatedTiming
    command: CommandName
    clock_speed: Positive
    seed: Seed
    training: NotRequired[TrainingResult]
    evaluations: list[EvaluationResult]


ARRAYS = {f"*_{name}": ArrayForm(form.kinds, ("n",)) for name, form in OUTCOMES.items()}
"""The outcomes of each evaluation's lanes, under the name of the flight."""


class Size(NamedTuple):
    """An estimate of what a cell takes."""

    games: int = 0
    simulated_s: float = 0.0


@dataclass(frozen=True)
class TrainingCase:
    """One training of a command at a ClockSpeed with a seed, and the evaluations of its policy."""

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
    """Whether this is no training, but the evaluation of its policy in the exact simulator."""
    size: Size = field(default=Size(), compare=False)

    @property
    def trained(self) -> str:
        names = [self.variant, self.profile, self.clock, self.command, f"{self.clock_speed:g}x"]
        return "-".join([name for name in names if name] + [f"seed{self.seed}"])

    @property
    def id(self) -> str:
        return f"{self.trained}-{EXACT}" if self.exact else self.trained

    def simulated_s(self) -> float:
        return self.size.simulated_s


def cases(config: RlConfig) -> Iterator[TrainingCase]:
    """Yield the cases seed by seed, so that an interrupted run has complete tables of fewer seeds.

    Those of a seed are in the order of the blocks, slow clocks first. The evaluations in the exact simulator follow, in
    the same order.
    """
    for exact, seeds in ((False, config.seeds), (True, min(config.exact_seeds, config.seeds))):
        for seed in range(config.seed, config.seed + seeds):
            for block in config.cells:
                for clock_speed, command in pairs(block):
                    if config.selects(block, (clock_speed, command)):
                        task = {f"task.{key}": value for key, value in block.task.items()}
                        kind = block.variant, block.profile, block.timing, command, clock_speed, seed
                        yield TrainingCase(*kind, task=task, learner=block.training, exact=exact)


def training_part(config: RlConfig, cell: TrainingCase) -> Part:
    """Return the training of a cell."""
    keys = {
        **config.training.keys,
        "games": config.games,
        **_clock_keys(cell, cell.command, cell.clock_speed),
        **cell.task,
        **cell.learner,
    }
    return Part(experiment=config.training.experiment, keys=keys)


def _clock_keys(cell: TrainingCase, command: CommandName, clock_speed: float) -> dict[str, Any]:
    keys = {"command": command, "clock_speed": clock_speed, "timing": cell.clock, "profile": cell.profile}
    return {f"task.{key}": value for key, value in keys.items()}


class Flight(NamedTuple):
    """The command and ClockSpeed of an evaluation."""

    command: CommandName
    clock_speed: float
    name: str
    """The suffix of its folder, and the prefix of its arrays' names."""


def flights(config: RlConfig, cell: TrainingCase) -> list[Flight]:
    """Return the evaluations of a cell: in real time with its own command, then the other, then both as trained."""
    real_time = config.evaluation_clock_speed
    if cell.exact:
        return [Flight(cell.command, real_time, EXACT)]
    commands = [cell.command, other_command(cell.command)] if config.interchange else [cell.command]
    flown = [Flight(command, real_time, command) for command in commands]
    if config.as_trained and cell.clock_speed != real_time:
        flown += [Flight(each, cell.clock_speed, f"{each}-{cell.clock_speed:g}x") for each in commands]
    return flown


def other_command(command: CommandName) -> CommandName:
    return "adsc" if command == "tcsc" else "tcsc"


def evaluation_part(config: RlConfig, cell: TrainingCase, flight: Flight, agent: str | Path) -> Part:
    """Return an evaluation of the cell's policy on the clock of its training, with the policy's own observation."""
    part = config.exact if cell.exact else config.evaluation
    own = {key: value for key, value in cell.task.items() if key.split(".")[1] not in SENSES + FLIGHT}
    keys = {
        **part.keys,
        "agent": str(agent),
        **_clock_keys(cell, flight.command, flight.clock_speed),
        **own,
        **{key: cell.learner[key] for key in OF_DECISIONS if key in cell.learner},
    }
    return Part(experiment=part.experiment, keys=keys)



def _seeded_parts(config: RlConfig, cell: TrainingCase) -> list[tuple[Part, int]]:
    """Return training and evaluations with their seeds; the policy that ships is the placeholder of the cell's own."""
    flown = [evaluation_part(config, cell, flight, DEFAULT) for flight in flights(config, cell)]
    trained = [] if cell.exact else [(training_part(config, cell), cell.seed)]
    return [*trained, *((part, EVALUATION_SEED) for part in flown)]


def part_configs(config: RlConfig, cell: TrainingCase) -> list[Any]:
    """Return the configurations of the cell's training and evaluations. Raises UserError for invalid ones."""
    return [part_suite(part, seed)[1] for part, seed in _seeded_parts(config, cell)]


def size_of(config: RlConfig, cell: TrainingCase) -> Size:
    """Return games and an estimate of the simulated seconds of a cell."""
    games = sum(part.games for part in part_configs(config, cell))
    return Size(games, sum(part_simulated_s(part, seed) for part, seed in _seeded_parts(config, cell)))
