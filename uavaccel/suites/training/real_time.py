"""How long a training would have taken in real time, modelled: its commands under an AirSim at ClockSpeed 1."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

from uavaccel.envs.obstacle_lane import ObstacleLane
from uavaccel.rl.agents import FLIGHT
from uavaccel.rl.algorithms import baseline_class
from uavaccel.rl.checks import OWN
from uavaccel.suites.training.config import TrainConfig

COMMANDS = 20  # of the modelled game: by then their mean moves by less than 1 %
REAL_TIME = "real_time.json"  # in the run's folder
KEYS = ("command", "observation", "history", "image_processing_s", *FLIGHT)


def model_real_time(config: TrainConfig) -> dict[str, Any]:
    """Wall seconds of a command: a short game straight ahead in an empty lane, under the modelled AirSim that ships.

    Pictures, DVS, decisions and learning are charged to its wall clock: the phases of the paper's Figure 9.
    """
    from uavaccel.draw.style import command_name

    task = config.task
    learning_s = _gradient_steps(config) * config.learning_s
    environment = ObstacleLane(
        **task.model_dump(mode="json", include=set(KEYS)),
        timing="virtual",
        profile="airsim",
        clock_speed=1.0,
        lane={"obstacles": []},
    )
    ahead, over = int(np.abs(task.headings_deg).argmin()), False
    try:
        _, info = environment.reset(seed=0)
        while not over and info["commands"] < COMMANDS:
            environment.charge(config.inference_s, "inference")
            environment.charge(learning_s, "learning")
            _, _, terminated, truncated, info = environment.step(ahead)
            over = terminated or truncated
    finally:
        environment.close()
    how = (
        f"{command_name(task.command)} under the profile airsim at ClockSpeed 1 with the latencies that ship, "
        f"{task.frames_per_command} samples per command, a decision of {config.inference_s * 1e3:g} ms and "
        f"{learning_s * 1e3:g} ms of learning per command; resets are not counted"
    )
    return {"command_s": info["wall_s"] / info["commands"], "how": how}


def in_real_time(commands: int, modelled: Mapping[str, Any]) -> dict[str, Any]:
    """What the summary says about it."""
    return {
        "modelled_real_time_s": commands * modelled["command_s"],
        "modelled_real_time_how": modelled["how"],
    }


def _gradient_steps(config: TrainConfig) -> float:
    """Per command; algorithms without a replay buffer are charged none, as while they train."""
    own = config.algorithm == OWN
    buffered = own or issubclass(baseline_class(config.algorithm), OffPolicyAlgorithm)
    return 1 / config.commands_per_gradient_step if buffered else 0.0
