"""Agents that fly an evaluation: a trained policy, or a baseline without pictures."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np

from uavaccel.envs.conditions import OF_SENSOR
from uavaccel.envs.obstacle_lane import LaneTask
from uavaccel.envs.task import Task
from uavaccel.envs.values import Action, Info, Observation, batch_of
from uavaccel.errors import UserError
from uavaccel.files import file_sha256
from uavaccel.resources import asset
from uavaccel.rl.config import LANE, LearnerConfig, environment_class
from uavaccel.rl.policy import MANIFEST, WEIGHTS, Policy, load_policy, observed_frames, read_manifest
from uavaccel.sim.lane.layout import WIDTH_M

if TYPE_CHECKING:
    from uavaccel.rl.network import QPolicy

DEFAULT = "default"
STRAIGHT = "straight"
OFFSET = "offset:"  # followed by metres east of the middle
REACHED_M = 0.3  # from its offset a drone that flies along it turns back


class Agent(Protocol):
    """Chooses an action for an observation and the info that came with it."""

    def act(self, observation: Observation, info: Info) -> Action: ...


class PolicyAgent:
    """Takes the greedy action of a trained policy."""

    def __init__(self, policy: Policy) -> None:
        self.policy = policy

    def act(self, observation: Observation, info: Info) -> Action:
        """Return a discrete action as an int, a continuous one as an array."""
        action = self.policy.act(batch_of(observation))[0]
        return action if np.ndim(action) else int(action)


class OffsetAgent:
    """Flies to a lateral offset ahead of the first row, then straight on; it uses only its own position."""

    def __init__(self, offset_m: float, task: LaneTask) -> None:
        headings = np.array(task.headings_deg)
        self._offset_m = offset_m
        self._ahead = int(np.argmin(abs(headings)))
        self._west, self._east = int(headings.argmin()), int(headings.argmax())

    def act(self, observation: Observation, info: Info) -> int:
        error_m = self._offset_m - info["position_m"][1]
        if abs(error_m) < REACHED_M:
            return self._ahead
        return self._east if error_m > 0 else self._west


SENSES = (*("observation", "history", "knows", "blank_images", "dvs_preset", "dvs_seed"), *(*OF_SENSOR, "dvs_rate_hz"))
CLOCK = ("timing", "command", "clock_speed", "profile", "latency", "report_host_times")  # an evaluation has its own
FLIGHT = ("t_move_s", "t_sample_s", "speed_m_s", "headings_deg", "altitude_m")


def agent_name(agent: str) -> str:
    """Return an agent as it is named in a sentence."""
    return "the policy that ships" if agent == DEFAULT else f"the agent {agent}"


def trained_keys(name: str) -> dict[str, object]:
    """Return the task's keys that the agent was trained with; a baseline needs no pictures. Raises UserError."""
    if is_baseline(name):
        return {"observation": "state", "history": 1}
    config = read_manifest(policy_folder(name))[1]
    trained = config.task.model_dump(mode="json", exclude=set(CLOCK))
    return trained if config.env_id != LANE else {key: trained[key] for key in SENSES + FLIGHT}


def trained_env_id(name: str) -> str:
    """Return the environment that the agent was trained in; a baseline flies the lane. Raises UserError."""
    return LANE if is_baseline(name) else read_manifest(policy_folder(name))[1].env_id


def evaluation_keys(env_id: str) -> dict[str, object]:
    """Return the keys by which a task takes the worlds that are kept for evaluation."""
    return {"split": "evaluation"} if "split" in environment_class(env_id).task_class.model_fields else {}


def reset_options(env_id: str, lane: int) -> dict[str, object]:
    """Return the options of `reset` that choose the game of that number; other games follow from their seeds."""
    known = environment_class(env_id).task_class.reset_options
    return {name: lane for name in ("lane", "world") if name in known}


def is_baseline(name: str) -> bool:
    """Return whether the agent is a baseline, which was never trained."""
    return name == STRAIGHT or name.startswith(OFFSET)


def make_agent(name: str, task: Task) -> Agent:
    """Make the agent `straight`, `offset:METRES`, `default`, or the policy in a folder.

    Raises UserError if there is none, or if its network does not fit the task's observations and actions.
    """
    check_agent(name, task)
    if is_baseline(name):
        assert isinstance(task, LaneTask)
        return OffsetAgent(_offset_m(name), task)
    return PolicyAgent(load_policy(policy_folder(name)))


def check_agent(name: str, task: Task) -> None:
    """Raise UserError as `make_agent` does, except for what only reading the weights would show."""
    if is_baseline(name):
        _offset_m(name)
        return
    trained: Task = read_manifest(policy_folder(name))[1].task
    if isinstance(task, LaneTask) and isinstance(trained, LaneTask):
        _refuse_misfit(name, trained, task)
    elif (task.observation_space(), task.action) != (trained.observation_space(), trained.action):
        raise UserError(f"task: {name} was trained with other observations or actions: omit what they follow from")


def _offset_m(name: str) -> float:
    """Return the metres east of the centre line at which a baseline flies. Raises UserError."""
    if name == STRAIGHT:
        return 0.0
    try:
        offset_m = float(name.removeprefix(OFFSET))
    except ValueError:
        offset_m = math.nan
    if not abs(offset_m) <= WIDTH_M:
        raise UserError(f"{name}: must be offset:METRES, as in offset:-1.5, within the lane of {WIDTH_M:g} m")
    return offset_m


def _refuse_misfit(name: str, trained: LaneTask, task: LaneTask) -> None:
    for key in ("observation", "history", "knows"):
        if getattr(task, key) != getattr(trained, key):
            raise UserError(f"task.{key} = {getattr(task, key)!r}: {name} was trained with {getattr(trained, key)!r}")
    frames, actions = observed_frames(task), len(task.headings_deg)
    if frames != observed_frames(trained):
        raise UserError(
            f"task.t_sample_s = {task.t_sample_s:g}: {frames} frames per observation, but {name} was trained with "
            f"{observed_frames(trained)}"
        )
    if actions != len(trained.headings_deg):
        raise UserError(
            f"task.headings_deg: {actions} actions, but {name} was trained with {len(trained.headings_deg)}"
        )


def policy_sha256(name: str) -> str | None:
    """SHA-256 of the agent's file of weights; None for a baseline."""
    if is_baseline(name):
        return None
    return file_sha256(policy_folder(name) / WEIGHTS)


def first_policy(config: LearnerConfig) -> QPolicy:
    """Make the policy that a training of double_dqn starts with: the weights of `start_from`, or random ones.

    Raises UserError if `start_from` is no policy, or if its network differs from the configuration's.
    """
    from uavaccel.rl.policy import make_policy

    policy: QPolicy = make_policy(config)
    if config.start_from is None:
        return policy
    started = load_policy(policy_folder(config.start_from))
    try:
        policy.load_state_dict(started.network.state_dict())
    except RuntimeError as error:
        raise UserError(
            f"start_from = {config.start_from!r}: another network: channels, hidden, history, headings_deg and what is "
            f"seen must be those of {policy_folder(config.start_from) / MANIFEST}"
        ) from error
    return policy


def policy_folder(name: str) -> Path:
    """Return the folder of a policy: the one that ships for "default"; any other name is a path."""
    return asset("policies/default") if name == DEFAULT else Path(name)
