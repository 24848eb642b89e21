"""The policy network's eyes: small enough for a CPU, for frames of 36 x 64."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import torch as th
from gymnasium import spaces
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.dqn.policies import QNetwork
from torch import nn

from uavaccel.vision.observation import NEUTRAL_LEVEL

HALF_CONTRAST = 24.0  # grey levels from neutral that are seen at half strength


class LaneFeatures(BaseFeaturesExtractor):
    """Convolutions over event images, as many as `channels`: 8 x 8 of stride 4, then 3 x 3 of stride 2.

    Grey levels are read as distances from "no events", faint ones spread out: d / (24 + |d|).
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
        """Features (n, features) of grey levels (n, frames, rows, columns), 0 to 255; they are overwritten."""
        features: th.Tensor = self.layers(contrast(observations))
        return features


def contrast(levels: th.Tensor) -> th.Tensor:
    """Distances of float grey levels from "no events", -1 to 1, faint ones spread out; in place."""
    distance = levels.sub_(NEUTRAL_LEVEL)
    return distance.div_(distance.abs().add_(HALF_CONTRAST))


def ratings(networks: Sequence[QNetwork], observations: th.Tensor) -> list[th.Tensor]:
    """Ratings (n, actions) by networks of one layout; what all of them read grey levels as is worked out once."""
    if not isinstance(networks[0].features_extractor, LaneFeatures):
        return [network(observations) for network in networks]
    seen = contrast(observations.float())
    readers: list[Any] = [network.features_extractor for network in networks]
    return [network.q_net(reader.layers(seen)) for network, reader in zip(networks, readers, strict=True)]
