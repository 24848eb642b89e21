"""PPO: what it learns in a toy, its advantages against their definition, and that a seed repeats."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch as th
from gymnasium import spaces

from uavaccel.errors import UserError
from uavaccel.rl.ppo import PPO, ActorCritic, PPOOptions

WANTED = np.array([0.5, -0.3])


class Toy:
    """Games of a few steps, in which the action near WANTED is best; the picture shows the game's sign."""

    def __init__(self, count: int = 16, steps: int = 4, observation: spaces.Space[Any] | None = None) -> None:
        self.num_envs, self._steps = count, steps
        self.single_action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)
        picture = spaces.Box(0, 255, (1, 12, 12), np.uint8)
        both = spaces.Dict({"image": picture, "state": spaces.Box(-np.inf, np.inf, (1,), np.float32)})
        self.single_observation_space: Any = both if observation is None else observation
        self.flown: list[np.ndarray] = []

    def reset(self, *, seed: int) -> tuple[Any, dict[str, Any]]:
        self._random, self._count = np.random.default_rng(seed), 0
        return self._show(), {}

    def _show(self) -> Any:
        self._sign = self._random.choice((-1.0, 1.0), self.num_envs).astype(np.float32)
        image = np.where(self._sign > 0, 200, 50).astype(np.uint8)[:, None, None, None] * np.ones((1, 12, 12), np.uint8)
        return {"image": image, "state": self._sign[:, None]}

    def step(self, actions: np.ndarray) -> tuple[Any, ...]:
        self.flown.append(actions.copy())
        reward = -((actions - self._sign[:, None] * WANTED) ** 2).sum(1)
        self._count += 1
        over = np.full(self.num_envs, self._count % self._steps == 0)
        infos = {"final_info": {"is_success": reward > -0.05}} if over.any() else {}
        return self._show(), reward, over, np.zeros_like(over), infos


def options(**keys: Any) -> PPOOptions:
    return PPOOptions(
        **{"rollout": 16, "minibatches": 4, "channels": (4,), "hidden": (32,), "learning_rate": 3e-3} | keys
    )


def test_it_learns_actions_from_a_picture_beside_a_state() -> None:
    env = Toy()
    ppo = PPO(env, options(commands=16 * 16 * 60))
    rounds = list(ppo.learn())
    assert rounds[-1].commands == ppo.commands == 16 * 16 * 60
    assert rounds[0].games == 16 * 4
    assert rounds[-1].reward > rounds[0].reward / 5
    assert rounds[-1].won > rounds[0].won
    for sign, grey in ((1.0, 200), (-1.0, 50)):
        seen = {"image": np.full((1, 1, 12, 12), grey, np.uint8), "state": np.full((1, 1), sign, np.float32)}
        np.testing.assert_allclose(ppo.policy.act(seen)[0].numpy(), sign * WANTED, atol=0.15)


def test_a_seed_repeats_and_another_does_not() -> None:
    flown = []
    for seed in (1, 1, 2):
        env = Toy()
        list(PPO(env, options(commands=1024, seed=seed)).learn())
        flown.append(np.stack(env.flown))
    np.testing.assert_array_equal(flown[0], flown[1])
    assert (flown[0] != flown[2]).any()
    assert np.abs(flown[0]).max() <= 1.0


def test_advantages_are_sums_of_discounted_surprises() -> None:
    """A(t) is the sum over k of (gamma lambda)^k times the surprise of step t + k, up to the game's end."""
    ppo = PPO(Toy(count=4, steps=3), options(commands=64, rollout=8, minibatches=1, gamma=0.9, smoothing=0.8))
    next(ppo.learn())
    rewards, values, going = (part.numpy().astype(float) for part in (ppo._rewards, ppo._values, ppo._going))
    assert going[:, 0].tolist() == [1, 1, 0, 1, 1, 0, 1, 1]
    last = th.tensor(0.0)
    with th.no_grad():  # the value of what is seen after the rollout; the gradient step came later
        ppo._estimate()
        last = ppo.policy(ppo._now)[1]
    after = np.concatenate([values[1:], last.numpy()[None]])
    surprises = rewards + 0.9 * going * after - values
    for step in range(8):
        expected, weight = np.zeros(4), np.ones(4)
        for later in range(step, 8):
            expected += weight * surprises[later]
            weight = weight * 0.72 * going[later]
        np.testing.assert_allclose(ppo._gains[step].numpy(), expected, atol=1e-5)
    np.testing.assert_allclose(ppo._targets.numpy(), ppo._gains.numpy() + values, atol=1e-6)


def test_events_are_seen_about_their_neutral_grey() -> None:
    network = ActorCritic(spaces.Box(0, 255, (1, 12, 12), np.uint8), 2, options(), events=True)
    levels = network._levels(th.tensor([[128, 152, 104, 255]], dtype=th.uint8))
    np.testing.assert_allclose(levels[0].numpy(), [0.0, 0.5, -0.5, 127 / 151], rtol=1e-6)


@pytest.mark.parametrize(
    ("env", "keys", "message"),
    [
        (Toy(), {"minibatches": 7}, "minibatches = 7: must divide the 256 samples"),
        (Toy(observation=spaces.Discrete(3)), {}, "observation 'seen': must be a picture"),
    ],
)
def test_what_it_cannot_learn_from_is_one_line(env: Any, keys: dict[str, Any], message: str) -> None:
    with pytest.raises(UserError, match=f"^{message}"):
        PPO(env, options(**keys))


def test_discrete_actions_are_refused() -> None:
    env: Any = Toy()
    env.single_action_space = spaces.Discrete(5)
    with pytest.raises(UserError, match=r"^PPO takes continuous actions \(n,\), not Discrete"):
        PPO(env, options())
