"""The Q-network's forward pass from image patches, in bfloat16 on tensor cores.

The first convolution is one matrix product with the patches. The weights are the policy's own, in single precision;
only the arithmetic of a pass is rounded.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch as th
from torch import nn
from torch.nn import functional

LOW = th.bfloat16


def rate(network: Any, patches: th.Tensor, down: int, across: int) -> th.Tensor:
    """Return the values (n, actions) float32 of a QNetwork on LaneFeatures, for the patches of n observations."""
    convolutions = [each for each in network.features_extractor.layers if isinstance(each, nn.Conv2d)]
    first, rest = convolutions[0], convolutions[1:]
    with th.autocast("cuda", dtype=LOW, cache_enabled=False):
        weights = first.weight.reshape(first.out_channels, -1)
        seen = functional.relu(functional.linear(patches, weights, first.bias))
        seen = seen.view(-1, down, across, first.out_channels).permute(0, 3, 1, 2)
        for layer in rest:
            seen = functional.relu(layer(seen))
        seen = seen.contiguous().flatten(1)
        return _dense(network.q_net, seen).float()


def _dense(layers: Sequence[nn.Module], seen: th.Tensor) -> th.Tensor:
    for layer in layers:
        seen = layer(seen)
    return seen
