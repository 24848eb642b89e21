"""The replay buffer on a GPU: a ring of rounds, sampled as n-step windows, with observations as patches.

A row is one command of every lane. The next observation of a command is the observation of the row after it, so each is
stored once; a window that contains a truncation has no weight, since its next observation belongs to another game.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import torch as th
from numba import cuda
from numpy.typing import NDArray

from uavaccel.kernels.cuda import grid, shared
from uavaccel.rl.contrast import HALF_CONTRAST
from uavaccel.vision.observation import NEUTRAL_LEVEL

KERNEL, STRIDE, PADDING = 8, 4, 2  # the network's first convolution (rl/network.LaneFeatures)
THREADS = 256
BYTE, HALF_WORD = 0xFF, 0xFFFF


class Windows(NamedTuple):
    """Sampled n-step windows (n,): the place of their first and next observations in the ring, and their returns."""

    row: th.Tensor
    after: th.Tensor
    lane: th.Tensor
    actions: th.Tensor
    rewards: th.Tensor
    discounts: th.Tensor  # of the value that is bootstrapped; 0 where the game was terminated
    weights: th.Tensor
    mirrored: th.Tensor


class DeviceReplay:
    """A ring of `rows` rounds of `lanes` lanes; `place` is the row in progress, `filled` ones before it are whole."""

    def __init__(self, rows: int, lanes: int, shape: tuple[int, ...], dtype: th.dtype, device: th.device) -> None:
        self.rows, self.lanes, self.device = rows, lanes, device
        self.observations = th.zeros((rows, lanes, *shape), dtype=dtype, device=device)
        self.actions = th.zeros((rows, lanes), dtype=th.int64, device=device)
        self.rewards = th.zeros((rows, lanes), device=device)
        self.over, self.cut, self.flown = (th.zeros((rows, lanes), device=device) for _ in range(3))
        self.place = th.zeros(1, dtype=th.int64, device=device)
        self.filled = th.zeros(1, dtype=th.int64, device=device)

    def start_round(self, observations: th.Tensor, actions: th.Tensor) -> None:
        """Store the observations (lanes, ...) and actions (lanes,) of the round in progress."""
        self.observations.index_copy_(0, self.place, observations[None])
        self.actions.index_copy_(0, self.place, actions[None])

    def end_round(self, rewards: th.Tensor, terminated: th.Tensor, truncated: th.Tensor, flown: th.Tensor) -> None:
        """Store the results (lanes,) of the round in progress, `flown` by these lanes, and go on to the next row."""
        rows = ((self.rewards, rewards), (self.over, terminated), (self.cut, truncated), (self.flown, flown))
        for room, values in rows:
            room.index_copy_(0, self.place, values.float()[None])
        self.place.copy_((self.place + 1) % self.rows)
        self.filled.copy_((self.filled + 1).clamp(max=self.rows - 1))

    def sample(self, count: int, n_steps: int, gamma: float, mirror: bool) -> Windows:
        """Sample `count` windows of `n_steps` commands, fewer where the game ends; if `mirror`, half are mirrored."""
        age = n_steps - 1 + th.rand(count, device=self.device, dtype=th.float64) * (self.filled - n_steps + 1)
        row = (self.place - 1 - age.long()) % self.rows
        lane = (th.rand(count, device=self.device, dtype=th.float64) * self.lanes).long()
        rewards, discounts = th.zeros_like(age), th.ones_like(age)
        alive, weights = th.ones_like(age), self.flown[row, lane].double()
        for step in range(n_steps):
            at = (row + step) % self.rows
            rewards += alive * gamma**step * self.rewards[at, lane]
            weights = weights * (1.0 - alive * self.cut[at, lane])
            alive = alive * (1.0 - self.over[at, lane])
        discounts = alive * gamma**n_steps
        half = th.arange(count, device=self.device) % 2 == 0
        mirrored = half if mirror else th.zeros_like(half)
        after = (row + n_steps) % self.rows
        return Windows(
            row, after, lane, self.actions[row, lane], rewards.float(), discounts.float(), weights.float(), mirrored
        )

    def get_state(self) -> dict[str, NDArray[Any]]:
        """Return its contents as arrays."""
        return {name: getattr(self, name).cpu().numpy() for name in RING}

    def set_state(self, state: dict[str, NDArray[Any]]) -> None:
        """Restore what `get_state` returned."""
        for name in RING:
            getattr(self, name).copy_(th.from_numpy(state[name]))


RING = ("observations", "actions", "rewards", "over", "cut", "flown", "place", "filled")


def patches_of(frames: int, rows: int, columns: int) -> tuple[int, int, int]:
    """Return the rows and columns of patches that the first convolution sees, and the size of a patch."""
    down, across = ((size + 2 * PADDING - KERNEL) // STRIDE + 1 for size in (rows, columns))
    return down, across, frames * KERNEL * KERNEL


def spread_levels(device: th.device) -> th.Tensor:
    """Return the network's input for each grey level, d / (24 + |d|), as the bits of bfloat16 (256,) int16."""
    distance = th.arange(256, dtype=th.float32) - NEUTRAL_LEVEL
    spread = distance / (distance.abs() + HALF_CONTRAST)
    return spread.to(th.bfloat16).view(th.int16).to(device)


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


class Cutter:
    """Cuts observations of a ring, (rows, lanes, frames, 36, 64) uint8, into the first convolution's patches."""

    def __init__(self, shape: tuple[int, int, int], device: th.device) -> None:
        self.down, self.across, self.numbers = patches_of(*shape)
        self._frames, self._levels = shape[0], spread_levels(device)
        self._kernel: Any = cuda.jit(_cut, cache=True)

    def __call__(self, observations: th.Tensor, row: th.Tensor, lane: th.Tensor, mirrored: th.Tensor) -> th.Tensor:
        """Return patches (n * rows * columns, size) bfloat16 of the observations at `row` and `lane` (n,)."""
        count = len(row) * self.down * self.across
        patches = th.empty((count, self.numbers // 4), dtype=th.int64, device=row.device)
        threads = count * self._frames * KERNEL
        self._kernel[grid(threads, THREADS)](
            shared(row),
            shared(lane),
            shared(mirrored.byte()),
            shared(self._levels),
            shared(observations.view(th.int16)),
            shared(patches),
            self.down,
            self.across,
        )
        return patches.view(th.bfloat16)
