"""ONNX files as agents: those of `uavaccel export --onnx` say what they fly, and reduce whole pictures themselves."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from uavaccel.envs.sensors import DEPTH_FAR_M, SIZE
from uavaccel.envs.task import Task
from uavaccel.errors import UserError
from uavaccel.files import parse_json
from uavaccel.realtime.policy_files import OnnxFile
from uavaccel.rl.agents import Agent, AgentFile, BatchAgent, kept_keys
from uavaccel.vision.dvs_sensor import BLOCK_SIDE, NEUTRAL_LEVEL

ENV_ID, TASK = "env_id", "task"
"""The metadata of this project's own exports: the environment, and the keys of the training's task as JSON."""
WHOLE = (SIZE[0] * BLOCK_SIDE, SIZE[1] * BLOCK_SIDE)


class OnnxAgentFile(AgentFile):
    """An ONNX file, of this project or of others."""

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
        if self.env_id is not None and task.observation != "state":  # whole pictures, which it reduces itself
            planes, told = _planes(task)
            of_task = f"seen {(planes, *WHOLE)}, told {(told, *SIZE)}" if told else str((planes, *WHOLE))
        yield what, own, of_task
        yield from actions

    def make(self, task: Task) -> Agent:
        act_on = self.policy.load(task.observation_space(), task.action_space())
        return BatchAgent(act_on if self.env_id is None else lambda observations: act_on(_whole(task, observations)))


def _planes(task: Task) -> tuple[int, int]:
    """Return how many of an observation's planes are of pictures, and how many are context planes."""
    context = task.context_planes()
    told = 0 if context is None else len(context.knows)
    return int(task.frames_space().shape[0]) - told, told


def _whole(task: Task, observations: NDArray[Any]) -> dict[str, NDArray[Any]] | NDArray[Any]:
    """Return the inputs of an exported file, which reduces whole pictures itself, that it reduces to `observations`."""
    if task.observation == "state":
        return observations
    planes, told = _planes(task)
    levels: NDArray[Any] = observations[:, :planes].astype(np.float32)
    if task.observation == "dvs":
        levels = (levels - NEUTRAL_LEVEL) / BLOCK_SIDE**2
    elif task.observation == "depth":
        levels = levels * (DEPTH_FAR_M / 255)
    seen = levels.repeat(BLOCK_SIDE, axis=2).repeat(BLOCK_SIDE, axis=3)
    return {"seen": seen, "told": observations[:, planes:].astype(np.float32)} if told else {"seen": seen}


def metadata_of(env_id: str, task: Task) -> dict[str, str]:
    """Return the metadata by which an exported file says what it flies."""
    return {ENV_ID: env_id, TASK: json.dumps(task.model_dump(mode="json", exclude={"latency"}))}
