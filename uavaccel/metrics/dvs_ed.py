"""DVS Event Dissimilarity (DVS-ED) of two runs on the same path (paper, section III-C2b)."""

import numpy as np
from numpy.typing import ArrayLike, NDArray


def active_pixels(counts: ArrayLike) -> NDArray[np.int64]:
    """Count the pixels with at least one event, for each image of (..., H, W) counts of one polarity."""
    return np.asarray(np.count_nonzero(counts, axis=(-2, -1)), np.int64)


def dvs_ed_percent(
    on: ArrayLike, off: ArrayLike, reference_on: ArrayLike, reference_off: ArrayLike
) -> NDArray[np.float64]:
    """Return the DVS-ED (n,) of each image of a run against the real-time run's image of the same index.

    |difference in ON pixels| + |difference in OFF pixels|, as a percentage of all pixels. Arguments are event
    counts (n, H, W); of two runs of unequal length the images that both have are compared.
    Raises ValueError where the images differ in size, or a run's polarities in number.
    """
    shapes = [np.shape(stack) for stack in (on, off, reference_on, reference_off)]
    if len(shapes[0]) != 3 or shapes[0] != shapes[1] or shapes[2] != shapes[3] or shapes[0][1:] != shapes[2][1:]:
        raise ValueError(f"event counts must be (n, H, W), not {shapes}")
    run, reference = (
        np.stack([active_pixels(counts) for counts in pair]) for pair in ((on, off), (reference_on, reference_off))
    )
    shared = min(run.shape[1], reference.shape[1])
    return np.asarray(100.0 * np.abs(run[:, :shared] - reference[:, :shared]).sum(axis=0) / np.prod(shapes[0][1:]))
