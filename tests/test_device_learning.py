"""The learner of one GPU and its lanes, on the CPU: rounds as they are, none of them recorded."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import nullcontext
from typing import Any

import numpy as np
import pytest
import torch as th
from torch.nn import functional

from tests.host_kernels import host_kernels  # noqa: F401 - a fixture
from uavaccel.config import validate
from uavaccel.rl.learner import Game
from uavaccel.rl.policy import weights_sha256
from uavaccel.suites.training.config import TrainConfig

LANES = 2
KEYS = {
    "games": 24,
    "environments": LANES,
    "simulator": "kernels",
    "channels": [4, 4],
    "hidden": [16],
    "commands_per_gradient_step": 2,
    "options": {
        "learning_starts": 6,
        "batch_size": 4,
        "buffer_size": 60,
        "target_update_interval": 8,
        "n_steps": 1,
    },
    "task": {"timing": "virtual", "command": "adsc", "clock_speed": 20.0, "max_commands": 2},
}


class Immediate:
    """A stream, or an event, of a device that does at once what it is told."""

    def __getattr__(self, name: str) -> Any:
        return lambda *_: None


class Cutter:
    """Patches (n, places, numbers) of what a ring shows, turned round where it is to be mirrored."""

    def __init__(self, shape: tuple[int, int, int], device: th.device) -> None:
        from uavaccel.rl.device_replay import patches_of

        self.down, self.across, _ = patches_of(*shape)

    def __call__(self, ring: th.Tensor, row: th.Tensor, lane: th.Tensor, mirrored: th.Tensor) -> th.Tensor:
        from uavaccel.rl.device_replay import KERNEL, PADDING, STRIDE, spread_levels

        seen = spread_levels(ring.device)[ring[row, lane].long()].float()
        turned = th.where(mirrored.bool()[:, None, None, None], seen.flip(-1), seen)
        return functional.unfold(turned, KERNEL, padding=PADDING, stride=STRIDE).transpose(1, 2)


@pytest.fixture
def at_once(host_kernels: None, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:  # noqa: F811
    for name in ("Stream", "Event", "current_stream"):
        monkeypatch.setattr(th.cuda, name, lambda *_, **__: Immediate())
    monkeypatch.setattr(th.cuda, "stream", nullcontext)
    from uavaccel.rl import device_dqn

    monkeypatch.setattr(device_dqn, "EAGER", 1 << 30)
    monkeypatch.setattr(device_dqn, "Cutter", Cutter)
    yield
    th.use_deterministic_algorithms(False)


def learner_of(config: TrainConfig) -> Any:
    from uavaccel.envs.cuda_lanes import CudaLanes
    from uavaccel.rl.device_dqn import DeviceDQN

    learner = DeviceDQN(config, CudaLanes(config.task, LANES, th.device("cpu")))
    learner.lanes.seed(3)
    return learner


def learn(learner: Any, games: int) -> list[Game]:
    """Until so many games are over, and it is at rest."""
    ended: list[Game] = []
    learner.holding = False
    while learner.games < games or not learner.at_rest:
        learner.holding = learner.games >= games
        ended += learner.advance()
    return ended


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*CUDA is not available:UserWarning")
@pytest.mark.usefixtures("at_once")
def test_a_learner_goes_on_from_a_checkpoint_to_the_same_weights() -> None:
    config = validate(TrainConfig, KEYS, "test")
    learner = learner_of(config)
    first = weights_sha256(learner.policy)
    games = learn(learner, 10)
    saved = (
        learner.get_state(),
        [
            {name: np.array(value) for name, value in state.items()}
            for state in learner.lanes.env_method("get_state")
        ],
    )
    games += learn(learner, 24)
    assert [game.number for game in games] == list(range(24))
    assert all(game.info["phase_s"]["inference"] > 0 for game in games)
    assert max(game.info["phase_s"]["learning"] for game in games) > 0
    assert weights_sha256(learner.policy) != first

    other = learner_of(config)
    seen = [
        other.lanes.env_method("set_state", state, indices=[lane])[0] for lane, state in enumerate(saved[1])
    ]
    other.set_state(saved[0], np.stack(seen))
    again = learn(other, 24)
    assert [(game.number, game.lane, game.reward) for game in again] == [
        (game.number, game.lane, game.reward) for game in games[-len(again) :]
    ]
    assert weights_sha256(other.policy) == weights_sha256(learner.policy)
