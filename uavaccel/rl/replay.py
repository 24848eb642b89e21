"""The replay buffer: transitions on the learner's device, sampled with n-step returns."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch as th
from numpy.typing import NDArray

from uavaccel.envs.values import Frame

ON_DEVICE = ("observations", "next_observations")
IN_MEMORY = ("actions", "rewards", "dones", "truncated")


class Batch(NamedTuple):
    """Sampled transitions (n, ...): s_t, a_t, the discounted sum of up to n_steps rewards, and the state after them."""

    observations: th.Tensor
    actions: th.Tensor  # (n, 1) int64
    next_observations: th.Tensor
    dones: th.Tensor  # (n, 1): the game was terminated, not truncated
    rewards: th.Tensor  # (n, 1)
    discounts: th.Tensor  # (n, 1): of the value that is bootstrapped


class Row(NamedTuple):
    """One command of every lane, in the form of `ReplayBuffer.add`; filled group by group."""

    observations: Frame
    actions: NDArray[np.int64]
    rewards: NDArray[np.float64]
    after: Frame
    dones: NDArray[np.bool_]
    truncated: NDArray[np.bool_]

    @classmethod
    def like(cls, observations: Frame) -> Row:
        """Make an uninitialised row for observations (lanes, ...)."""
        lanes = len(observations)
        ends = np.empty((2, lanes), np.bool_)
        before, after = np.empty_like(observations), np.empty_like(observations)
        return cls(before, np.empty(lanes, np.int64), np.empty(lanes), after, *ends)


class ReplayBuffer:
    """A ring of `capacity` transitions of `lanes` lanes; observations are on `device`, the rest in main memory."""

    def __init__(
        self, capacity: int, lanes: int, shape: tuple[int, ...], dtype: np.dtype[np.generic], device: th.device
    ) -> None:
        self.rows, self.lanes, self.device = max(capacity // lanes, 1), lanes, device
        kind = th.uint8 if dtype == np.uint8 else th.float32
        # Uninitialised: gigabytes that are taken as they fill, and written before they are read.
        self.observations, self.next_observations = (
            th.empty((self.rows, lanes, *shape), dtype=kind, device=device) for _ in range(2)
        )
        self.actions = np.zeros((self.rows, lanes), np.int64)
        self.rewards, self.dones, self.truncated = (np.zeros((self.rows, lanes), np.float32) for _ in range(3))
        self.place, self.full = 0, False

    def __len__(self) -> int:
        return self.rows if self.full else self.place

    def add(
        self,
        observations: NDArray[np.generic],
        actions: NDArray[np.int64],
        rewards: NDArray[np.floating],
        next_observations: NDArray[np.generic],
        dones: NDArray[np.bool_],
        truncated: NDArray[np.bool_],
    ) -> None:
        """Append one command of every lane, over the oldest if the ring is full. `dones` includes `truncated`."""
        row = self.place
        self.observations[row].copy_(th.from_numpy(np.ascontiguousarray(observations)))
        self.next_observations[row].copy_(th.from_numpy(np.ascontiguousarray(next_observations)))
        self.actions[row], self.rewards[row] = actions, rewards
        self.dones[row], self.truncated[row] = dones, truncated
        self.place = (row + 1) % self.rows
        self.full = self.full or self.place == 0

    def sample(self, count: int, n_steps: int, gamma: float, random: np.random.RandomState) -> Batch:
        """Sample `count` transitions; returns are over `n_steps`, or fewer at the end of a game or of the ring."""
        rows = random.randint(0, len(self), size=count)
        lanes = random.randint(0, self.lanes, size=count)
        steps = np.arange(n_steps)
        ahead = (rows[:, None] + steps) % self.rows
        # No later step counts after a game's last one, nor after the newest in the ring.
        at = ahead, lanes[:, None]
        ends = (self.dones[at] > 0) | (ahead == (self.place - 1) % self.rows)
        last = np.where(ends.any(axis=1), ends.argmax(axis=1), n_steps - 1)
        counted = steps <= last[:, None]
        powers = np.float32(gamma) ** np.arange(n_steps, dtype=np.float32)
        rewards = (self.rewards[at] * powers * counted).sum(axis=1)
        discounts = gamma ** counted.sum(axis=1).astype(np.float32)
        final = (rows + last) % self.rows
        dones = self.dones[final, lanes] * (1.0 - self.truncated[final, lanes])
        seen, after, actions = self._sent(
            rows * self.lanes + lanes, final * self.lanes + lanes, self.actions[rows, lanes]
        )
        dones, rewards, discounts = self._sent(*(each.astype(np.float32) for each in (dones, rewards, discounts)))
        return Batch(
            self.observations.flatten(0, 1).index_select(0, seen),  # which copies whole observations
            actions[:, None],
            self.next_observations.flatten(0, 1).index_select(0, after),
            dones[:, None],
            rewards[:, None],
            discounts[:, None],
        )

    def _sent(self, *values: NDArray[np.generic]) -> th.Tensor:
        """Transfer arrays (n,) of one type to the device together: each transfer waits for all work of the GPU."""
        return th.from_numpy(np.stack(values)).to(self.device)

    def get_state(self) -> dict[str, NDArray[np.generic]]:
        """Return its contents as arrays."""
        filled = len(self)
        arrays = {name: getattr(self, name)[:filled].cpu().numpy() for name in ON_DEVICE}
        arrays |= {name: getattr(self, name)[:filled] for name in IN_MEMORY}
        return arrays | {"place": np.array([self.place, self.full])}

    def set_state(self, state: dict[str, NDArray[np.generic]]) -> None:
        """Restore what `get_state` returned."""
        self.place, self.full = int(state["place"][0]), bool(state["place"][1])
        filled = len(self)
        for name in ON_DEVICE:
            getattr(self, name)[:filled].copy_(th.from_numpy(state[name]))
        for name in IN_MEMORY:
            getattr(self, name)[:filled] = state[name]
