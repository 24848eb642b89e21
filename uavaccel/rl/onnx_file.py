"""Export of a policy, with its preprocessing, as an ONNX file that runs without torch and without this package.

PyTorch's exporter needs the package `onnxscript`, the extra `onnx`.
"""

from __future__ import annotations

import json
import logging
import warnings
from pathlib import Path
from typing import Any

import torch as th
from torch import nn
from torch.nn.functional import avg_pool2d

from uavaccel.envs.sensors import DEPTH_FAR_M, SIZE
from uavaccel.envs.task import Task
from uavaccel.files import replacing
from uavaccel.resources import require
from uavaccel.rl.agents import block_side, metadata_of
from uavaccel.rl.config import DOUBLE_DQN, PPO
from uavaccel.rl.policy import Policy, observed_frames
from uavaccel.vision.dvs_sensor import NEUTRAL_LEVEL

CHANNELS = {"dvs": 1, "depth": 1, "colour": 3}
INPUTS = {
    "dvs": "ON minus OFF events per pixel since the frame before, (n, frames, {}, {}), the oldest first",
    "depth": "metres along the optical axis, (n, frames, {}, {}), the oldest first",
    "colour": "red, green and blue, 0 to 255, (n, 3 x frames, {}, {}), the oldest frame first",
    "state": "the observation as the environment gives it",
}
TOLD = (
    "a context plane of each thing that `knows` names, in that order, (n, planes, 36, 64), 0 to 255, 128 where there "
    "is nothing to show"
)
BESIDE = "what the task tells beside pictures, (n, {}), float32, as the environment gives it"


class OnnxPolicy(nn.Module):
    """Maps full-size sensor pictures to action values and the greedy action, or to the continuous action."""

    def __init__(self, policy: Policy) -> None:
        super().__init__()
        self.policy, self.turned, self.algorithm = policy.network, policy.turned, policy.config.algorithm
        self.task = policy.config.task

    def forward(self, seen: th.Tensor, *beside: th.Tensor) -> tuple[th.Tensor, ...]:
        """Return ratings (n, actions) and actions (n,) for pictures `seen` and what a policy has `beside` them.

        These are context planes, then the state, as `input_names` names them. Of a policy with continuous actions
        these are the actions (n, size) alone.
        """
        levels = reduced(seen, self.task)
        if self.task.context_planes():
            levels = th.cat([levels, beside[0]], dim=1)
        parts = {"image": levels, "state": beside[-1]} if self.task.also_state else {"seen": levels}
        if self.algorithm == PPO:
            return (self.policy.act_on(parts),)
        if self.algorithm == DOUBLE_DQN:
            ratings = self.policy.values(parts if self.task.also_state else levels, self.turned)
        else:
            from uavaccel.rl.baseline import tensor_ratings

            ratings = tensor_ratings(self.policy, levels)
        return ratings, ratings.argmax(dim=1)


def reduced(seen: th.Tensor, task: Task) -> th.Tensor:
    """Reduce pictures (n, planes, rows, columns) to grey levels, as uavaccel.envs.sensors does for a task."""
    observation, side = task.observation, block_side(task)
    if observation == "state":
        return seen
    if observation == "dvs":
        return (NEUTRAL_LEVEL + side**2 * avg_pool2d(seen, side)).clamp(0, 255)
    if observation == "depth":
        return th.round(avg_pool2d(seen.clamp(max=DEPTH_FAR_M), side) * (255 / DEPTH_FAR_M))
    return th.round(avg_pool2d(seen, side))


def write_onnx(policy: Policy, path: Path) -> dict[str, str]:
    """Write the file; returns its metadata. Raises errors.UserError without onnxscript."""
    require("onnxscript", "--onnx", "onnx")
    inputs, names = example(policy), input_names(policy.config.task)
    batch = {0: th.export.Dim("n", min=1)}
    beside = (batch,) * (len(inputs) - 1)
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)  # it tells of packages that it could do with
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of torch's exporter about itself
        program: Any = th.onnx.export(
            OnnxPolicy(policy).eval(),
            inputs,
            input_names=names,
            output_names=["action"] if policy.config.algorithm == PPO else ["ratings", "action"],
            dynamic_shapes=(batch, beside) if beside else (batch,),
            dynamo=True,
            verbose=False,
        )
    about = described(policy)
    program.model.metadata_props.update(about)
    with replacing(path) as file:
        file.write(program.model_proto.SerializeToString())
    return about


def input_names(task: Task) -> list[str]:
    """Return the names of a file's inputs."""
    return ["seen", *(["told"] if task.context_planes() else []), *(["state"] if task.also_state else [])]


def example(policy: Policy) -> tuple[th.Tensor, ...]:
    """Make example inputs, a batch of 2, from which the exporter takes the shapes."""
    task = policy.config.task
    shape = task.frames_space().shape
    if task.observation == "state":
        return (th.zeros(2, *shape),)
    planes = observed_frames(task) * CHANNELS[task.observation]
    beside = {"told": (shape[0] - planes, *SIZE), "state": (task.told,)}
    seen = th.zeros(2, planes, *task.picture_size[::-1])
    return seen, *(th.zeros(2, *beside[name]) for name in input_names(task)[1:])


def described(policy: Policy) -> dict[str, str]:
    """Return the file's metadata, what a user of the file needs to know: text, or JSON for numbers."""
    task = policy.config.task
    kind = "action" if policy.config.algorithm == PPO else "headings_deg"
    flight = (kind, "speed_m_s", "altitude_m", "t_move_s", "t_sample_s")
    given, keys = task.model_dump(mode="json"), (*flight, "command", "dvs_preset", "knows")
    about = {key: json.dumps(given[key]) for key in keys if key in given}
    inputs = {
        "seen": INPUTS[task.observation].format(*task.picture_size[::-1]),
        "told": TOLD,
        "state": BESIDE.format(task.told),
    }
    return {
        **{name: inputs[name] for name in input_names(task)},
        **about,
        **metadata_of(policy.config.env_id, task),
        "trained": json.dumps(dict(policy.manifest.get("trained", {})), sort_keys=True),
        "weights_file_sha256": str(policy.manifest.get("weights_file_sha256", "")),
    }
