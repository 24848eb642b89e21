"""The event image that the policy network sees."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from uavaccel.vision.dvs_sensor import dvs_observation


def test_without_events_the_image_is_neutral_grey() -> None:
    image = dvs_observation(np.zeros((144, 256), np.int32), np.zeros((144, 256), np.int32))
    assert image.shape == (36, 64)
    assert image.dtype == np.uint8
    assert (image == 128).all()


@given(st.integers(0, 999), st.sampled_from([np.int32, np.uint8]))
def test_blocks_are_summed_and_clipped(seed: int, dtype: type) -> None:
    on, off = np.random.default_rng(seed).integers(0, 30, (2, 12, 20)).astype(dtype)
    sums = (on.astype(int) - off).reshape(3, 4, 5, 4).sum(axis=(1, 3))
    np.testing.assert_array_equal(dvs_observation(on, off), np.clip(128 + sums, 0, 255))
