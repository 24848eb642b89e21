"""Checkpoints from which a training goes on to the weights that it would have had.

Learner, buffer, every random state, and the games under way, as tensors, arrays and JSON: reading one runs no code. A
checkpoint counts once its last file is there.
"""

from __future__ import annotations

import json
import random
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import torch as th
from stable_baselines3.common.base_class import BaseAlgorithm

from uavaccel.errors import UserError
from uavaccel.files import replacing
from uavaccel.sim.saved import State, part, under

_COUNTERS = (
    "num_timesteps",
    "_episode_num",
    "_n_calls",
    "_n_updates",
    "exploration_rate",
    "_current_progress_remaining",
    "games_done",
    "owed",
)
_BUFFER = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")
_COMPLETE = "state.json"


def save_checkpoint(folder: Path, model: BaseAlgorithm, notes: dict[str, Any]) -> None:
    """Write the model's state, that of its environments' games, and `notes`; older checkpoints in `folder` go."""
    checkpoint = folder / f"{model.games_done:07d}"  # type: ignore[attr-defined]
    shutil.rmtree(checkpoint, ignore_errors=True)
    checkpoint.mkdir(parents=True)
    learner = {"policy": model.policy.state_dict(), "optimizer": model.policy.optimizer.state_dict()}
    th.save({**learner, "torch": th.get_rng_state(), "cuda": _cuda_states()}, checkpoint / "learner.pt")
    _save_buffer(checkpoint / "buffer.npz", model)
    state = {
        "notes": notes,
        "counters": {name: getattr(model, name) for name in _COUNTERS if hasattr(model, name)},
        "random": random.getstate(),
        "numpy": _numpy_state(),
        "actions": model.action_space.np_random.bit_generator.state,
    }
    _save_games(checkpoint / "games.npz", model)
    with replacing(checkpoint / _COMPLETE) as file:
        file.write(json.dumps(state).encode())
    for older in folder.iterdir():
        if older != checkpoint:
            shutil.rmtree(older)


def find_checkpoint(folder: Path) -> Path | None:
    """The newest whole checkpoint below `folder`."""
    whole = sorted(state.parent for state in folder.glob(f"*/{_COMPLETE}"))
    return whole[-1] if whole else None


def read_notes(checkpoint: Path) -> dict[str, Any]:
    """The notes that were saved with it."""
    notes: dict[str, Any] = json.loads((checkpoint / _COMPLETE).read_text())["notes"]
    return notes


def load_checkpoint(checkpoint: Path, model: BaseAlgorithm) -> tuple[dict[str, Any], dict[str, Any]]:
    """Put learner, buffer and games back; returns the notes, and the random states for `set_random`."""
    learner = th.load(checkpoint / "learner.pt", weights_only=True, map_location=model.device)
    model.policy.load_state_dict(learner["policy"])
    model.policy.optimizer.load_state_dict(learner["optimizer"])
    _load_buffer(checkpoint / "buffer.npz", model)
    state = json.loads((checkpoint / _COMPLETE).read_text())
    for name, value in state["counters"].items():
        setattr(model, name, value)
    _load_games(checkpoint / "games.npz", model)
    state["torch"], state["cuda"] = learner["torch"], learner["cuda"]
    return state["notes"], state


def set_random(state: dict[str, Any], model: BaseAlgorithm) -> None:
    """Every generator of this process as it was."""
    version, words, gauss = state["random"]
    random.setstate((version, tuple(words), gauss))
    np.random.set_state((*state["numpy"][:1], np.array(state["numpy"][1], np.uint32), *state["numpy"][2:]))  # noqa: NPY002
    model.action_space.np_random.bit_generator.state = state["actions"]
    th.set_rng_state(state["torch"].cpu())
    for device, words in enumerate(state["cuda"]):
        th.cuda.set_rng_state(words.cpu(), device)


def _numpy_state() -> list[Any]:
    """NumPy's global generator, from which stable-baselines3 draws batches and exploration."""
    name, words, *rest = np.random.get_state(legacy=True)  # noqa: NPY002
    return [name, np.asarray(words).tolist(), *rest]


def _cuda_states() -> list[th.Tensor]:
    return th.cuda.get_rng_state_all() if th.cuda.is_available() else []


def _save_buffer(path: Path, model: BaseAlgorithm) -> None:
    buffer = getattr(model, "replay_buffer", None)
    if buffer is None:
        return
    filled = buffer.buffer_size if buffer.full else buffer.pos
    arrays = {name: getattr(buffer, name)[:filled] for name in _BUFFER}
    with path.open("wb") as file:
        np.savez(file, place=np.array([buffer.pos, buffer.full]), **arrays)


def _load_buffer(path: Path, model: BaseAlgorithm) -> None:
    buffer = getattr(model, "replay_buffer", None)
    if buffer is None:
        return
    with np.load(path, allow_pickle=False) as arrays:
        buffer.pos, buffer.full = int(arrays["place"][0]), bool(arrays["place"][1])
        for name in _BUFFER:
            stored = arrays[name]
            getattr(buffer, name)[: len(stored)] = stored


def _save_games(path: Path, model: BaseAlgorithm) -> None:
    """The games that are under way; the state of environment n under "n."."""
    games: list[State] = model.get_env().env_method("get_state")  # type: ignore[union-attr]
    with path.open("wb") as file:
        np.savez(
            file, **{key: each for n, game in enumerate(games) for key, each in under(str(n), game).items()}
        )


def _load_games(path: Path, model: BaseAlgorithm) -> None:
    """Go on with the games that were under way, and with what the model last saw of them."""
    with np.load(path, allow_pickle=False) as arrays:
        state = dict(arrays)
    environment, count = model.get_env(), len({name.partition(".")[0] for name in state})
    if environment is None or environment.num_envs != count:
        raise UserError(f"the checkpoint has {count} environments; go on with as many")
    games = [part(str(n), state) for n in range(count)]
    seen = [environment.env_method("set_state", game, indices=[n])[0] for n, game in enumerate(games)]
    model._last_obs = np.stack(seen)
    model._last_episode_starts = np.array(
        [not json.loads(str(game["game"]))["commands"] if "game" in game else True for game in games]
    )
