"""Configuration of the experiment: environments, agents and how they were trained, and the delays that they meet."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from uavaccel.config import Config
from uavaccel.limits import Games, Seconds
from uavaccel.suites.experiment import ClockSpeeds, CommandNames, Experiment

DRONES = "uavaccel/"
Delay = Annotated[float, Field(ge=0.0, le=60.0)]
Layers = tuple[Annotated[int, Field(ge=1, le=4096)], ...]


class EnvironmentBlock(Config):
    """A Gymnasium environment, and how long each of its agents is trained."""

    id: str
    """As for gymnasium.make; those of this package keep their own clocks."""
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
        """What its training depends on."""
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
        if len(set(self.latency_s)) < len(self.latency_s):
            raise ValueError(f"latency_s has a latency twice: {list(self.latency_s)}")
        return self

    def delay_s(self, agent: str, latency_s: float) -> float:
        """Wall time for which an agent thinks where others think for `latency_s`."""
        return latency_s * self.agents[agent].latency_factor
