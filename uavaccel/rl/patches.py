"""Observations on a GPU as patches of their pictures, and the Q-network's forward pass from these in bfloat16.

The first convolution is one matrix product with the patches, on tensor cores. The weights are the policy's own, in
single precision; only the arithmetic of a pass is rounded.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch as th
from numba import cuda
from torch import nn
from torch.nn import functional

from uavaccel.kernels.cuda import grid, shared
from uavaccel.rl.config import HALF_CONTRAST
from uavaccel.rl.network import LaneFeatures, QNetwork
from uavaccel.vision.dvs_sensor import NEUTRAL_LEVEL

LOW = th.bfloat16
KERNEL, STRIDE, PADDING = 8, 4, 2  # the network's first convolution (rl/network.LaneFeatures)
THREADS = 256
BYTE, HALF_WORD = 0xFF, 0xFFFF


def patches_of(frames: int, rows: int, columns: int) -> tuple[int, int, int]:
    """Return the rows and columns of patches that the first convolution sees, and the size of a patch."""
    down, across = ((size + 2 * PADDING - KERNEL) // STRIDE + 1 for size in (rows, columns))
    return down, across, frames * KERNEL * KERNEL


def spread_levels(device: th.device) -> th.Tensor:
    """Return the network's input for each grey level, d / (24 + |d|), as the bits of bfloat16 (256,) int16."""
    distance = th.arange(256, dtype=th.float32) - NEUTRAL_LEVEL
    spread = distance / (distance.abs() + HALF_CONTRAST)
    return spread.to(LOW).view(th.int16).to(device)


def _cut(row, lane, mirrored, levels, pairs, patches, down, across):  # type: ignore[no-untyped-def]
    """Write one row of one patch per thread: KERNEL numbers of one frame, four in each 64-bit word of `patches`.

    Patches begin at even columns, so a thread reads two levels at once: `pairs` (rows, lanes, frames, 36, 32) int16.
    """
    thread, eight = np.uint32(cuda.grid(1)), np.uint32(KERNEL)  # a GPU divides in 32 bits, and emulates 64
    frames, rows, columns = np.uint32(pairs.shape[2]), pairs.shape[3], pairs.shape[4]
    line, frame, patch = thread % eight, thread // eight % frames, thread // (eight * frames)
    place, sample = patch % np.uint32(down * across), patch // np.uint32(down * across)
    if sample >= len(row):
        return
    x = (STRIDE * np.int32(place % np.uint32(across)) - PADDING) // 2
    y = STRIDE * np.int32(place // np.uint32(across)) - PADDING + np.int32(line)
    seen, turned = pairs[row[sample], lane[sample], frame], mirrored[sample] != 0
    for half in range(2):
        word = np.int64(0)
        for pair in range(2):
            column = x + 2 * half + pair
            if 0 <= y < rows and 0 <= column < columns:
                both = np.int64(seen[y, columns - 1 - column if turned else column])
                first, second = both & BYTE, (both >> 8) & BYTE
                if turned:
                    first, second = second, first
                numbers = np.int64(levels[first]) & HALF_WORD | (np.int64(levels[second]) & HALF_WORD) << 16
                word |= numbers << (32 * pair)
        patches[patch, 2 * (KERNEL * frame + line) + half] = word


class Patches:
    """Observations of a ring, (rows, lanes, frames, 36, 64) uint8, as patches of the first convolution."""

    def __init__(self, shape: tuple[int, int, int], device: th.device) -> None:
        self.down, self.across, self.numbers = patches_of(*shape)
        self._frames, self._levels = shape[0], spread_levels(device)
        self._kernel: Any = cuda.jit(_cut, cache=True)

    def look(self, ring: th.Tensor, row: th.Tensor, lane: th.Tensor, mirrored: th.Tensor) -> th.Tensor:
        """Return patches (n * rows * columns, size) bfloat16 of the observations at `row` and `lane` (n,).

        Those that are `mirrored` (n,) are turned left to right.
        """
        count = len(row) * self.down * self.across
        patches = th.empty((count, self.numbers // 4), dtype=th.int64, device=row.device)
        threads = count * self._frames * KERNEL
        tensors = row, lane, mirrored.byte(), self._levels, ring.view(th.int16), patches
        self._kernel[grid(threads, THREADS)](*map(shared, tensors), self.down, self.across)
        return patches.view(LOW)

    def rate(self, network: QNetwork, patches: th.Tensor) -> th.Tensor:
        """Return the action values (n, actions) float32 for the patches of n observations."""
        assert isinstance(network.features_extractor, LaneFeatures)
        first, *rest = (each for each in network.features_extractor.layers if isinstance(each, nn.Conv2d))
        with th.autocast("cuda", dtype=LOW, cache_enabled=False):
            weights = first.weight.reshape(first.out_channels, -1)
            seen = functional.relu(functional.linear(patches, weights, first.bias))
            seen = seen.view(-1, self.down, self.across, first.out_channels).permute(0, 3, 1, 2)
            for layer in rest:
                seen = functional.relu(layer(seen))
            values: th.Tensor = network.q_net(seen.contiguous().flatten(1))
            return values.float()
