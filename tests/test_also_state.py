"""`also_state`: pictures and the state beside them, as a mapping, in one environment, in a batch, and to PPO."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gymnasium import spaces

from tests.learning import train_into
from tests.opengl import needs_opengl
from tests.running import configured, fly_into
from uavaccel.config import validate
from uavaccel.envs.navigate import Navigate
from uavaccel.envs.obstacle_lane import ObstacleLane
from uavaccel.export.minari_dataset import write_minari
from uavaccel.rl.policy import load_policy
from uavaccel.suites.evaluate import Evaluation
from uavaccel.suites.evaluate_again import environment_of, fly_again
from uavaccel.suites.train import TrainConfig

SMALL: dict[str, Any] = {"picture_size": [32, 18], "max_commands": 3}
AHEAD = np.array([1.0, 0.1, 0.0], np.float32)


@needs_opengl
def test_pictures_and_state_are_those_of_either_alone() -> None:
    kinds: tuple[dict[str, Any], ...] = ({"also_state": True}, {}, {"observation": "state"})
    both, pictures, state = (Navigate(**SMALL, **keys) for keys in kinds)
    space = both.observation_space
    assert isinstance(space, spaces.Dict)
    seen = [each.reset(seed=4)[0] for each in (both, pictures, state)]
    for _ in range(3):
        assert space.contains(seen[0])
        np.testing.assert_array_equal(seen[0]["image"], seen[1])
        np.testing.assert_array_equal(seen[0]["state"], seen[2])
        seen = [each.step(AHEAD)[0] for each in (both, pictures, state)]
    with closing(Navigate(**SMALL, also_state=True)) as other:
        again = other.set_state(both.get_state())
        for name, part in seen[0].items():
            np.testing.assert_array_equal(again[name], part, err_msg=name)
    for each in (both, pictures, state):
        each.close()


@needs_opengl
def test_the_state_is_of_the_next_decision_none_after_a_touch() -> None:
    """Where the goal is as seen from the end of the command."""
    with closing(Navigate(**SMALL, also_state=True)) as env:
        env.reset(seed=0)
        seen, _, _, _, info = env.step(AHEAD)
        way_m = np.subtract(info["goal_m"], info["position_m"])
        np.testing.assert_allclose(seen["state"][:3], way_m / (np.linalg.norm(way_m) + 1e-3), atol=1e-5)
    lane = {"obstacles": [{"x_m": 1.5, "y_m": 0.0, "half_side_m": 0.5}]}
    with closing(ObstacleLane(lane=lane, observation="depth", also_state=True)) as wall:
        wall.reset(seed=0)
        seen, over = {}, False
        while not over:
            seen, _, over, _, info = wall.step(2)
        assert info["collision"]
        assert not seen["state"].any()
        assert seen["state"].shape == (13,)


@needs_opengl
@pytest.mark.slow
@pytest.mark.usefixtures("trainings_here")
def test_ppo_learns_from_both_and_its_games_are_exported(tmp_path: Path) -> None:
    keys = {
        "env_id": "uavaccel/Navigate-v0", "algorithm": "ppo", "games": 3, "environments": 2, "hidden": [8],
        "channels": [2], "options": {"rollout": 4, "minibatches": 2}, "task": {**SMALL, "also_state": True},
    }  # fmt: skip
    config = validate(TrainConfig, keys, "test")
    first, again = (train_into(tmp_path / name, config)["weights_sha256"] for name in ("one", "again"))
    assert first == again
    policy = load_policy(tmp_path / "one")
    assert policy.manifest["observation_shape"] == {"image": [1, 18, 32], "state": [7]}
    evaluation = configured("evaluate", "task.timing=lockstep", agent=str(tmp_path / "one"), games=1)
    run = fly_into(tmp_path / "flown", Evaluation(), evaluation)
    (row,) = run.rows()
    steps = fly_again(run, evaluation, environment_of(evaluation), row)
    assert row["actions"] == [step.action for step in steps]
    list(write_minari(run, tmp_path / "navigate-v0"))
    import h5py

    with h5py.File(tmp_path / "navigate-v0/data/main_data.hdf5") as file:
        stored = file["episode_0/observations"]
        assert stored["image"].shape == (len(steps) + 1, 1, 18, 32)
        np.testing.assert_array_equal(stored["state"][0], steps[0].given["state"])
        assert file["episode_0/actions"].dtype == np.float32
