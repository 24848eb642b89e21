"""What the policy network sees of the DVS: an event image small enough to learn from."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

BLOCK = 4  # pixels on a side that are summed to one
NEUTRAL = 128  # grey level of "as many ON as OFF events"


def dvs_observation(on: NDArray[np.integer], off: NDArray[np.integer]) -> NDArray[np.uint8]:
    """128 plus the sum of ON - OFF over blocks of 4 x 4 pixels, clipped to 0..255.

    Counts (H, W) become (H / 4, W / 4): 144 x 256 gives 36 x 64. The reduction is this project's own choice.
    Raises ValueError where the shapes differ or are no multiples of 4.
    """
    if on.shape != off.shape or on.ndim != 2 or on.shape[0] % BLOCK or on.shape[1] % BLOCK:
        raise ValueError(f"ON and OFF need one (H, W) shape of multiples of {BLOCK}: {on.shape}, {off.shape}")
    return _block_sums(on, off)


@njit(nogil=True, cache=True)
def _block_sums(on: NDArray[np.integer], off: NDArray[np.integer]) -> NDArray[np.uint8]:
    image = np.empty((on.shape[0] // BLOCK, on.shape[1] // BLOCK), np.uint8)
    for row in range(image.shape[0]):
        for column in range(image.shape[1]):
            level = np.int64(NEUTRAL)
            for y in range(row * BLOCK, (row + 1) * BLOCK):
                for x in range(column * BLOCK, (column + 1) * BLOCK):
                    level += np.int64(on[y, x]) - np.int64(off[y, x])
            image[row, column] = min(max(level, 0), 255)
    return image
