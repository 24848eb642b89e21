"""Configuration of the experiment: environments, agents, their trainings and latencies; and the cases of a run."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from uavaccel.config import Config
from uavaccel.limits import Games, Seconds
from uavaccel.suites.experiment import ClockSpeeds, CommandName, CommandNames, Experiment, Timing

DRONES = "uavaccel/"
OF_THE_CASES = {"timing", "command", "clock_speed"}  # keys of a drone's environment
Delay = Annotated[float, Field(ge=0.0, le=60.0)]
Layers = tuple[Annotated[int, Field(ge=1, le=4096)], ...]


class EnvironmentBlock(Config):
    """A Gymnasium environment, and how long each of its agents is trained."""

    id: str
    """As for gymnasium.make; of "module:Name-v0" the module is one of your own, in the working directory or beside the
    YAML file. Those of this package keep their own clocks."""
    keys: dict[str, Any] = Field(default_factory=dict)
    """Further keywords of gymnasium.make."""
    train_steps: Annotated[int, Field(ge=1, le=1_000_000_000)] = 300_000
    """Decisions, of all parallel environments together."""
    default_action: int | tuple[float, ...] | None = None
    """Applied before the first action; 0 where actions are a Box, and needed where they are not."""
    period_s: Seconds | None = None
    """Simulated seconds of a step, where the environment does not say."""


class AgentBlock(Config):
    """An agent: what it is trained on, what it sees, and how much longer than others it thinks. PPO throughout."""

    training_delay_s: tuple[Delay, Delay] = (0.0, 0.0)
    """Range of simulated seconds from an observation to its action, one drawn for each episode of the training."""
    observe_age: bool = False
    """Whether it sees how old its last observation was when the action was applied."""
    observe_actions: Annotated[int, Field(ge=0, le=64)] = 0
    """How many of its latest actions it sees."""
    chunk: Annotated[int, Field(ge=1, le=64)] = 1
    """Actions that it plans at once, a control period each; the first is applied, the rest while it thinks."""
    look_ahead: bool = False
    """Whether it decides upon what the simulator itself predicts for the moment at which its action is applied."""
    hidden: Layers = (64, 64)
    """Units of its network's layers."""
    latency_factor: Annotated[float, Field(gt=0.0, le=100.0)] = 1.0
    """It thinks so many times the latency of a cell: of a larger network, say."""

    @model_validator(mode="after")
    def _range_rises(self) -> AgentBlock:
        if self.training_delay_s[0] > self.training_delay_s[1]:
            raise ValueError(f"training_delay_s must rise, not {list(self.training_delay_s)}")
        return self

    def training_keys(self) -> dict[str, Any]:
        """Return the keys on which its training depends."""
        return self.model_dump(exclude={"look_ahead", "latency_factor"})


class RealtimeConfig(Experiment):
    """`suite: realtime`."""

    suite: Literal["realtime"]
    timing: Literal["virtual", "wall"] = "virtual"
    """virtual: the wall clock is simulated, and flights repeat; wall: measured, in a process of its own."""
    environments: Annotated[dict[str, EnvironmentBlock], Field(min_length=1)]
    """What is flown, by the names that rows and figures have for it."""
    agents: Annotated[dict[str, AgentBlock], Field(min_length=1)]
    """Who flies it, by the names that rows and figures have for them."""
    latency_s: Annotated[tuple[Delay, ...], Field(min_length=1)] = (0.0, 0.02, 0.05, 0.1, 0.2)
    """Wall time from an observation to its action."""
    clock_speed: ClockSpeeds = (1.0,)
    """Simulated seconds per wall second that are asked for; each value is flown."""
    command: CommandNames = ("adsc", "tcsc")
    """tcsc pauses the simulation while the program works, adsc does not; each value is flown."""
    seeds: Annotated[int, Field(ge=1, le=1000)] = 3
    """Trainings of each agent in each environment."""
    episodes: Games = 10
    """Of each trained agent under each latency, ClockSpeed and command."""

    @model_validator(mode="after")
    def _cases_differ(self) -> RealtimeConfig:
        for name in (*self.environments, *self.agents):
            if not name.replace("_", "").isalnum():
                raise ValueError(f"{name!r} names files: letters, digits and _ alone")
        if self.timing == "wall" and any(agent.look_ahead for agent in self.agents.values()):
            raise ValueError("look_ahead needs timing virtual: it looks into the simulator")
        if self.timing == "wall" and any(block.id.startswith(DRONES) for block in self.environments.values()):
            raise ValueError(
                f"environments of {DRONES[:-1]} keep their own wall clock: their tasks' timing is wall"
            )
        for name, block in self.environments.items():
            if block.id.startswith(DRONES) and (own := sorted(OF_THE_CASES & block.keys.keys())):
                raise ValueError(
                    f"environments.{name}.keys: a drone has {own[0]} of each cell, not of its own"
                )
        if len(set(self.latency_s)) < len(self.latency_s):
            raise ValueError(f"latency_s has a latency twice: {list(self.latency_s)}")
        return self

    def delay_s(self, agent: str, latency_s: float) -> float:
        """Return the wall time for which an agent thinks where others think for `latency_s`."""
        return latency_s * self.agents[agent].latency_factor


