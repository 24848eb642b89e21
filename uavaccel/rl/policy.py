"""Files of a trained policy: its weights, and a manifest that describes how to use them. Reading runs no code."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache, wraps
from pathlib import Path
from pickle import UnpicklingError
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from typing_extensions import TypedDict

from uavaccel.config import validate
from uavaccel.envs.arrays import mapped
from uavaccel.envs.obstacle_lane import LaneTask
from uavaccel.envs.task import Task
from uavaccel.envs.values import Observation
from uavaccel.errors import UserError
from uavaccel.files import ARRAYS_BYTES, Plain, file_sha256, open_bounded, parse_json, read_bounded, replacing, to_json
from uavaccel.forms import check
from uavaccel.own_code import as_noted, code_state, folder_of, look_also_in, stamp
from uavaccel.resources import require
from uavaccel.rl.config import DOUBLE_DQN, PPO, LearnerConfig, check_options

if TYPE_CHECKING:  # a manifest is read without PyTorch
    import torch as th

R = TypeVar("R")

WEIGHTS, MANIFEST = "policy.pt", "policy.json"
_TARGET = "q_net_target."  # the target network, which only learning needs
PREPROCESSING = (
    "a frame every T_sample of a command, rendered at 256 x 144, gray (BT.601), counted by the DVS model, ON - OFF "
    "summed over 4 x 4 pixels, plus 128, clipped to 0..255: uint8 (frames, 36, 64), oldest first"
)


class PolicyManifest(TypedDict, total=False):
    """What is read of a policy's manifest beside the configuration of its training."""

    weights_file_sha256: str
    own_code: str
    """The folder of the own code of its task."""
    trained: dict[str, Plain]


@dataclass(frozen=True)
class Policy:
    """A trained network, the configuration of its training, and its manifest."""

    network: Any
    """A QPolicy, an ActorCritic, or a policy of stable-baselines3."""
    config: LearnerConfig
    manifest: Mapping[str, Plain]

    def act(self, observations: Observation) -> NDArray[Any]:
        """Return the greedy actions, (n,) or (n, size), for observations (n, ...)."""
        import torch as th

        if self.config.algorithm == PPO:
            return np.asarray(self.network.act(observations).cpu())
        if self.config.algorithm != DOUBLE_DQN:
            from uavaccel.rl.baseline import greedy

            return greedy(self.network, observations)
        with th.inference_mode():
            return np.asarray(self.values(mapped(th.from_numpy, observations)).argmax(dim=1).cpu())

    def values(self, observations: Any) -> th.Tensor:
        """Return double_dqn's action values (n, actions), averaged over both views with `mirrored_decisions`."""
        device = next(self.network.parameters()).device
        values: th.Tensor = self.network.values(mapped(lambda part: part.to(device), observations), self.turned)
        return values

    def rate(self, observations: Observation) -> tuple[str, NDArray[np.float64]]:
        """Return the kind of a discrete policy's ratings, and these (n, actions) for observations (n, ...)."""
        import torch as th

        if self.config.algorithm != DOUBLE_DQN:
            from uavaccel.rl.baseline import ratings

            return ratings(self.network, observations)
        with th.inference_mode():
            return "action values", self.values(mapped(th.from_numpy, observations)).cpu().numpy().astype(np.float64)

    @property
    def turned(self) -> list[int] | None:
        """Each action's mirror image, for a policy with `mirrored_decisions`; else None."""
        from uavaccel.rl.network import turned_actions

        return turned_actions(self.config.task.headings_deg) if self.config.mirrored_decisions else None


def make_policy(config: LearnerConfig) -> Any:
    """Make the untrained networks of a configuration: a QPolicy, an ActorCritic, or stable-baselines3's, for `act`."""
    space, actions = config.task.observation_space(), config.task.action_space()
    if config.algorithm == DOUBLE_DQN:
        from uavaccel.rl.network import QPolicy

        return QPolicy(space, actions, config.channels, config.hidden)
    if config.algorithm == PPO:
        from uavaccel.rl.ppo import actor_of

        return actor_of(config)
    from uavaccel.rl.baseline import make_baseline_policy

    return make_baseline_policy(config)


