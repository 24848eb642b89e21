"""The time that a training would have taken in real time, modelled as its commands in AirSim at ClockSpeed 1."""

from __future__ import annotations

import json
from functools import lru_cache

import numpy as np
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from typing_extensions import TypedDict

from uavaccel.envs.obstacle_lane import ObstacleLane
from uavaccel.files import to_json
from uavaccel.forms import Positive, check
from uavaccel.records import RunDirectory
from uavaccel.rl.agents import FLIGHT
from uavaccel.rl.algorithms import baseline_class
from uavaccel.rl.config import OWN
from uavaccel.suites.old_report import Values
from uavaccel.suites.training.config import TrainConfig

COMMANDS = 20  # in the modelled game, after which their mean changes by less than 1 %
REAL_TIME = "real_time.json"  # in the run's folder
KEYS = ("command", "observation", "history", "image_processing_s", *FLIGHT)


def model_real_time(config: TrainConfig) -> Values:
    """Return the wall seconds of a command, from a short game straight ahead in an empty lane in the modelled AirSim.

    Images, DVS, decisions and learning are charged to its wall clock, as the phases of the paper's Figure 9.
    """
    from uavaccel.draw.style import command_name

    task = config.task
    learning_s = _gradient_steps(config) * config.learning_s
    how = (
        f"{command_name(task.command)} under the profile airsim at ClockSpeed 1 with the latencies that ship, "
        f"{task.frames_per_command} samples per command, a decision of {config.inference_s * 1e3:g} ms and "
        f"{learning_s * 1e3:g} ms of learning per command; resets are not counted"
    )
    keys = to_json(task.model_dump(mode="json", include=set(KEYS)))
    return {"command_s": _command_s(keys, config.inference_s, learning_s), "how": how}


@lru_cache
def _command_s(keys: str, inference_s: float, learning_s: float) -> float:
    """Return the wall seconds of a command, computed once for trainings with equal costs."""
    environment = ObstacleLane(
        **json.loads(keys),
        timing="virtual",
        profile="airsim",
        clock_speed=1.0,
        lane={"obstacles": []},
    )
    ahead, over = int(np.abs(environment.task.headings_deg).argmin()), False
    try:
        _, info = environment.reset(seed=0)
        while not over and info["commands"] < COMMANDS:
            environment.charge(inference_s, "inference")
            environment.charge(learning_s, "learning")
            _, _, terminated, truncated, info = environment.step(ahead)
            over = terminated or truncated
    finally:
        environment.close()
    return float(info["wall_s"] / info["commands"])


class RealTime(TypedDict):
    """What real_time.json holds, as `model_real_time` returns it."""

    command_s: Positive
    how: str


def in_real_time(commands: int, run: RunDirectory) -> Values:
    """Return the keys of a summary for the real time of so many commands. Raises UserError for a damaged file."""
    modelled = run.read_json(REAL_TIME)
    check(RealTime, modelled, str(run.path / REAL_TIME))
    return {
        "modelled_real_time_s": commands * modelled["command_s"],
        "modelled_real_time_how": modelled["how"],
    }


def _gradient_steps(config: TrainConfig) -> float:
    """Return the gradient steps per command; algorithms without a replay buffer are charged none, as in training."""
    own = config.algorithm == OWN
    buffered = own or issubclass(baseline_class(config.algorithm), OffPolicyAlgorithm)
    return 1 / config.commands_per_gradient_step if buffered else 0.0
