"""A run's games as a Minari dataset, for offline reinforcement learning and imitation.

Minari's own layout on disk (minari.farama.org, "Dataset standards"): NAME-vN/data holds metadata.json and
main_data.hdf5, in which each group `episode_i` has `observations` (one more than commands), `actions`, `rewards`,
`terminations` and `truncations`, and as attributes `id`, `seed`, `total_steps` and `options/lane`. It is written here
with h5py, game by game and deflated, since `minari` keeps whole buffers in memory and writes them as they are.
"""

from __future__ import annotations

import copy
import json
import re
import shutil
from collections.abc import Iterator, Mapping
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from gymnasium import spaces

from uavaccel.envs.values import Observation, stacked_observations
from uavaccel.errors import UserError, naming
from uavaccel.export import provenance_of
from uavaccel.files import UNFINISHED, to_json
from uavaccel.records import RunDirectory
from uavaccel.resources import require
from uavaccel.rl.agents import reset_options
from uavaccel.rl.config import ENVIRONMENTS
from uavaccel.suites.evaluate import AnyRow, EvaluateConfig, Flyable, game_seed
from uavaccel.suites.evaluate_again import environment_of, evaluation_of, fly_again
from uavaccel.suites.experiment import number_of

if TYPE_CHECKING:
    import h5py

LAYOUT = "0.5.4"
"""The Minari whose layout this is: a constant of the format, and not the version that happens to be installed."""
DATASET_ID = re.compile(r"[-_\w]+-v\d+")
MAIN_FILE, METADATA = "main_data.hdf5", "metadata.json"


def write_minari(run: RunDirectory, folder: Path) -> Iterator[tuple[int, int]]:
    """Fly the games of an evaluation again and write them into `folder`; after each, how many of how many are done.

    `folder` appears once it is whole. Its name is the dataset's, such as lane-v0. Raises UserError for another name, a
    folder that exists, a run that is no evaluation or was flown in `wall`, and a game that does not repeat.
    """
    require("h5py", "--minari", "export")
    if not DATASET_ID.fullmatch(folder.name):
        raise UserError(f"--minari {folder}: a dataset's folder is named NAME-vNUMBER, as lane-v0")
    if folder.exists():
        raise UserError(f"{folder}: exists; take another --minari")
    config, rows = evaluation_of(run, "--minari"), run.rows()
    if not rows:
        raise UserError(f"{run.path / 'rows.jsonl'}: holds no finished game")
    unfinished = folder.with_name(folder.name + UNFINISHED)
    try:
        with naming(folder):
            shutil.rmtree(unfinished, ignore_errors=True)  # of an export that was killed
            (unfinished / "data").mkdir(parents=True)
            yield from _write_episodes(run, config, rows, unfinished / "data")
            _write_metadata(run, config, rows, unfinished / "data", folder.name)
            unfinished.replace(folder)
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)


def _write_episodes(
    run: RunDirectory, config: EvaluateConfig, rows: list[AnyRow], data: Path
) -> Iterator[tuple[int, int]]:
    import h5py

    with closing(environment_of(config)) as environment, h5py.File(data / MAIN_FILE, "w", track_order=True) as file:
        for number, row in enumerate(rows):
            episode = file.create_group(f"episode_{number}")
            episode.attrs["id"] = number
            episode.attrs["seed"] = game_seed(config, number_of(row))
            for name, value in reset_options(config.env_id, number_of(row)).items():
                episode.attrs[f"options/{name}"] = value
            _write_episode(run, config, environment, row, episode)
            yield number + 1, len(rows)


def _write_episode(
    run: RunDirectory, config: EvaluateConfig, environment: Flyable, row: AnyRow, episode: h5py.Group
) -> None:
    steps = fly_again(run, config, environment, row)
    space = config.task.action_space()
    columns = {
        **_observed(stacked_observations([steps[0].given, *(step.observation for step in steps)])),
        "actions": np.array([step.action for step in steps], space.dtype),
        "rewards": np.array([step.reward for step in steps], np.float64),
        "terminations": np.array([step.terminated for step in steps], bool),
        "truncations": np.array([step.truncated for step in steps], bool),
    }
    for name, values in columns.items():
        packed = {"compression": "gzip", "shuffle": True} if name.startswith("observations") else {}
        episode.create_dataset(name, data=values, **packed)
    episode.attrs["total_steps"] = len(steps)


def _observed(observations: Observation) -> dict[str, Any]:
    """Return observations by the name of their column; those of a mapping are below "observations/"."""
    if isinstance(observations, Mapping):
        return {f"observations/{name}": part for name, part in observations.items()}
    return {"observations": observations}


def _write_metadata(run: RunDirectory, config: EvaluateConfig, rows: list[AnyRow], data: Path, name: str) -> None:
    made = {}
    if config.env_id in ENVIRONMENTS:  # which whoever reads the dataset can make by its name
        spec = copy.deepcopy(gymnasium.spec(config.env_id))
        spec.kwargs = config.task.model_dump(mode="json")
        made = {"env_spec": spec.to_json()}
    observations, actions = config.task.observation_space(), config.task.action_space()
    metadata = {
        "total_episodes": len(rows),
        "total_steps": sum(len(row["actions"]) for row in rows),
        "data_format": "hdf5",
        "jpeg_encoding": False,
        "observation_space": json.dumps(_plain_space(observations)),
        "action_space": json.dumps(_plain_space(actions)),
        **made,
        "dataset_id": name,
        "minari_version": LAYOUT,
        "algorithm_name": config.agent,
        "dataset_size": round((data / MAIN_FILE).stat().st_size / 1e6, 1),
        "description": "Games of an evaluation of uavaccel, flown again from their seeds and actions.",
        "uavaccel": provenance_of(run),
    }
    (data / METADATA).write_text(to_json(metadata) + "\n", encoding="utf-8")


def _plain_space(space: spaces.Space[Any]) -> dict[str, object]:
    """Return a space as Minari's metadata has it: a Box, a Dict of these, or the Discrete actions of a lane.

    Bounds may be infinite, which Minari reads as Python's json writes it.
    """
    if isinstance(space, spaces.Discrete):
        return {"type": "Discrete", "dtype": "int64", "start": int(space.start), "n": int(space.n)}
    if isinstance(space, spaces.Dict):
        return {"type": "Dict", "subspaces": {name: _plain_space(part) for name, part in space.spaces.items()}}
    assert isinstance(space, spaces.Box)
    return {
        "type": "Box",
        "dtype": str(space.dtype),
        "shape": list(space.shape),
        "low": space.low.tolist(),
        "high": space.high.tolist(),
    }
