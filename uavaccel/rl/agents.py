"""Agents that fly an evaluation: a policy of this project or of others, a function, or a baseline without pictures.

`origin_of` says by an agent's name where it comes from.
"""

from __future__ import annotations

import json
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from copy import copy
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from uavaccel.envs.arrays import select
from uavaccel.envs.conditions import OF_SENSOR
from uavaccel.envs.obstacle_lane import LaneTask
from uavaccel.envs.sensors import DEPTH_FAR_M, PICTURE_SIZE, SIZE
from uavaccel.envs.task import Task
from uavaccel.envs.values import Action, Info, Observation
from uavaccel.errors import UserError
from uavaccel.files import file_sha256, parse_json
from uavaccel.own_code import errors_named, own_function, takes
from uavaccel.realtime.policies import fitting
from uavaccel.realtime.policy_files import OnnxFile, PolicyFile, policy_file
from uavaccel.realtime.server import begin
from uavaccel.resources import asset
from uavaccel.rl.config import LANE, LearnerConfig, environment_class
from uavaccel.rl.policy import MANIFEST, WEIGHTS, Policy, load_policy, make_policy, observed_frames, read_manifest
from uavaccel.sim.lane import WIDTH_M
from uavaccel.vision.dvs_sensor import BLOCK_SIDE, NEUTRAL_LEVEL

if TYPE_CHECKING:
    from uavaccel.rl.network import QPolicy

DEFAULT = "default"
STRAIGHT = "straight"
OFFSET = "offset:"  # followed by metres east of the middle
REACHED_M = 0.3  # from its offset a drone that flies along it turns back


class Agent(Protocol):
    """Chooses an action for an observation and the info that came with it."""

    def act(self, observation: Observation, info: Info) -> Action: ...


class BatchAgent:
    """Chooses actions for many observations at once, without the infos.

    `act_on` returns the actions, (n,) or (n, size), for observations (n, ...); `state` has its `reset`, if it has one.
    """

    def __init__(self, act_on: Callable[[Observation], NDArray[Any]], state: Any = None) -> None:
        self.act_on, self.state = act_on, state

    @property
    def remembers(self) -> bool:
        """Whether it has a `reset`, and may not fly several games at a time."""
        return hasattr(self.state, "reset")

    def reset(self, seed: int) -> None:
        """Begin a game."""
        begin(self.state, seed)

    def act(self, observation: Observation, info: Info) -> Action:
        """Return a discrete action as an int, a continuous one as an array."""
        action = self.act_on(select(observation, None))[0]
        return action if np.ndim(action) else int(action)


class PolicyAgent(BatchAgent):
    """Takes the greedy action of a trained policy."""

    def __init__(self, policy: Policy) -> None:
        super().__init__(policy.act)
        self.policy = policy


class OffsetAgent:
    """Flies to a lateral offset ahead of the first row, then straight on; it uses only its own position."""

    def __init__(self, offset_m: float, task: LaneTask) -> None:
        headings = np.array(task.headings_deg)
        self._offset_m, self._ahead = offset_m, int(np.argmin(abs(headings)))
        self._west, self._east = int(headings.argmin()), int(headings.argmax())

    def act(self, observation: Observation, info: Info) -> int:
        error_m = self._offset_m - info["position_m"][1]
        if abs(error_m) < REACHED_M:
            return self._ahead
        return self._east if error_m > 0 else self._west


SENSES = (
    *("observation", "also_state", "picture_size", "history", "knows", "blank_images", "dvs_preset", "dvs_seed"),
    *(*OF_SENSOR, "dvs_rate_hz"),
)
CLOCK = ("timing", "command", "clock_speed", "profile", "latency", "report_host_times")  # an evaluation has its own
FLIGHT = ("t_move_s", "t_sample_s", "speed_m_s", "headings_deg", "altitude_m")


def agent_name(agent: str) -> str:
    """Return an agent as it is named in a sentence."""
    return "the policy that ships" if agent == DEFAULT else f"the agent {agent}"


