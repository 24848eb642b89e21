"""Options of Double DQN, under their usual names."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from uavaccel.config import Config, validate
from uavaccel.envs.task import Positive
from uavaccel.rl.config import LearnerConfig

Count = Annotated[int, Field(ge=1, le=1_000_000_000)]
Ratio = Annotated[float, Field(ge=0.0, le=1.0)]


class DqnOptions(Config):
    """Keys of `options` for `algorithm: double_dqn`."""

    learning_rate: Annotated[float, Field(gt=0.0, le=1.0)] = 3e-4
    buffer_size: Count = 150_000
    """Commands that can be learned from, of all lanes together."""
    learning_starts: Annotated[int, Field(ge=0, le=1_000_000_000)] = 2_000
    """Commands flown before learning begins: at random, or as the policy of start_from would."""
    batch_size: Count = 32
    gamma: Ratio = 0.95
    n_steps: Count = 3
    """Commands whose rewards are added before what follows is rated."""
    target_update_interval: Count = 2_000
    """Commands after which the target network becomes the online one."""
    exploration_initial_eps: Ratio = 1.0
    exploration_fraction: Ratio = 0.3
    """Of the games, over which exploration falls."""
    exploration_final_eps: Ratio = 0.01
    max_grad_norm: Positive = 10.0

    @model_validator(mode="after")
    def _batches_come_from_the_buffer(self) -> DqnOptions:
        if self.batch_size > self.buffer_size:
            raise ValueError(
                f"batch_size must be at most buffer_size: {self.batch_size} of {self.buffer_size} commands"
            )
        return self

    @classmethod
    def of(cls, config: LearnerConfig) -> DqnOptions:
        """Those of a configuration. Raises UserError for one that there is not."""
        return validate(cls, config.options, f"options of {config.algorithm}")

    def exploration_rate(self, remaining: float) -> float:
        """Share of random actions while `remaining` of the games is still to be flown."""
        done = 1.0 - remaining
        if done > self.exploration_fraction:
            return self.exploration_final_eps
        fall = self.exploration_final_eps - self.exploration_initial_eps
        return self.exploration_initial_eps + done * fall / self.exploration_fraction
