"""The replay buffer: a ring of rounds on the learner's device, sampled as n-step windows.

A row is one command of every lane, and the next observation of a command is the observation of the row after it. A
window that contains a truncation then has no weight, since its next observation belongs to another game. A ring that
`keeps_ends` stores what each command led to as well: it learns up to the truncation, and from the newest rows.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import torch as th
from gymnasium import spaces
from numpy.typing import NDArray

from uavaccel.envs.arrays import mapped, named_leaves, picture_of
from uavaccel.rl.network import QNetwork, contrast


class Windows(NamedTuple):
    """Sampled n-step windows (n,): the places of s and s' in the ring, a, the return r, and γ^n, 0 at a game's end."""

    row: th.Tensor
    after: th.Tensor
    lane: th.Tensor
    actions: th.Tensor
    rewards: th.Tensor
    discounts: th.Tensor
    weights: th.Tensor
    mirrored: th.Tensor

    def split(self, size: int) -> list[Windows]:
        """Divide them into batches."""
        return [Windows(*each) for each in zip(*(part.split(size) for part in self), strict=True)]


class Replay:
    """A ring of `rows` rounds of `lanes` lanes; `place` is the row in progress, `filled` ones before it are whole.

    `space` is that of an observation: a Box, or a Dict of these, of which observations are mappings.
    """

    def __init__(
        self, rows: int, lanes: int, space: spaces.Space[Any], device: th.device, keeps_ends: bool = False
    ) -> None:
        self.rows, self.lanes, self.device, self.keeps_ends = rows, lanes, device, keeps_ends
        self._most = rows if keeps_ends else rows - 1
        self._sums = th.float32 if keeps_ends else th.float64

        def ring(box: Any) -> th.Tensor:  # uninitialised: gigabytes that are taken as they fill, written before read
            kind = th.uint8 if box.dtype == np.uint8 else th.float32
            return th.empty((rows, lanes, *box.shape), dtype=kind, device=device)

        self.observations = mapped(ring, space)
        self.next_observations = mapped(ring, space) if keeps_ends else self.observations
        self.actions = th.zeros((rows, lanes), dtype=th.int64, device=device)
        self.rewards, self.over, self.cut, self.flown = (th.zeros((rows, lanes), device=device) for _ in range(4))
        self.place, self.filled = (th.zeros(1, dtype=th.int64, device=device) for _ in range(2))

    def start_round(self, observations: Any, actions: th.Tensor) -> None:
        """Store the observations (lanes, ...) and actions (lanes,) of the round in progress."""
        self._write(self.observations, observations)
        self._write(self.actions, actions)

    def _write(self, rings: Any, values: Any) -> None:
        mapped(lambda ring, each: ring.index_copy_(0, self.place, each[None]), rings, values)

    def end_round(
        self, rewards: th.Tensor, terminated: th.Tensor, truncated: th.Tensor, flown: th.Tensor, after: Any = None
    ) -> None:
        """Store the results (lanes,) of the round in progress, `flown` by these lanes, and go on to the next row.

        A ring that `keeps_ends` needs the observations `after` it (lanes, ...).
        """
        rows = ((self.rewards, rewards), (self.over, terminated), (self.cut, truncated), (self.flown, flown))
        for room, values in rows:
            self._write(room, values.float())
        if after is not None:
            self._write(self.next_observations, after)
        self.place.copy_((self.place + 1) % self.rows)
        self.filled.copy_((self.filled + 1).clamp(max=self._most))

    def draw(self, count: int, n_steps: int) -> tuple[th.Tensor, th.Tensor]:
        """Draw the rows and lanes (count,) of whole windows, on the device."""
        age = n_steps - 1 + th.rand(count, device=self.device, dtype=th.float64) * (self.filled - n_steps + 1)
        row = (self.place - 1 - age.long()) % self.rows
        return row, (th.rand(count, device=self.device, dtype=th.float64) * self.lanes).long()

    def windows(self, row: th.Tensor, lane: th.Tensor, n_steps: int, gamma: float, mirrored: th.Tensor) -> Windows:
        """Return the windows of `n_steps` commands from `row` of `lane` (n,) on, fewer where the game ends."""
        powers = discount_powers(gamma, n_steps, self._sums)
        rewards, lost = (th.zeros(row.shape, dtype=self._sums, device=self.device) for _ in range(2))
        alive, discounts = th.ones_like(rewards), th.ones_like(rewards)
        weights, after = self.flown[row, lane].to(self._sums), row
        newest = (self.place - 1) % self.rows
        for step in range(n_steps):
            at = (row + step) % self.rows
            over, cut = self.over[at, lane], self.cut[at, lane]
            rewards += alive * powers[step] * self.rewards[at, lane]
            discounts = th.where(alive > 0, powers[step + 1], discounts)
            lost = lost + alive * over
            if self.keeps_ends:  # no later step counts after a game's last one, nor after the newest in the ring
                after = th.where(alive > 0, at, after)
                alive = alive * (1.0 - th.maximum(over, cut)) * (at != newest)
            else:
                weights = weights * (1.0 - alive * cut)
                alive = alive * (1.0 - over)
        if not self.keeps_ends:
            after = (row + n_steps) % self.rows
        rewards, discounts, weights = rewards.float(), (discounts * (1.0 - lost)).float(), weights.float()
        return Windows(row, after, lane, self.actions[row, lane], rewards, discounts, weights, mirrored)

    def get_state(self) -> dict[str, NDArray[Any]]:
        """Return its contents as arrays: the rows that are whole, or all once the ring is full."""
        filled = int(self.filled)
        kept = {name: ring[: self.rows if filled == self._most else filled] for name, ring in self._rings().items()}
        return {name: each.cpu().numpy() for name, each in {**kept, "place": self.place, "filled": self.filled}.items()}

    def set_state(self, state: dict[str, NDArray[Any]]) -> None:
        """Restore what `get_state` returned."""
        for name, ring in {**self._rings(), "place": self.place, "filled": self.filled}.items():
            kept = th.from_numpy(state[name])
            ring[: len(kept)].copy_(kept)

    def _rings(self) -> dict[str, th.Tensor]:
        ends = ("next_observations",) if self.keeps_ends else ()
        names = "observations", *ends, "actions", "rewards", "over", "cut", "flown"
        return {key: ring for name in names for key, ring in named_leaves(getattr(self, name), name).items()}


def discount_powers(gamma: float, n_steps: int, dtype: th.dtype) -> list[float]:
    """Return γ^0 to γ^n, computed in the precision of `dtype`."""
    if dtype == th.float64:
        return [gamma**step for step in range(n_steps + 1)]
    return [float(power) for power in np.float32(gamma) ** np.arange(n_steps + 1, dtype=np.float32)]


class Levels:
    """Observations as networks see them in single precision: numbers, or grey levels that `contrast` changes."""

    def look(self, rings: Any, row: th.Tensor, lane: th.Tensor, mirrored: th.Tensor) -> Any:
        """Return the input of the observations at `row` and `lane` (n,) of a ring (rows, lanes, ...).

        Pictures of those that are `mirrored` (n,) bool are turned left to right.
        """

        def input_of(ring: th.Tensor) -> th.Tensor:
            seen = ring.flatten(0, 1).index_select(0, row * ring.shape[1] + lane)  # which copies whole observations
            if seen.ndim != 4:
                return seen
            return contrast(th.where(mirrored[:, None, None, None], seen.flip(-1), seen).to(th.float32, copy=True))

        return mapped(input_of, rings)

    def rate(self, network: QNetwork, seen: Any) -> th.Tensor:
        """Return the action values (n, actions) for an input."""
        extractor, picture = network.features_extractor, picture_of(seen)
        features = extractor.layers(picture) if picture.ndim == 4 else extractor(picture)  # type: ignore[operator]
        return network.rated(features, seen)
