"""Checkpoints from which a resumed training reaches the same weights as one that was never interrupted.

The learner, all random generators and the running games are stored as tensors, arrays and JSON, so that reading a
checkpoint runs no code. A checkpoint is valid once its last file, state.json, exists.
"""

from __future__ import annotations

import json
import shutil
import zipfile
import zlib
from collections.abc import Sequence
from pathlib import Path
from pickle import UnpicklingError
from typing import Any

import numpy as np
import torch as th
from numpy.typing import NDArray

from uavaccel.envs.arrays import stacked_observations
from uavaccel.envs.batch import TurnBatch
from uavaccel.envs.values import State
from uavaccel.errors import UserError, naming
from uavaccel.files import Plain, open_bounded, parse_json, read_bounded, replacing
from uavaccel.rl.learner import Learner, LearnerState

_COMPLETE = "state.json"
MOST_BYTES = 1 << 40  # of a replay buffer
DAMAGE = (OSError, EOFError, ValueError, KeyError, zipfile.BadZipFile, zlib.error, UnpicklingError)
"""Exceptions that reading a damaged file of tensors or arrays raises."""


def save_checkpoint(folder: Path, learner: Learner) -> None:
    """Save the states of the learner and of its games; older checkpoints in `folder` are removed."""
    checkpoint = folder / f"{learner.games:07d}"
    shutil.rmtree(checkpoint, ignore_errors=True)
    checkpoint.mkdir(parents=True)
    state = learner.get_state()
    path = checkpoint / "learner.pt"
    with naming(path), path.open("wb") as file:  # to a name torch would write with errors of its own
        cuda_states = th.cuda.get_rng_state_all() if th.cuda.is_available() else []
        th.save({**state.tensors, "cuda": cuda_states}, file)
    with naming(checkpoint), (checkpoint / "buffer.npz").open("wb") as file:
        np.savez(file, **state.arrays)  # type: ignore[arg-type]
    _save_games(checkpoint / "games.npz", learner.lanes)
    plain = {"games": learner.games, "counters": state.counters}
    with replacing(checkpoint / _COMPLETE) as file:
        file.write(json.dumps(plain).encode())
    for older in folder.iterdir():
        if older != checkpoint:
            shutil.rmtree(older)


def find_checkpoint(folder: Path) -> Path | None:
    """Return the newest complete checkpoint in `folder`; None without one."""
    whole = _whole(folder)
    return whole[-1] if whole else None


def _whole(folder: Path) -> list[Path]:
    return sorted(state.parent for state in folder.glob(f"*/{_COMPLETE}"))


def games_of(checkpoint: Path) -> int:
    """Return how many games had been completed when the checkpoint was taken. Raises UserError if it is damaged."""
    try:
        return int(_plain(checkpoint)["games"])
    except (KeyError, TypeError, ValueError) as error:
        raise _damaged(checkpoint, error) from error


def load_checkpoint(checkpoint: Path, learner: Learner) -> None:
    """Restore learner, games and all generators. Raises UserError if it is damaged or has another number of lanes."""
    try:
        _restore(checkpoint, learner)
    except UserError:
        raise
    except (*DAMAGE, AttributeError, IndexError, RuntimeError, TypeError) as error:  # from wrong contents
        raise _damaged(checkpoint, error) from error


def _restore(checkpoint: Path, learner: Learner) -> None:
    plain = _plain(checkpoint)
    observations = _load_games(checkpoint / "games.npz", learner.lanes)
    with open_bounded(checkpoint / "learner.pt", MOST_BYTES) as file:
        tensors = th.load(file, weights_only=True, map_location="cpu")
    arrays = _read_arrays(checkpoint / "buffer.npz")
    learner.set_state(LearnerState(tensors, arrays, plain["counters"]), observations)
    for device, tensor in enumerate(tensors["cuda"]):
        th.cuda.set_rng_state(tensor.cpu(), device)


def _plain(checkpoint: Path) -> dict[str, Plain]:
    try:
        plain: dict[str, Plain] = parse_json(read_bounded(checkpoint / _COMPLETE).decode("utf-8"))
    except (OSError, ValueError) as error:
        raise _damaged(checkpoint, error) from error
    return plain


def _damaged(checkpoint: Path, error: Exception) -> UserError:
    older = [path for path in _whole(checkpoint.parent) if path < checkpoint]
    then = f"go on from {older[-1].name}" if older else "begin the training anew"
    return UserError(f"{checkpoint}: a damaged checkpoint ({type(error).__name__}); delete it and --resume to {then}")


def _read_arrays(path: Path) -> dict[str, NDArray[np.generic]]:
    with open_bounded(path, MOST_BYTES) as file, np.load(file, allow_pickle=False) as arrays:
        return dict(arrays)


def _save_games(path: Path, lanes: Any) -> None:
    """Save the running games, with the keys of lane n prefixed by "n."."""
    games: list[State] = _call_each(lanes, "get_state", [()] * lanes.num_envs)
    with naming(path), path.open("wb") as file:
        np.savez(file, **{f"{n}.{key}": each for n, game in enumerate(games) for key, each in game.items()})


def _load_games(path: Path, lanes: Any) -> Any:
    """Resume the saved games; returns their last observations (lanes, ...)."""
    state = _read_arrays(path)
    count = len({name.partition(".")[0] for name in state})
    if lanes.num_envs != count:
        raise UserError(f"the checkpoint has {count} environments; go on with as many")
    games = [({key.partition(".")[2]: state[key] for key in state if key.startswith(f"{n}.")},) for n in range(count)]
    return stacked_observations(_call_each(lanes, "set_state", games))


def _call_each(lanes: Any, name: str, arguments: Sequence[tuple[object, ...]]) -> list[Any]:
    """Call a method of every environment of a batch, or with every lane of a GPU's."""
    if isinstance(lanes, TurnBatch):
        return lanes.call_each(name, arguments)
    return [getattr(lanes, name)(lane, *argument) for lane, argument in enumerate(arguments)]