def evaluation_keys(env_id: str) -> dict[str, object]:
    """Return the keys by which a task takes the worlds that are kept for evaluation."""
    return {"split": "evaluation"} if "split" in environment_class(env_id).task_class.model_fields else {}


def reset_options(env_id: str, lane: int) -> dict[str, object]:
    """Return the options of `reset` that choose the game of that number; other games follow from their seeds."""
    known = environment_class(env_id).task_class.reset_options
    return {name: lane for name in ("lane", "world") if name in known}


class Origin(ABC):
    """Where an agent comes from: what is known of it before it flies, and how it is made."""

    env_id: str | None = None
    """The environment that it flies; None for an agent that does not say."""
    file: Path | None = None
    """What has what was learned; None for a baseline."""

    def __init__(self, name: str) -> None:
        """Raises UserError if there is no such agent."""
        self.name = name

    def keys(self) -> dict[str, Any]:
        """Return the task's keys that it was trained with, so that an evaluation has them where it says nothing."""
        return {}

    def forms(self, task: Task) -> Iterator[tuple[str, str, str]]:
        """Yield "observations" and "actions", as far as their form is known, with the agent's form and the task's."""
        yield from ()

    def check(self, task: Task) -> None:
        """Raise UserError for a task that does not fit, as far as can be told without the weights."""
        for what, own, of_task in self.forms(task):
            if own != of_task:
                raise UserError(
                    f"{self.name}: its {what} are {own}, the task's {of_task}: name the environment that it was "
                    "trained in, --set env_id=..., and the keys of its task, --set task.KEY=..."
                )

    @abstractmethod
    def make(self, task: Task) -> Agent:
        """Make the agent for a task that fits. Raises UserError where its weights cannot be read."""

    def sha256(self) -> str | None:
        """Return the hash of the file that has what was learned; None for a baseline."""
        return None if self.file is None else file_sha256(self.file)


def origin_of(name: str) -> Origin:
    """Return where the agent of a name comes from. Raises UserError if there is none."""
    if name == STRAIGHT or name.startswith(OFFSET):
        return Baseline(name)
    if name.endswith(".onnx"):
        return OnnxAgentFile(OnnxFile(name))
    if (file := policy_file(name)) is not None:
        return AgentFile(file)
    if name.endswith(".py"):
        raise UserError(f"agent {name!r}: name its function, as in {name}:act")
    return OwnFunction(name) if ":" in name else PolicyFolder(name)


def make_agent(name: str, task: Task) -> Agent:
    """Make the agent of a name. Raises UserError if there is none, or if it does not fit observations and actions."""
    origin = origin_of(name)
    origin.check(task)
    return origin.make(task)


class Baseline(Origin):
    """`straight` or `offset:METRES`, which was never trained and needs no pictures."""

    env_id = LANE

    def __init__(self, name: str) -> None:
        super().__init__(name)
        try:
            self._offset_m = 0.0 if name == STRAIGHT else float(name.removeprefix(OFFSET))
        except ValueError:
            self._offset_m = math.nan

    def keys(self) -> dict[str, Any]:
        return {"observation": "state", "history": 1}

    def check(self, task: Task) -> None:
        if not abs(self._offset_m) <= WIDTH_M:
            raise UserError(f"{self.name}: must be offset:METRES, as in offset:-1.5, within the lane of {WIDTH_M:g} m")

    def make(self, task: Task) -> Agent:
        assert isinstance(task, LaneTask)
        return OffsetAgent(self._offset_m, task)


class OwnFunction(Origin):
    """A function of one's own, `file.py:function` or `module:function`, of an observation, and of its info if it likes.

    It returns an element of the action space. If it has a `reset`, that is called before a game, with its seed if it
    takes one. Of its errors, one line names file and line.
    """

    file: Path
    _actions: spaces.Space[Any]

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self._function, self.file = own_function(name, f"agent {name!r}")
        self._one = takes(self._function, 1)
        if not self._one and not takes(self._function, 2):
            raise UserError(f"agent {name!r}: must take an observation, or an observation and an info")

    def make(self, task: Task) -> Agent:
        agent = copy(self)
        agent._actions = task.action_space()
        return agent

    @property
    def remembers(self) -> bool:
        """Whether it has a `reset`, and may not fly several games at a time."""
        return hasattr(self._function, "reset")

    def reset(self, seed: int) -> None:
        """Begin a game."""
        with errors_named(self.file, self.name):
            begin(self._function, seed)

    def act(self, observation: Observation, info: Info) -> Action:
        """Ask the function."""
        with errors_named(self.file, self.name):
            given = self._function(observation) if self._one else self._function(observation, info)
        action = fitting(given, self._actions, self.name)
        return action if np.ndim(action) else int(action)