def weights_sha256(policy: th.nn.Module) -> str:
    """SHA-256 of the names, shapes and bytes of all weights."""
    digest = hashlib.sha256()
    for name, tensor in sorted(policy.state_dict().items()):
        digest.update(f"{name} {tuple(tensor.shape)} {tensor.dtype}".encode())
        digest.update(tensor.detach().cpu().contiguous().numpy().tobytes())
    return digest.hexdigest()


def export_policy(folder: Path, policy: th.nn.Module, config: LearnerConfig, trained: Mapping[str, Plain]) -> None:
    """Write `policy.pt`, a state dict, and `policy.json`, in which `trained` describes the training."""
    import torch as th

    weights = {
        name: tensor.detach().cpu().clone()
        for name, tensor in policy.state_dict().items()
        if not name.startswith(_TARGET)
    }
    with replacing(folder / WEIGHTS) as file:
        th.save(weights, file)
    folder_of_code = folder_of(config.environment_class)
    manifest = {
        "weights": WEIGHTS,
        **({} if folder_of_code is None else {"own_code": str(folder_of_code)}),
        "weights_file_sha256": file_sha256(folder / WEIGHTS),
        "preprocessing": PREPROCESSING if config.task.observation == "dvs" else config.task.observation,
        **_form(config.task),
        "config": config.model_dump(mode="json", exclude={"task": {"latency"}, "wandb": True}),
        "trained": dict(trained),
    }
    with replacing(folder / MANIFEST) as file:
        file.write((to_json(manifest, indent=2) + "\n").encode())


def _form(task: Task) -> dict[str, Plain]:
    """Return what the policy's inputs and outputs are."""
    space: spaces.Space[Any] = task.observation_space()
    actions = task.action_space()
    parts = space.spaces if isinstance(space, spaces.Dict) else None
    shape = list(space.shape or ()) if parts is None else {name: list(part.shape or ()) for name, part in parts.items()}
    if isinstance(task, LaneTask):
        return {"observation_shape": shape, "actions_heading_deg": list(task.headings_deg)}
    if isinstance(actions, spaces.Discrete):
        return {"observation_shape": shape, "actions": int(actions.n)}
    return {"observation_shape": shape, "action": task.action, "action_shape": list(actions.shape or ())}


def trained_with(folder: Path) -> Mapping[str, Plain]:
    """Return what the manifest in a folder says about the training; empty if there is no policy."""
    try:
        trained: Mapping[str, Plain] = parse_json(read_bounded(folder / MANIFEST).decode("utf-8"))["trained"]
    except (OSError, UserError, ValueError, KeyError, TypeError):
        return {}
    return trained


def _by_stamps(read: Callable[[Path], R]) -> Callable[[Path], R]:
    """Let a function of a policy's folder read it again only where a file has changed, or its task's code.

    A sweep asks in each case.
    """

    @lru_cache(maxsize=4)
    def cached(path: Path, *state: object) -> R:
        return read(path)

    return wraps(read)(lambda path: cached(path, stamp(path / MANIFEST), stamp(path / WEIGHTS), code_state()))


def read_manifest(path: Path) -> tuple[Mapping[str, Plain], LearnerConfig]:
    """Read the manifest of the policy in a folder; returns it and the configuration of the training.

    Raises UserError if there is none, or if the file of weights has another hash than the manifest says.
    """
    manifest, config = _read_manifest(path)
    look_also_in(manifest.get("own_code"))  # each time: another policy's may have been looked up since
    return manifest, config


