"""Whether there is such an algorithm, with such options: what a dry run asks, without a learner."""

from __future__ import annotations

import inspect
import math
from typing import TYPE_CHECKING

from uavaccel.errors import UserError
from uavaccel.machine import memory_bytes
from uavaccel.rl.config import LearnerConfig
from uavaccel.rl.dqn_options import DqnOptions

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm

OWN = "double_dqn"
NOT_TO_SET = (
    "policy",
    "env",
    "policy_kwargs",
    "seed",
    "device",
    "verbose",
    "tensorboard_log",
    "_init_setup_model",
)
ALGORITHMS = f"{OWN}, dqn, ppo, a2c"
SIZES = ("buffer_size", "batch_size", "n_steps", "n_epochs")
MOST = 1_000_000_000


def check_algorithm(config: LearnerConfig) -> None:
    """Raises UserError for an algorithm that there is not, that has no use for the lane's actions or no such options.

    And for a memory of what was flown that this machine cannot hold.
    """
    if config.algorithm == OWN:
        stored = DqnOptions.of(config).buffer_size
    else:
        from uavaccel.rl.algorithms import baseline_class  # loads PyTorch

        stored = _check_keywords(config, baseline_class(config.algorithm))
    space, memory = config.task.observation_space(), memory_bytes()
    needed = stored * math.prod(space.shape) * space.dtype.itemsize
    if memory is not None and needed > memory and config.device == "cpu":
        raise UserError(
            f"options of {config.algorithm}: {'buffer_size' if 'n_steps' not in config.options else 'n_steps'}: "
            f"{stored} observations take {needed / 1e9:.3g} GB; this machine has {memory / 1e9:.3g} GB"
        )


def _check_keywords(config: LearnerConfig, algorithm: type[BaseAlgorithm]) -> int:
    """How many observations a baseline keeps. Raises UserError for an option that it does not have."""
    known = inspect.signature(algorithm).parameters
    for name, value in config.options.items():
        if name not in known or name in NOT_TO_SET:
            there = ", ".join(each for each in known if each not in NOT_TO_SET)
            raise UserError(f"options of {config.algorithm}: unknown key {name!r}; known: {there}")
        if name in SIZES and not (type(value) is int and 1 <= value <= MOST):
            raise UserError(
                f"options of {config.algorithm}: {name} = {value!r}: must be a whole number, 1 to {MOST}"
            )
    size = "buffer_size" if "buffer_size" in known else "n_steps"
    held = int(config.options.get(size, known[size].default))
    return held if size == "buffer_size" else held * config.environments
