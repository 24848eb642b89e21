"""Configuration of a learner: the task, the algorithm and how long."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from uavaccel.config import Config
from uavaccel.envs.flyable import Simulator, check_flyable
from uavaccel.envs.obstacle_lane import LaneTask
from uavaccel.envs.task import Count
from uavaccel.files import Plain
from uavaccel.limits import Cost, Games, Processes, Seed

Channels = Annotated[int, Field(ge=1, le=1_024)]
Width = Annotated[int, Field(ge=1, le=8_192)]


class LearnerConfig(Config):
    """What a policy comes from. Network, algorithm and their settings are this project's own choice."""

    seed: Seed = 0
    """Of everything that is drawn at random: the same seed and configuration give the same results."""
    games: Games = 5000
    """How many games are flown."""
    simulator: Simulator = "mujoco"
    """mujoco, the exact one, or kernels: lanes over arrays, in threads or, with device cuda, on the GPU."""
    environments: Processes = 1
    """Lanes flown side by side, of mujoco each in a process of its own; 1 with wall, where neighbours would disturb."""
    turns: Processes = 1
    """Groups of the lanes that take turns, of double_dqn: while one decides and is learned from, the others fly."""
    task: LaneTask = LaneTask()
    """What is flown, seen and rewarded."""

    algorithm: str = "double_dqn"
    """double_dqn, or the name of a class of stable-baselines3: dqn, ppo, a2c."""
    options: dict[str, Plain] = Field(default_factory=dict)
    """Keywords of that class, over its defaults and, for double_dqn, over those of rl/algorithms.py."""
    final_learning_rate_share: Annotated[float, Field(ge=0.0, le=1.0)] = 0.02
    """What is left of the learning rate at the last game; it falls linearly over the games, to settle the policy."""
    commands_per_gradient_step: Count = 4
    """Of algorithms with a replay buffer."""
    mirror: bool = True
    """Whether double_dqn learns half of each batch as seen in a mirror: the lane is symmetric on average."""
    mirrored_decisions: bool = False
    """Whether double_dqn's policy, once learned, decides by the mean of its ratings of what it sees and of the mirror
    image; without it, by the first."""
    start_from: str | None = None
    """A policy whose weights double_dqn begins with: its folder, or default for the one that ships; None: random."""
    channels: Annotated[tuple[Channels, ...], Field(min_length=1, max_length=4)] = (16, 32)
    """Filters of the network's convolutions, one number a layer."""
    hidden: Annotated[tuple[Width, ...], Field(max_length=8)] = (256,)
    """Width of its fully connected layers, one number a layer."""

    device: Annotated[str, Field(pattern=r"^(cpu|mps|cuda(:[0-9]+)?)$")] = "cpu"
    """Where the network computes: cpu, or cuda for an NVIDIA GPU."""
    torch_threads: Processes = 1
    """Threads of torch on the CPU; equal weights need an equal number."""
    checkpoint_games: Count = 250
    """A checkpoint for --resume is written after so many games."""
    inference_s: Cost = 0.0005
    """What a decision costs the simulated wall clock of `virtual`."""
    learning_s: Cost = 0.01
    """What a gradient step costs the simulated wall clock of `virtual`."""

    @model_validator(mode="after")
    def _timing_allows(self) -> LearnerConfig:
        if self.task.timing == "wall" and self.environments > 1:
            raise ValueError("environments must be 1 with timing wall: neighbours would disturb the clock")
        return self

    @model_validator(mode="after")
    def _kernels_can_fly(self) -> LearnerConfig:
        if self.simulator == "kernels":
            check_flyable(self.task, self.environments, self.device)
            if self.on_device and (self.algorithm != "double_dqn" or self.task.observation == "state"):
                raise ValueError("simulator kernels with device cuda needs algorithm double_dqn and pictures")
            if self.on_device and self.turns > 1:
                raise ValueError(
                    "turns must be 1 with simulator kernels and device cuda: all lanes fly at once"
                )
        return self

    @property
    def on_device(self) -> bool:
        """Whether lanes and learner are together on a GPU."""
        return self.simulator == "kernels" and self.device.startswith("cuda")

    @model_validator(mode="after")
    def _turns_have_lanes(self) -> LearnerConfig:
        if self.turns > self.environments:
            raise ValueError(f"turns must be at most environments: {self.turns} of {self.environments} lanes")
        return self

    @model_validator(mode="after")
    def _can_start_from(self) -> LearnerConfig:
        if self.start_from is not None and self.algorithm != "double_dqn":
            raise ValueError(f"start_from needs algorithm double_dqn, not {self.algorithm}")
        return self

    @model_validator(mode="after")
    def _mirror_exists(self) -> LearnerConfig:
        headings = self.task.headings_deg
        symmetric = {-heading for heading in headings} == set(headings)
        for key in ("mirror", "mirrored_decisions"):
            if getattr(self, key) and (self.task.observation == "state" or not symmetric):
                raise ValueError(f"{key} must be false: it needs pictures and headings symmetric about 0")
        if self.mirrored_decisions and self.algorithm != "double_dqn":
            raise ValueError(f"mirrored_decisions needs algorithm double_dqn, not {self.algorithm}")
        return self
