"""DVS-ED: pixels with events, by polarity and sample index, as a percentage of all pixels."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from uavaccel.metrics.dvs_ed import active_pixels, dvs_ed_percent


def random_run(seed: int, images: int = 3) -> NDArray:
    return np.random.default_rng(seed).integers(0, 3, (2, images, 4, 5))


def test_it_counts_pixels_not_events() -> None:
    on, off = np.zeros((2, 1, 10, 10), int)
    on[0, :2, :3], off[0, 5, 5] = 7, 1
    nothing = np.zeros((1, 10, 10), int)
    assert active_pixels(on)[0] == 6
    assert dvs_ed_percent(on, off, nothing, nothing)[0] == 7.0


def test_polarities_do_not_cancel() -> None:
    one, none = np.ones((1, 2, 2), int), np.zeros((1, 2, 2), int)
    assert dvs_ed_percent(one, none, none, one)[0] == 200.0


def test_images_are_paired_by_index_as_far_as_both_runs_have_them() -> None:
    run, reference = random_run(1, images=5), random_run(2, images=3)
    shorter = dvs_ed_percent(*run[:, :3], *reference)
    np.testing.assert_array_equal(dvs_ed_percent(*run, *reference), shorter)
    np.testing.assert_array_equal(dvs_ed_percent(*reference, *run), shorter)


@given(st.integers(0, 999))
def test_a_run_does_not_differ_from_itself(seed: int) -> None:
    run = random_run(seed)
    np.testing.assert_array_equal(dvs_ed_percent(*run, *run), 0.0)
