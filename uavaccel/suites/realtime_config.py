"""The configuration of the suite `realtime`: environments, flights, agents, and the cells that they make."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, field_validator, model_validator

from uavaccel.config import Config, Games, Seconds
from uavaccel.draw.page import listed
from uavaccel.realtime.policies import TCP
from uavaccel.suites.experiment import ClockSpeeds, CommandNames, Experiment
from uavaccel.suites.parts import Part

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
    scale: tuple[float, float] | None = None
    """Returns that have score 0 and score 1; None: there are no scores."""

    @field_validator("scale")
    @classmethod
    def _scale_rises(cls, scale: tuple[float, float] | None) -> tuple[float, float] | None:
        if scale is not None and not scale[0] < scale[1]:
            raise ValueError(f"must rise, not {list(scale)}")
        return scale


class FlightBlock(Config):
    """A task of this package whose agents `uavaccel train` trains; return and score are 1 for a game won, else 0."""

    trainings: Annotated[dict[str, Part], Field(min_length=1)]
    """By the agent: the experiment of its training, and keys that differ from it. Other agents do not fly it."""
    evaluation: Part = Part(experiment="evaluate", keys={"simulator": "kernels", "games": 100})
    """How each is evaluated: its `inference_s`, command and ClockSpeed are those of a cell."""


class AgentBlock(Config):
    """An agent: what it is trained on, what it sees, and how much longer than others it thinks.

    It is trained by PPO, unless it has policies of its own.
    """

    policies: dict[str, str] = Field(default_factory=dict)
    """Files with what it is, by the environment, which it flies without a training: .zip of stable-baselines3, .onnx,
    .pt of TorchScript, or file.py:function. It flies no others."""

    training_delay_s: tuple[Delay, Delay] = (0.0, 0.0)
    """Range of simulated seconds from an observation to its action, one drawn for each episode of the training."""
    observe_age: bool = False
    """Whether it sees how old its last observation was when the action was applied."""
    observe_actions: Annotated[int, Field(ge=0, le=64)] = 0
    """How many of its latest actions it sees."""
    chunk: Annotated[int, Field(ge=1, le=64)] = 1
    """Actions that it plans at once, a control period each; the first is applied, the rest while it thinks."""
    frozen_prefix: bool = False
    """Whether a chunk begins at its observation: its actions for the periods until it arrives are dropped."""
    observe_planned: Annotated[int, Field(ge=0, le=64)] = 0
    """Of how many next periods it sees the actions that are applied unless others arrive."""
    look_ahead: bool = False
    """Whether it decides upon what the simulator itself predicts for the moment at which its action is applied."""
    hidden: Layers = (64, 64)
    """Units of its network's layers."""
    latency_factor: Annotated[float, Field(gt=0.0, le=100.0)] = 1.0
    """It thinks so many times the latency of a cell: of a larger network, say."""

    @field_validator("policies")
    @classmethod
    def _policies_are_files(cls, policies: dict[str, str]) -> dict[str, str]:
        if servers := [place for place in policies.values() if place.startswith(TCP)]:
            raise ValueError(f"{servers[0]}: no server, whose answers nobody can repeat; name a file")
        return policies

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
    flights: dict[str, FlightBlock] = Field(default_factory=dict)
    """Tasks of this package that are learned by `uavaccel train`, by the names that rows and figures have for them."""
    environments: Annotated[dict[str, EnvironmentBlock], Field(min_length=1)]
    """What else is flown, by the names that rows and figures have for it."""
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
    """Of each trained agent under each latency, ClockSpeed and command; flights have the games of their evaluation."""
    cells: tuple[str, ...] = ()
    """Fly these cells alone, and the trainings that they need: names such as hopper-naive-adsc-20ms-5x, in which * is
    anything; without any, all."""

    @model_validator(mode="after")
    def _flights_fit(self) -> RealtimeConfig:
        if self.flights and self.timing == "wall":
            raise ValueError("flights need timing virtual: their clock is simulated")
        if both := sorted(self.flights.keys() & self.environments.keys()):
            raise ValueError(f"flights.{both[0]}: one of the environments has the same name")
        for name, flight in self.flights.items():
            if unknown := [agent for agent in flight.trainings if agent not in self.agents]:
                raise ValueError(f"flights.{name}.trainings: {unknown[0]} is none of the agents, {listed(self.agents)}")
        return self

    @model_validator(mode="after")
    def _cases_differ(self) -> RealtimeConfig:
        for name in (*self.flights, *self.environments, *self.agents):
            if not name.replace("_", "").isalnum():
                raise ValueError(f"{name!r} names files: letters, digits and _ alone")
        for name, agent in self.agents.items():
            if unknown := sorted(agent.policies.keys() - self.environments.keys()):
                raise ValueError(f"agents.{name}.policies: {unknown[0]} is none of the environments")
        if self.timing == "wall" and any(agent.look_ahead for agent in self.agents.values()):
            raise ValueError("look_ahead needs timing virtual: it looks into the simulator")
        if self.timing == "wall" and any(block.id.startswith(DRONES) for block in self.environments.values()):
            raise ValueError(f"environments of {DRONES[:-1]} keep their own wall clock: their tasks' timing is wall")
        for name, block in self.environments.items():
            if block.id.startswith(DRONES) and (own := sorted(OF_THE_CASES & block.keys.keys())):
                raise ValueError(f"environments.{name}.keys: a drone has {own[0]} of each cell, not of its own")
        if len(set(self.latency_s)) < len(self.latency_s):
            raise ValueError(f"latency_s has a latency twice: {list(self.latency_s)}")
        return self

    def delay_s(self, agent: str, latency_s: float) -> float:
        """Return the wall time for which an agent thinks where others think for `latency_s`."""
        return latency_s * self.agents[agent].latency_factor

    def scale(self, name: str) -> tuple[float, float] | None:
        """Return the returns that have score 0 and 1 in a flight or an environment; None where there are no scores."""
        return (0.0, 1.0) if name in self.flights else self.environments[name].scale

    def flies(self, environment: str, agent: str) -> bool:
        """Return whether an agent can fly there: a drone takes no chunks, and has no model to look ahead with."""
        block, drone = self.agents[agent], self.environments[environment].id.startswith(DRONES)
        there = not block.policies or environment in block.policies
        return there and not (drone and (block.chunk > 1 or block.look_ahead))

    def trained_as(self, environment: str, agent: str) -> str:
        """Return the first agent with the same training there that can fly there."""
        if environment in self.flights:
            return agent
        training = self.agents[agent].training_keys()
        others = (other for other in self.agents if self.flies(environment, other))
        return next(other for other in others if self.agents[other].training_keys() == training)
