"""Cases of the experiment: each training, then what its agent meets."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from uavaccel.suites.realtime.config import DRONES, RealtimeConfig

EPISODE_S = 20.0  # simulated seconds of an evaluation's episode, about
TRAIN_RATE = 2_500.0  # decisions of a training per wall second, about
EVALUATE_RATE = 40.0  # simulated seconds of an evaluation per wall second, about


@dataclass(frozen=True)
class TrainingCase:
    """One training of an agent."""

    environment: str
    agent: str
    seed: int
    steps: int
    timing: str = "virtual"

    @property
    def id(self) -> str:
        """Environment, agent and seed."""
        return f"{self.environment}-{self.agent}-s{self.seed}"

    def simulated_s(self) -> float:
        """Not known before it is trained."""
        return 0.0

    def wall_s(self) -> float:
        """What it takes on one core, about."""
        return self.steps / TRAIN_RATE


@dataclass(frozen=True)
class EvaluationCase:
    """One trained agent under one latency, ClockSpeed and command."""

    training: TrainingCase
    agent: str
    """Whose training may be another agent's, if they differ in nothing that is trained."""
    latency_s: float
    clock_speed: float
    command: str
    timing: str
    episodes: int

    @property
    def environment(self) -> str:
        return self.training.environment

    @property
    def seed(self) -> int:
        return self.training.seed

    @property
    def id(self) -> str:
        """The training's, and what is met."""
        trained = f"{self.environment}-{self.agent}-s{self.seed}"
        return f"{trained}-{self.command}-{self.latency_s * 1e3:g}ms-{self.clock_speed:g}x"

    def simulated_s(self) -> float:
        return self.episodes * EPISODE_S

    def wall_s(self) -> float:
        """What it takes on one core, about."""
        return self.simulated_s() / (self.clock_speed if self.timing == "wall" else EVALUATE_RATE)


def cases(config: RealtimeConfig) -> Iterator[TrainingCase | EvaluationCase]:
    """All trainings, then all evaluations. Under TCSC delays change nothing: one latency stands for all."""
    known: dict[tuple[str, str], list[TrainingCase]] = {}
    for environment, block in config.environments.items():
        for agent in config.agents:
            trained = trained_as(config, environment, agent)
            if trained == agent:
                known[environment, agent] = [
                    TrainingCase(environment, agent, seed, block.train_steps) for seed in range(config.seeds)
                ]
                yield from known[environment, agent]
    for environment in config.environments:
        for agent in config.agents:
            for training in known.get((environment, trained_as(config, environment, agent)), ()):
                yield from _evaluations(config, training, agent)


def _evaluations(config: RealtimeConfig, training: TrainingCase, agent: str) -> Iterator[EvaluationCase]:
    for command in config.command:
        for latency_s in config.latency_s if command == "adsc" else config.latency_s[-1:]:
            for speed in config.clock_speed:
                yield EvaluationCase(
                    training, agent, latency_s, speed, command, config.timing, config.episodes
                )


def trained_as(config: RealtimeConfig, environment: str, agent: str) -> str:
    """The first agent whose training in the environment is the same; empty where the agent does not fly there."""
    if not flies(config, environment, agent):
        return ""
    training = config.agents[agent].training_keys()
    return next(
        other
        for other, block in config.agents.items()
        if block.training_keys() == training and flies(config, environment, other)
    )


def flies(config: RealtimeConfig, environment: str, agent: str) -> bool:
    """A drone's position hold takes no chunks, and only MuJoCo's environments have a model to look ahead with."""
    block = config.agents[agent]
    drone = config.environments[environment].id.startswith(DRONES)
    return not (drone and (block.chunk > 1 or block.look_ahead))