@_by_stamps
def _read_manifest(path: Path) -> tuple[Mapping[str, Plain], LearnerConfig]:
    manifest = _parsed_manifest(path)
    wanted = manifest.get("weights_file_sha256")
    if wanted is not None and file_sha256(path / WEIGHTS) != wanted:
        raise UserError(
            f"{path / WEIGHTS}: is not the file that {MANIFEST} describes: another hash; train or copy both files anew"
        )
    look_also_in(manifest.get("own_code"))
    trained = as_noted(manifest["config"], manifest.get("own_code"))
    described = {key: value for key, value in trained.items() if key in LearnerConfig.model_fields}
    config = validate(LearnerConfig, described, str(path / MANIFEST))
    try:
        check_options(config)
    except UserError as error:
        raise UserError(f"{path / MANIFEST}: {error}") from error
    return manifest, config


@_by_stamps
def load_policy(path: Path) -> Policy:
    """Load the policy in a run directory, or in any folder with its two files. The result is cached: do not modify it.

    Raises UserError if there is none, if it is damaged, or if its weights are not those that its manifest describes.
    """
    manifest, config = read_manifest(path)
    weights, network = _read_weights(path / WEIGHTS), make_policy(config).eval()
    kinds = {name: tensor.dtype for name, tensor in network.state_dict().items()}
    for name, tensor in weights.items():
        if tensor.dtype != kinds.get(name, tensor.dtype):
            raise UserError(f"{path / WEIGHTS}: {name} is of {tensor.dtype}; it should be of {kinds[name]}")
    online = {name: tensor for name, tensor in weights.items() if name.startswith("q_net.")}
    target = {_TARGET + name.removeprefix("q_net."): tensor for name, tensor in online.items()}
    try:
        network.load_state_dict({**weights, **target})
    except RuntimeError as error:
        raise UserError(f"{path / WEIGHTS}: does not fit the network of {MANIFEST}") from error
    return Policy(network, config, manifest)


def _parsed_manifest(path: Path) -> Mapping[str, Plain]:
    try:
        manifest = parse_json(read_bounded(path / MANIFEST).decode("utf-8"))
    except FileNotFoundError:
        if (path / "parts").is_dir():
            raise UserError(f"{path}: holds no policy itself: name a training in {path / 'parts'}") from None
        why = f"no {MANIFEST} in it" if path.is_dir() else "no such folder"
        raise UserError(f"{path}: holds no policy: {why}; name the folder of a training that ended") from None
    except OSError as error:
        raise UserError(f"{path}: holds no policy: {error.strerror}") from error
    except ValueError as error:
        raise UserError(f"{path / MANIFEST}: a damaged policy, not JSON: {error}; train or copy it anew") from error
    if not (isinstance(manifest, dict) and isinstance(manifest.get("config"), dict)):
        raise UserError(f"{path / MANIFEST}: describes no policy: no mapping under 'config'; train or copy it anew")
    check(PolicyManifest, manifest, str(path / MANIFEST))
    return manifest


def _read_weights(path: Path) -> Mapping[str, th.Tensor]:
    """Read the tensors in a file. Raises UserError if it holds anything else, or numbers that are not finite."""
    require("torch", str(path), "learn", "PyTorch")
    import torch as th

    try:
        with open_bounded(path, ARRAYS_BYTES) as file:
            weights = th.load(file, weights_only=True, map_location="cpu")
    except UnpicklingError as error:
        raise UserError(f"{path}: is no state dict of tensors alone") from error
    except (OSError, EOFError, ValueError, KeyError, RuntimeError) as error:
        raise UserError(f"{path}: a damaged policy ({type(error).__name__}); train or copy it anew") from error
    if not (
        isinstance(weights, dict)
        and all(isinstance(name, str) and isinstance(weight, th.Tensor) for name, weight in weights.items())
    ):
        raise UserError(f"{path}: is no state dict of tensors alone")
    for name, tensor in weights.items():
        if tensor.is_meta or tensor.is_quantized or tensor.layout != th.strided:
            raise UserError(f"{path}: {name} is no plain tensor; train or copy the policy anew")
        if not tensor.isfinite().all():
            raise UserError(f"{path}: {name} is not finite: a training that diverged; train it anew")
    return weights


def observed_frames(task: Task) -> int:
    """Number of frames in one observation."""
    return task.frames_per_command * task.history
