"""Networks that rate actions: convolutions for frames of 36 x 64, small enough for a CPU, and dense layers."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from inspect import unwrap
from itertools import pairwise
from typing import Any

import torch as th
from gymnasium import spaces
from torch import nn

from uavaccel.envs.arrays import picture_of
from uavaccel.vision.dvs_sensor import NEUTRAL_LEVEL

HALF_CONTRAST = 24.0  # grey levels from neutral that are seen at half strength


def contrast(levels: th.Tensor) -> th.Tensor:
    """Turn float grey levels, in place, into the network's input of -1 to 1, 0 for "no events"."""
    distance = levels.sub_(NEUTRAL_LEVEL)
    return distance.div_(distance.abs().add_(HALF_CONTRAST))


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

    optimizer: th.optim.Optimizer

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
        return rated_both_ways(self.q_net, observations, turned)


def turned_actions(headings_deg: Sequence[float]) -> list[int]:
    """Return the mirror image of each action: the index of the opposite heading."""
    headings = list(headings_deg)
    return [headings.index(-heading) for heading in headings]


def rated_both_ways(rate: Callable[[th.Tensor], th.Tensor], seen: th.Tensor, turned: Sequence[int]) -> th.Tensor:
    """Action values (n, actions), averaged over observations (n, ..., columns) and their mirror images."""
    both = rate(th.cat([seen, seen.flip(-1)]))
    count = seen.shape[0]  # not len(): the exporter to ONNX would take it for fixed
    straight, mirrored = both[:count], both[count:]
    # not by a list as an index, which no graph could copy to a GPU
    back = th.stack([mirrored[:, action] for action in turned], dim=1)
    return (straight + back) / 2


class Adam(th.optim.Adam):
    """PyTorch's Adam without the wrappers that load its compiler at their first call, which takes 1.4 s.

    They only keep a method out of compiled graphs, which are not used here, and leave it as `__wrapped__`.
    """

    add_param_group = unwrap(th.optim.Optimizer.add_param_group)
    zero_grad = unwrap(th.optim.Optimizer.zero_grad)
    state_dict = unwrap(th.optim.Optimizer.state_dict)
    load_state_dict = unwrap(th.optim.Optimizer.load_state_dict)
    step = th.no_grad()(unwrap(th.optim.Adam.step))
