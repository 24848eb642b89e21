"""The policy network's eyes: small enough for a CPU, for frames of 36 x 64."""

from __future__ import annotations

from collections.abc import Sequence

import torch as th
from gymnasium import spaces
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import nn

from uavaccel.vision.observation import NEUTRAL

HALF_CONTRAST = 24.0  # grey levels from neutral that are seen at half strength


class LaneFeatures(BaseFeaturesExtractor):
    """Convolutions of stride 2 over event images, first 5 x 5, then 3 x 3, as many as `channels`.

    Grey levels are read as distances from "no events", faint ones spread out: d / (24 + |d|).
    """

    def __init__(self, observation_space: spaces.Box, channels: Sequence[int]) -> None:
        frames, rows, columns = observation_space.shape
        layers: list[nn.Module] = []
        for index, (before, after) in enumerate(zip([frames, *channels[:-1]], channels, strict=True)):
            size = 5 if index == 0 else 3
            layers += [nn.Conv2d(before, after, size, stride=2, padding=size // 2), nn.ReLU()]
            rows, columns = (rows + 1) // 2, (columns + 1) // 2
        super().__init__(observation_space, channels[-1] * rows * columns)
        self.layers = nn.Sequential(*layers, nn.Flatten())

    def forward(self, observations: th.Tensor) -> th.Tensor:
        """Features (n, features) of images (n, frames, rows, columns) that stable-baselines3 has scaled to 0..1."""
        distance = observations * 255.0 - NEUTRAL
        features: th.Tensor = self.layers(distance / (HALF_CONTRAST + distance.abs()))
        return features
