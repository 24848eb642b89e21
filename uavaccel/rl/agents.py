"""Who flies an evaluation: a trained policy, or a baseline that sees nothing."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from uavaccel.envs.obstacle_lane import LaneTask
from uavaccel.errors import UserError
from uavaccel.resources import asset
from uavaccel.rl.policy import Policy, load_policy

DEFAULT = "default"
STRAIGHT = "straight"
OFFSET = "offset:"  # followed by metres east of the middle
REACHED_M = 0.3  # from its offset a drone that flies along it turns back


class Agent(Protocol):
    """Chooses an action from an observation and the info that came with it."""

    def act(self, observation: NDArray[Any], info: dict[str, Any]) -> int: ...


class PolicyAgent:
    """The greedy action of a trained policy."""

    def __init__(self, policy: Policy) -> None:
        self._policy = policy

    def act(self, observation: NDArray[Any], info: dict[str, Any]) -> int:
        return int(self._policy.act(observation[None])[0])


class OffsetAgent:
    """Flies to a lateral offset in front of the first row, then straight on; it sees its own position alone."""

    def __init__(self, offset_m: float, task: LaneTask) -> None:
        headings = np.array(task.headings_deg)
        self._offset_m = offset_m
        self._ahead, self._west, self._east = (
            int(np.argmin(abs(headings))),
            int(headings.argmin()),
            int(headings.argmax()),
        )

    def act(self, observation: NDArray[Any], info: dict[str, Any]) -> int:
        error_m = self._offset_m - info["position_m"][1]
        if abs(error_m) < REACHED_M:
            return self._ahead
        return self._east if error_m > 0 else self._west


def agent_task(name: str, task: LaneTask) -> LaneTask:
    """The task with the senses that the agent was trained with; a baseline needs no pictures."""
    if name == STRAIGHT or name.startswith(OFFSET):
        return task.model_copy(update={"observation": "state", "history": 1})
    trained = load_policy(policy_folder(name)).config.task
    senses = ("observation", "history", "blank_images", "dvs_preset", "dvs_seed")
    flight = ("t_move_s", "t_sample_s", "speed_m_s", "headings_deg", "altitude_m")
    return task.model_copy(update={key: getattr(trained, key) for key in senses + flight})


def make_agent(name: str, task: LaneTask) -> Agent:
    """The agent `straight`, `offset:METRES`, `default`, or a folder's policy. Raises UserError if there is none."""
    if name == STRAIGHT:
        return OffsetAgent(0.0, task)
    if name.startswith(OFFSET):
        try:
            return OffsetAgent(float(name.removeprefix(OFFSET)), task)
        except ValueError:
            raise UserError(f"{name}: must be offset:METRES, as in offset:-1.5") from None
    return PolicyAgent(load_policy(policy_folder(name)))


def policy_folder(name: str) -> Path:
    """The folder of a policy: of the one that ships for "default", else the name is a path."""
    return asset("policies/default") if name == DEFAULT else Path(name)