class AgentFile(Origin):
    """A file of stable-baselines3, ONNX or TorchScript; it does not say which environment it was trained in."""

    file: Path

    def __init__(self, policy: PolicyFile) -> None:
        super().__init__(policy.name)
        self.policy, self.file = policy, policy.file

    def forms(self, task: Task) -> Iterator[tuple[str, str, str]]:
        yield from self.policy.forms(task.observation_space(), task.action_space())

    def make(self, task: Task) -> Agent:
        act_on = self.policy.load(task.observation_space(), task.action_space())
        return BatchAgent(act_on, self.policy.state)


class PolicyFolder(Origin):
    """A training's run directory, another folder with its two files, or `default`, the policy that ships."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self._folder = policy_folder(name)
        self.file = self._folder / WEIGHTS
        self._trained = read_manifest(self._folder)[1]
        self.env_id = self._trained.env_id

    def keys(self) -> dict[str, Any]:
        return kept_keys(self._trained.env_id, self._trained.task.model_dump(mode="json"))

    def check(self, task: Task) -> None:
        trained: Task = self._trained.task
        if not (isinstance(task, LaneTask) and isinstance(trained, LaneTask)):
            if _of(task) != _of(trained):
                other = (f"{key} = {there!r}, not {here!r}" for key, there, here in _seen_otherwise(trained, task))
                what = ", ".join(other) or "omit what they follow from"
                raise UserError(f"task: {self.name} was trained with other observations or actions: {what}")
            return
        was = f"{self.name} was trained with"
        for key in ("observation", "also_state", "picture_size", "history", "knows"):
            if getattr(task, key) != getattr(trained, key):
                raise UserError(f"task.{key} = {getattr(task, key)!r}: {was} {getattr(trained, key)!r}")
        if (frames := observed_frames(task)) != (theirs := observed_frames(trained)):
            sampled = f"task.t_sample_s = {task.t_sample_s:g}: {frames} frames per observation"
            raise UserError(f"{sampled}, but {was} {theirs}")
        if (actions := len(task.headings_deg)) != (theirs := len(trained.headings_deg)):
            raise UserError(f"task.headings_deg: {actions} actions, but {was} {theirs}")

    def make(self, task: Task) -> Agent:
        return PolicyAgent(load_policy(self._folder))


def _of(task: Task) -> tuple[object, ...]:
    """Return what a policy sees and does: depth and events are pictures of one form."""
    return task.observation_space(), task.observation, task.action


def _seen_otherwise(trained: Task, task: Task) -> Iterator[tuple[str, Any, Any]]:
    """Yield the keys that alone make `trained` see or do something else, with what they are in it and in `task`."""
    here, there = task.model_dump(mode="json"), trained.model_dump(mode="json")
    for key in there if here.keys() == there.keys() else ():
        if here[key] != there[key] and _of(trained.model_copy(update={key: getattr(task, key)})) != _of(trained):
            yield key, there[key], here[key]


def kept_keys(env_id: str, trained: Mapping[str, Any]) -> dict[str, Any]:
    """Return the keys of a training's task that an evaluation keeps: senses and flight, outside of the lane more."""
    kept = SENSES + FLIGHT if env_id == LANE else tuple(key for key in trained if key not in CLOCK)
    return {key: trained[key] for key in kept if key in trained}


