"""The policy network: a feature extractor for frames of 36 x 64, small enough for a CPU, and mirrored inputs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import torch as th
from gymnasium import spaces
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.dqn.policies import QNetwork
from torch import nn

from uavaccel.rl.contrast import contrast


class LaneFeatures(BaseFeaturesExtractor):
    """A stack of convolutions, one for each of `channels`: 8 x 8 with stride 4, then 3 x 3 with stride 2.

    The input d / (24 + |d|) is the distance d of a grey level from "no events", with faint events amplified.
    """

    def __init__(self, observation_space: spaces.Box, channels: Sequence[int]) -> None:
        frames, rows, columns = observation_space.shape
        layers: list[nn.Module] = [nn.Conv2d(frames, channels[0], 8, stride=4, padding=2), nn.ReLU()]
        rows, columns = rows // 4, columns // 4
        for before, after in pairwise(channels):
            layers += [nn.Conv2d(before, after, 3, stride=2, padding=1), nn.ReLU()]
            rows, columns = (rows + 1) // 2, (columns + 1) // 2
        super().__init__(observation_space, channels[-1] * rows * columns)
        self.layers = nn.Sequential(*layers, nn.Flatten())

    def forward(self, observations: th.Tensor) -> th.Tensor:
        """Features (n, features) of grey levels (n, frames, rows, columns), 0 to 255, which are overwritten."""
        features: th.Tensor = self.layers(contrast(observations))
        return features


def ratings(networks: Sequence[QNetwork], observations: th.Tensor) -> list[th.Tensor]:
    """Action values (n, actions) from each of several networks of one layout, which share their input."""
    if not isinstance(networks[0].features_extractor, LaneFeatures):
        return [network(observations) for network in networks]
    seen = contrast(observations.float())
    readers: list[Any] = [network.features_extractor for network in networks]
    return [network.q_net(reader.layers(seen)) for network, reader in zip(networks, readers, strict=True)]


def turned_actions(headings_deg: Sequence[float]) -> list[int]:
    """Return the mirror image of each action: the index of the opposite heading."""
    headings = list(headings_deg)
    return [headings.index(-heading) for heading in headings]


def rated_both_ways(rate: Callable[[th.Tensor], th.Tensor], seen: th.Tensor, turned: Sequence[int]) -> th.Tensor:
    """Action values (n, actions), averaged over observations (n, ..., columns) and their mirror images."""
    both = rate(th.cat([seen, seen.flip(-1)]))
    count = seen.shape[0]  # not len(): the exporter to ONNX would take it for fixed
    straight, mirrored = both[:count], both[count:]
    return (straight + mirrored[:, list(turned)]) / 2
