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
    pixels = _pixels_per_image(on, off, reference_on, reference_off)
    run, reference = (
        np.stack([active_pixels(positive), active_pixels(negative)])
        for positive, negative in ((on, off), (reference_on, reference_off))
    )
    shared = min(run.shape[1], reference.shape[1])
    difference = np.abs(run[:, :shared] - reference[:, :shared]).sum(axis=0)
    return np.asarray(100.0 * difference / pixels)


def _pixels_per_image(*stacks: ArrayLike) -> int:
    on, off, reference_on, reference_off = (np.shape(stack) for stack in stacks)
    if len(on) != 3 or on != off or reference_on != reference_off or on[1:] != reference_on[1:]:
        raise ValueError(f"event counts must be (n, H, W): {on}, {off} against {reference_on}, {reference_off}")
    return int(on[1] * on[2])
