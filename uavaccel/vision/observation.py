"""The event image that a policy network observes: DVS counts, reduced to a small grey image."""

import numpy as np
from numpy.typing import NDArray

BLOCK_SIDE = 4  # pixels; each block is summed into one
NEUTRAL_LEVEL = 128  # grey level for as many ON as OFF events


def dvs_observation(on: NDArray[np.integer], off: NDArray[np.integer]) -> NDArray[np.uint8]:
    """Return 128 plus the sum of ON - OFF over blocks of 4 x 4 pixels, clipped to 0..255.

    Counts (H, W) become (H / 4, W / 4): 144 x 256 gives 36 x 64. The reduction is this project's own choice.
    Raises ValueError if the shapes differ or are not multiples of 4.
    """
    if on.shape != off.shape or on.ndim != 2 or on.shape[0] % BLOCK_SIDE or on.shape[1] % BLOCK_SIDE:
        raise ValueError(f"ON and OFF need one (H, W) shape of multiples of {BLOCK_SIDE}: {on.shape}, {off.shape}")
    from uavaccel.vision.dvs_kernels import block_sums  # compiled, and not needed for the constants

    return block_sums(on, off)