def first_policy(config: LearnerConfig) -> QPolicy:
    """Make the policy that a training of double_dqn starts with: the weights of `start_from`, or random ones.

    Raises UserError if `start_from` is no policy, or if its network differs from the configuration's.
    """
    policy: QPolicy = make_policy(config)
    if config.start_from is not None:
        folder = policy_folder(config.start_from)
        try:
            started = load_policy(folder)
        except UserError as error:
            raise UserError(f"start_from: {error}") from error
        try:
            policy.load_state_dict(started.network.state_dict())
        except RuntimeError as error:
            raise UserError(
                f"start_from = {config.start_from!r}: another network: channels, hidden, history, headings_deg and "
                f"what is seen must be those of {folder / MANIFEST}"
            ) from error
    return policy


def policy_folder(name: str) -> Path:
    """Return the folder of a policy: the one that ships for "default"; any other name is a path."""
    return asset("policies/default") if name == DEFAULT else Path(name)


ENV_ID, TASK = "env_id", "task"
"""The metadata of this project's own exports: the environment, and the keys of the training's task as JSON."""


class OnnxAgentFile(AgentFile):
    """An ONNX file; those of `uavaccel export --onnx` say what they fly, and reduce whole pictures themselves."""

    policy: OnnxFile

    def __init__(self, policy: OnnxFile) -> None:
        super().__init__(policy)
        self.env_id = policy.metadata.get(ENV_ID)

    def keys(self) -> dict[str, Any]:
        if self.env_id is None:
            return {}
        try:
            task = parse_json(self.policy.metadata[TASK])
        except (KeyError, ValueError) as error:
            raise UserError(f"{self.name}: its metadata have no {TASK} in JSON; export it anew") from error
        return kept_keys(self.env_id, task if isinstance(task, Mapping) else {})

    def forms(self, task: Task) -> Iterator[tuple[str, str, str]]:
        (what, own, of_task), *actions = super().forms(task)
        if self._reduces(task):
            planes, told = _planes(task)
            parts = {"seen": (planes, *task.picture_size[::-1]), "state": (task.told,), "told": (told, *SIZE)}
            forms = {name: str(form) for name, form in parts.items() if form[0]}
            of_task = ", ".join(f"{name} {form}" for name, form in forms.items()) if len(forms) > 1 else forms["seen"]
        yield what, own, of_task
        yield from actions

    def check(self, task: Task) -> None:
        super().check(task)
        if (trained := self.keys().get("observation", task.observation)) != task.observation:
            raise UserError(f"task.observation = {task.observation!r}: {self.name} was trained with {trained!r}")

    def make(self, task: Task) -> Agent:
        act_on = self.policy.load(task.observation_space(), task.action_space())
        return BatchAgent((lambda seen: act_on(_whole(task, seen))) if self._reduces(task) else act_on)

    def _reduces(self, task: Task) -> bool:
        return self.env_id is not None and task.observation != "state"


def _planes(task: Task) -> tuple[int, int]:
    """Return how many of an observation's planes are of pictures, and how many are context planes."""
    context = task.context_planes()
    told = 0 if context is None else len(context.knows)
    return int(task.frames_space().shape[0]) - told, told


def block_side(task: Task) -> int:
    """Return the side of the blocks of pixels that are a frame's pixels."""
    return BLOCK_SIDE if task.picture_size == PICTURE_SIZE else 1


def _whole(task: Task, observations: Any) -> dict[str, NDArray[Any]]:
    """Return the inputs of an exported file, whole pictures, that it reduces to `observations`."""
    (planes, told), side = _planes(task), block_side(task)
    frames = observations["image"] if task.also_state else observations
    levels: NDArray[Any] = frames[:, :planes].astype(np.float32)
    if task.observation == "dvs":
        levels = (levels - NEUTRAL_LEVEL) / side**2
    elif task.observation == "depth":
        levels = levels * (DEPTH_FAR_M / 255)
    seen = levels.repeat(side, axis=2).repeat(side, axis=3)
    context = {"told": frames[:, planes:].astype(np.float32)} if told else {}
    return {"seen": seen, **context, **({"state": observations["state"]} if task.also_state else {})}


def metadata_of(env_id: str, task: Task) -> dict[str, str]:
    """Return the metadata by which an exported file says what it flies."""
    return {ENV_ID: env_id, TASK: json.dumps(task.model_dump(mode="json", exclude={"latency"}))}
