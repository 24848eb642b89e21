"""Configuration of an evaluation: agent, lanes, simulator and clock."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import Field, model_validator

from uavaccel.envs.flyable import Device, Simulator
from uavaccel.envs.obstacle_lane import LaneTask
from uavaccel.envs.simulators import KERNELS
from uavaccel.files import Plain
from uavaccel.limits import Cost, Games, Processes
from uavaccel.rl.agents import DEFAULT, trained_keys
from uavaccel.sim.lane.layout import EVALUATION_SEEDS
from uavaccel.suites.experiment import Experiment


class EvaluateConfig(Experiment):
    """`suite: evaluate`."""

    suite: Literal["evaluate"] = "evaluate"
    agent: str = DEFAULT
    """Folder of a policy (a training's run directory), `default` (the policy that ships), or a baseline: straight,
    offset:METRES."""
    games: Games = 300
    """How many evaluation lanes are flown."""
    first_lane: Annotated[int, Field(ge=0)] = 0
    """The number of the first evaluation lane."""
    environments: Processes = 1
    """Lanes flown in parallel, with one renderer where there is a GPU; 1 with wall. It does not change the rows."""
    simulator: Simulator = "mujoco"
    """mujoco: exact, rendered with OpenGL; kernels: all lanes as one batch of arrays (docs/kernels.md)."""
    device: Device = "cpu"
    """Where the kernels run: cpu, in threads, or cuda, on one GPU."""
    inference_s: Cost = 0.0005
    """Time of a decision on the simulated wall clock of `virtual`."""
    task: LaneTask = LaneTask(split="evaluation", timing="virtual")
    """Omitted keys are those of the agent's training; those that its network cannot take are refused."""

    @model_validator(mode="after")
    def _lanes_exist(self) -> EvaluateConfig:
        if self.first_lane + self.games > EVALUATION_SEEDS:
            raise ValueError(
                f"first_lane = {self.first_lane} and games = {self.games}: lanes are 0 to {EVALUATION_SEEDS - 1}"
            )
        return self

    @model_validator(mode="after")
    def _kernels_fly_one_batch(self) -> EvaluateConfig:
        if self.simulator == KERNELS and self.environments > 1:
            raise ValueError("environments needs simulator mujoco: the kernels fly all lanes as one batch")
        return self

    @model_validator(mode="after")
    def _timing_allows(self) -> EvaluateConfig:
        if self.task.timing == "wall" and self.environments > 1:
            raise ValueError("environments must be 1 with timing wall: neighbours would disturb the clock")
        return self


def completed(mapping: Mapping[str, Plain]) -> dict[str, Plain]:
    """Return the mapping completed by the keys of its agent's training. Raises UserError if there is no such agent."""
    agent, given = mapping.get("agent", DEFAULT), mapping.get("task") or {}
    if not isinstance(agent, str) or not isinstance(given, Mapping):
        return dict(mapping)  # which validation refuses
    flown = {"split": "evaluation", "timing": "virtual", **trained_keys(agent), **given}
    return {**mapping, "agent": agent, "task": flown}
