"""Networks that rate actions: convolutions for frames of 36 x 64, small enough for a CPU, and dense layers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from inspect import unwrap
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import torch as th
from gymnasium import spaces
from numpy.typing import NDArray
from torch import nn

from uavaccel.envs.arrays import mapped, named_leaves, picture_of
from uavaccel.rl.config import HALF_CONTRAST
from uavaccel.vision.dvs_sensor import NEUTRAL_LEVEL


def contrast(levels: th.Tensor, half: float = HALF_CONTRAST) -> th.Tensor:
    """Turn float grey levels, in place, into the network's input of -1 to 1, 0 for "no events".

    A level `half` from neutral is seen at half strength.
    """
    distance = levels.sub_(NEUTRAL_LEVEL)
    return distance.div_(distance.abs().add_(half))


class LaneFeatures(nn.Module):
    """A stack of convolutions, one for each of `channels`: 8 x 8 with stride 4, then 3 x 3 with stride 2.

    The input d / (24 + |d|) is the distance d of a grey level from "no events", with faint events amplified.
    """

    def __init__(self, shape: Sequence[int], channels: Sequence[int]) -> None:
        super().__init__()
        frames, rows, columns = shape
        layers: list[nn.Module] = [nn.Conv2d(frames, channels[0], 8, stride=4, padding=2), nn.ReLU()]
        rows, columns = rows // 4, columns // 4
        for before, after in pairwise(channels):
            layers += [nn.Conv2d(before, after, 3, stride=2, padding=1), nn.ReLU()]
            rows, columns = (rows + 1) // 2, (columns + 1) // 2
        self.features_dim = channels[-1] * rows * columns
        self.layers = nn.Sequential(*layers, nn.Flatten())

    def forward(self, observations: th.Tensor) -> th.Tensor:
        """Features (n, features) of grey levels (n, frames, rows, columns), 0 to 255, floats that are overwritten."""
        features: th.Tensor = self.layers(contrast(observations))
        return features


class QNetwork(nn.Module):
    """Q(s, a) for all actions a: features of pictures (frames, rows, columns), or numbers as they are, dense layers.

    With `told`, so many numbers of the state beside pictures go to the dense layers as they are.
    """

    def __init__(
        self, shape: Sequence[int], actions: int, channels: Sequence[int], hidden: Sequence[int], told: int = 0
    ) -> None:
        super().__init__()
        self.features_extractor = LaneFeatures(shape, channels) if len(shape) == 3 else nn.Flatten()
        width = getattr(self.features_extractor, "features_dim", th.Size(shape).numel()) + told
        layers: list[nn.Module] = []
        for before, after in pairwise((width, *hidden)):
            layers += [nn.Linear(before, after), nn.ReLU()]
        self.q_net = nn.Sequential(*layers, nn.Linear((width, *hidden)[-1], actions))

    def forward(self, observations: Any) -> th.Tensor:
        """Action values (n, actions) of observations (n, ...), or of a mapping of `image` and `state`."""
        return self.rated(self.features_extractor(picture_of(observations).to(th.float32, copy=True)), observations)

    def rated(self, features: th.Tensor, observations: Any) -> th.Tensor:
        """Action values (n, actions) of features (n, features) of the observations' pictures."""
        if isinstance(observations, Mapping):
            features = th.cat([features, observations["state"]], 1)
        values: th.Tensor = self.q_net(features)
        return values


class QPolicy(nn.Module):
    """The online network `q_net` and the target network `q_net_target`, which begins as its copy."""

    def __init__(
        self,
        space: spaces.Box | spaces.Dict,
        space_of_actions: spaces.Discrete,
        channels: Sequence[int],
        hidden: Sequence[int],
    ) -> None:
        super().__init__()
        self.observation_space = space
        told = space["state"].shape[0] if isinstance(space, spaces.Dict) else 0  # type: ignore[index]
        self.q_net, self.q_net_target = (
            QNetwork(picture_of(space).shape, int(space_of_actions.n), channels, hidden, told) for _ in range(2)
        )
        self.q_net_target.load_state_dict(self.q_net.state_dict())

    def values(self, observations: Any, turned: Sequence[int] | None = None) -> th.Tensor:
        """Action values (n, actions); with each action's mirror image `turned`, averaged over both views."""
        if turned is None:
            values: th.Tensor = self.q_net(observations)
            return values
        both: th.Tensor = self.q_net(th.cat([observations, observations.flip(-1)]))
        count = observations.shape[0]  # not len(): the exporter to ONNX would take it for fixed
        # not by a list as an index, which no graph could copy to a GPU
        back = th.stack([both[count:, action] for action in turned], dim=1)
        mean: th.Tensor = (both[:count] + back) / 2
        return mean


def turned_actions(headings_deg: Sequence[float]) -> list[int]:
    """Return the mirror image of each action: the index of the opposite heading."""
    headings = list(headings_deg)
    return [headings.index(-heading) for heading in headings]


class Adam(th.optim.Adam):
    """PyTorch's Adam without the wrappers that load its compiler at their first call, which takes 1.4 s.

    They only keep a method out of compiled graphs, which are not used here, and leave it as `__wrapped__`.
    """

    add_param_group = unwrap(th.optim.Optimizer.add_param_group)
    zero_grad = unwrap(th.optim.Optimizer.zero_grad)
    state_dict = unwrap(th.optim.Optimizer.state_dict)
    load_state_dict = unwrap(th.optim.Optimizer.load_state_dict)
    step = th.no_grad()(unwrap(th.optim.Adam.step))


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
        powers = [gamma**step for step in range(n_steps + 1)]
        if self.keeps_ends:  # in single precision
            powers = [float(power) for power in np.float32(gamma) ** np.arange(n_steps + 1, dtype=np.float32)]
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