EPISODE_S = 20.0  # simulated seconds of an evaluation's episode, about
TRAIN_RATE = 2_500.0  # decisions of a training per wall second, about
EVALUATE_RATE = 40.0  # simulated seconds of an evaluation per wall second, about


@dataclass(frozen=True)
class TrainingCase:
    """A training of an agent."""

    environment: str
    agent: str
    seed: int
    steps: int
    timing: str = "virtual"

    @property
    def id(self) -> str:
        return f"{self.environment}-{self.agent}-s{self.seed}"

    def simulated_s(self) -> float:
        """Return 0: the length of a training's episodes is not known beforehand."""
        return 0.0

    def wall_s(self) -> float:
        return self.steps / TRAIN_RATE


@dataclass(frozen=True)
class EvaluationCase:
    """The evaluation of a trained agent under one latency, ClockSpeed and command."""

    training: TrainingCase
    agent: str
    """Agents whose trainings do not differ share the one of the first of them."""
    latency_s: float
    clock_speed: float
    command: CommandName
    timing: Timing
    episodes: int

    @property
    def environment(self) -> str:
        return self.training.environment

    @property
    def seed(self) -> int:
        return self.training.seed

    @property
    def id(self) -> str:
        trained = f"{self.environment}-{self.agent}-s{self.seed}"
        return f"{trained}-{self.command}-{self.latency_s * 1e3:g}ms-{self.clock_speed:g}x"

    def simulated_s(self) -> float:
        return self.episodes * EPISODE_S

    def wall_s(self) -> float:
        return self.simulated_s() / (self.clock_speed if self.timing == "wall" else EVALUATE_RATE)


def cases(config: RealtimeConfig) -> Iterator[TrainingCase | EvaluationCase]:
    """Yield all trainings, then all evaluations. Under TCSC delays change nothing: one latency stands for all."""
    known: dict[tuple[str, str], list[TrainingCase]] = {}
    pairs = list(product(config.environments, config.agents))
    for environment, agent in pairs:
        if trained_as(config, environment, agent) == agent:
            steps = config.environments[environment].train_steps
            known[environment, agent] = [
                TrainingCase(environment, agent, seed, steps) for seed in range(config.seeds)
            ]
            yield from known[environment, agent]
    for environment, agent in pairs:
        for training in known.get((environment, trained_as(config, environment, agent)), ()):
            yield from _evaluations(config, training, agent)


def _evaluations(config: RealtimeConfig, training: TrainingCase, agent: str) -> Iterator[EvaluationCase]:
    for command in config.command:
        latencies_s = config.latency_s if command == "adsc" else config.latency_s[-1:]
        for latency_s, speed in product(latencies_s, config.clock_speed):
            yield EvaluationCase(training, agent, latency_s, speed, command, config.timing, config.episodes)


def trained_as(config: RealtimeConfig, environment: str, agent: str) -> str:
    """Return the first agent with the same training in the environment; empty where the agent cannot fly there."""
    if not flies(config, environment, agent):
        return ""
    training = config.agents[agent].training_keys()
    return next(
        other
        for other, block in config.agents.items()
        if block.training_keys() == training and flies(config, environment, other)
    )


def flies(config: RealtimeConfig, environment: str, agent: str) -> bool:
    """Return whether an agent can fly there: a drone takes no chunks, and has no model to look ahead with."""
    block = config.agents[agent]
    drone = config.environments[environment].id.startswith(DRONES)
    return not (drone and (block.chunk > 1 or block.look_ahead))
