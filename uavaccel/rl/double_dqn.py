"""Double DQN (van Hasselt et al., AAAI 2016) on stable-baselines3's DQN, with mirrored batches if wanted."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import torch as th
from stable_baselines3 import DQN
from stable_baselines3.common.type_aliases import ReplayBufferSamples
from torch.nn import functional


class DoubleDQN(DQN):
    """DQN whose target network rates the action that the online network would choose.

    `mirror`: for each action that which it is in a mirror; half of each batch is then turned left to right.
    """

    def __init__(self, *args: Any, mirror: tuple[int, ...] | None = None, **kwargs: Any) -> None:
        self.mirror = mirror
        super().__init__(*args, **kwargs)

    def train(self, gradient_steps: int, batch_size: int = 100) -> None:
        for part in self.gradient_parts(gradient_steps, batch_size):
            part()

    def gradient_parts(self, gradient_steps: int, batch_size: int) -> list[Callable[[], None]]:
        """Gradient steps as parts that take about equally long, to be called one after another."""
        return [partial(self._draw, batch_size), self._step] * gradient_steps

    def _draw(self, batch_size: int) -> None:
        assert self.replay_buffer is not None
        self._batch = self._mirrored(self.replay_buffer.sample(batch_size, env=self._vec_normalize_env))
        self._targets = self.targets(self._batch)

    def _step(self) -> None:
        self.policy.set_training_mode(True)
        self._update_learning_rate(self.policy.optimizer)
        chosen = self.q_net(self._batch.observations).gather(1, self._batch.actions.long())
        loss = functional.smooth_l1_loss(chosen, self._targets)
        self.policy.optimizer.zero_grad()
        loss.backward()
        th.nn.utils.clip_grad_norm_(self.policy.parameters(), self.max_grad_norm)
        self.policy.optimizer.step()
        self._n_updates += 1
        self.logger.record("train/n_updates", self._n_updates, exclude="tensorboard")
        self.logger.record_mean("train/loss", loss.item())

    def targets(self, batch: ReplayBufferSamples) -> th.Tensor:
        """Rewards (n, 1) plus the discounted rating of what the online network would do next."""
        discounts = self.gamma if batch.discounts is None else batch.discounts
        with th.no_grad():
            best = self.q_net(batch.next_observations).argmax(dim=1, keepdim=True)
            rating = self.q_net_target(batch.next_observations).gather(1, best)
            return batch.rewards + (1 - batch.dones) * discounts * rating

    def _mirrored(self, batch: ReplayBufferSamples) -> ReplayBufferSamples:
        if self.mirror is None:
            return batch
        half = len(batch.actions) // 2
        images = [
            th.cat([image[:half].flip(-1), image[half:]])
            for image in (batch.observations, batch.next_observations)
        ]
        turned = th.tensor(self.mirror, device=self.device)[batch.actions[:half].long()]
        actions = th.cat([turned.to(batch.actions.dtype), batch.actions[half:]])
        return batch._replace(observations=images[0], next_observations=images[1], actions=actions)
