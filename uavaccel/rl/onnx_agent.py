"""ONNX files as agents: those of `uavaccel export --onnx`, and any that maps a batch of observations to actions."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from uavaccel.envs.sensors import DEPTH_FAR_M, SIZE
from uavaccel.envs.task import Task
from uavaccel.envs.values import Observation, rows_of
from uavaccel.errors import UserError
from uavaccel.files import TEXT_BYTES, parse_json, read_bounded
from uavaccel.resources import require
from uavaccel.rl.agents import Agent, BatchAgent, Origin, form_of, kept_keys
from uavaccel.vision.dvs_sensor import BLOCK_SIDE, NEUTRAL_LEVEL

MOST_BYTES = 64 * TEXT_BYTES
ENV_ID, TASK = "env_id", "task"
"""The metadata of this project's own exports: the environment, and the keys of the training's task as JSON."""
DTYPES = {"tensor(float)": np.float32, "tensor(double)": np.float64, "tensor(uint8)": np.uint8}
WHOLE = (SIZE[0] * BLOCK_SIDE, SIZE[1] * BLOCK_SIDE)


class OnnxFile(Origin):
    """An ONNX file. Its inputs are named and shaped as the observations, or it has one; axis 0 is that of the batch.

    The output `action`, `actions` or the first is the action or, of discrete ones, a rating of each.
    """

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.file = Path(name)
        require("onnxruntime", name, "onnx")
        import onnxruntime

        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1  # results do not depend on the machine's cores
        options.log_severity_level = 4
        try:
            content = read_bounded(self.file, MOST_BYTES)
            self._session = onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
        except OSError as error:
            raise UserError(f"{name}: {error.strerror}") from error
        except UserError:
            raise
        except Exception as error:  # those of the runtime have no base class of their own
            raise UserError(f"{name}: is no ONNX file that onnxruntime runs: {_line(error)}") from error
        self._about: Mapping[str, str] = self._session.get_modelmeta().custom_metadata_map
        self.env_id = self._about.get(ENV_ID)

    def keys(self) -> dict[str, Any]:
        if self.env_id is None:
            return {}
        try:
            task = parse_json(self._about[TASK])
        except (KeyError, ValueError) as error:
            raise UserError(f"{self.name}: its metadata have no {TASK} in JSON; export it anew") from error
        return kept_keys(self.env_id, task if isinstance(task, Mapping) else {})

    def forms(self, task: Task) -> Iterator[tuple[str, str, str]]:
        inputs = {each.name: tuple(each.shape[1:]) for each in self._session.get_inputs()}
        own = ", ".join(f"{name} {shape}" if len(inputs) > 1 else str(shape) for name, shape in inputs.items())
        of_task = form_of(task.observation_space())
        if self.env_id is not None and task.observation != "state":  # whole pictures, which it reduces itself
            planes, told = _planes(task)
            of_task = f"seen {(planes, *WHOLE)}, told {(told, *SIZE)}" if told else str((planes, *WHOLE))
        yield "observations", own, of_task
        shape, actions = self._output.shape[1:], task.action_space()
        if len(shape) == 1 and isinstance(shape[0], int):
            form = f"one of 0 to {shape[0] - 1}" if isinstance(actions, spaces.Discrete) else f"({shape[0]},)"
            yield "actions", form, form_of(actions)

    def make(self, task: Task) -> Agent:
        return BatchAgent(partial(self._act_on, task, task.action_space()))

    @property
    def _output(self) -> Any:
        outputs = {each.name: each for each in self._session.get_outputs()}
        return outputs.get("action") or outputs.get("actions") or next(iter(outputs.values()))

    def _act_on(self, task: Task, space: spaces.Space[Any], observations: Observation) -> NDArray[Any]:
        given = observations if self.env_id is None else _whole(task, observations)
        inputs = self._session.get_inputs()
        parts = given if isinstance(given, Mapping) else {inputs[0].name: given}
        feeds = {each.name: parts[each.name].astype(DTYPES.get(each.type, np.float32)) for each in inputs}
        count = len(next(iter(feeds.values())))
        one_by_one = any(isinstance(each.shape[0], int) for each in inputs)
        groups = [slice(n, n + 1) for n in range(count)] if one_by_one else [slice(None)]
        try:
            answers = [self._session.run([self._output.name], rows_of(feeds, group))[0] for group in groups]
        except Exception as error:  # as above
            raise UserError(f"{self.name}: cannot be run on these observations: {_line(error)}") from error
        answer = np.concatenate([np.atleast_1d(answer) for answer in answers])
        if isinstance(space, spaces.Discrete):
            if answer.shape == (count, space.n) and space.n > 1:
                return np.asarray(answer.argmax(axis=1))
            answer = answer.reshape(len(answer), -1)[:, :1].ravel()
            taken, fits = answer.astype(np.int64), len(answer) == count and ((answer >= 0) & (answer < space.n)).all()
        else:
            taken = np.asarray(np.clip(answer, -1.0, 1.0), np.float32)
            fits = answer.shape == (count, *(space.shape or ())) and np.isfinite(answer).all()
        if not fits:
            raise UserError(f"{self.name}: gives {answer.shape} numbers for {count} actions, each {form_of(space)}")
        return taken


def _planes(task: Task) -> tuple[int, int]:
    """Return how many of an observation's planes are of pictures, and how many are context planes."""
    context = task.context_planes()
    told = 0 if context is None else context.planes
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


def _line(error: Exception) -> str:
    return " ".join(str(error).split())[:200]
